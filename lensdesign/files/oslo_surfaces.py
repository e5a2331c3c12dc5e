"""Surfaces of an OSLO file, and the evaluation of their solves and pickups.

A file of OSLO holds no present values of solves and pickups. They are evaluated in the order of the surfaces,
as OSLO does (Program Reference, Lambda Research, "Solves" and "Pickups"):

- PY and PYC: the thickness at whose end the paraxial marginal or chief ray has a height;
- PU and PUC: the curvature behind which that ray has a slope;
- PI and PIC: the curvature at which that ray has an angle of incidence, u + y c;
- EC: the thickness with which two surfaces touch at a height;
- PK CV and PK CVM: the profile of a preceding surface, or its mirror image, with a difference of curvature;
- PK TH and PK THM: the thickness of a preceding surface, or its negative, plus a length;
- PK LN and PK LNM: the distance between two preceding surfaces, or its negative, plus a length;
- PK GLA and PK AP: medium and aperture of a preceding surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from lensdesign.errors import InputError
from lensdesign.files.draft import parse_number, quoted

TERMS = ("AD", "AE", "AF", "AG")
"""Asphere coefficients of r^4 to r^10."""

SOLVED_QUANTITIES = {
    **dict.fromkeys(("PY", "PYC", "EC"), "thickness"),
    **dict.fromkeys(("PU", "PUC", "PI", "PIC"), "radius"),
}
"""Quantity that each solve determines."""

PICKUPS = {
    **dict.fromkeys(("CV", "CVM"), ("radius", 1, 1)),
    **dict.fromkeys(("TH", "THM"), ("thickness", 1, 1)),
    **dict.fromkeys(("LN", "LNM"), ("thickness", 2, 1)),
    "GLA": ("medium", 1, 0),
    "AP": ("aperture", 1, 0),
}
"""Quantity that each pickup copies, number of surfaces that it names, and of optional values behind them."""


@dataclass(frozen=True)
class Solve:
    """A solve, or a pickup from the surfaces `sources`, as the file states it."""

    words: tuple[str, ...]
    location: str
    sources: tuple[int, ...] = ()

    @property
    def kind(self) -> str:
        """Keyword: PY, PU, ... of a solve; CV, TH, ... of a pickup."""
        return self.words[1] if self.sources else self.words[0]

    @property
    def text(self) -> str:
        """The words of the file."""
        return " ".join(self.words)

    @property
    def target(self) -> float:
        """Value that a solve asks for, or that a pickup adds."""
        count = 2 + len(self.sources) if self.sources else 1
        return parse_number(self.words[count], self.location) if len(self.words) > count else 0.0


@dataclass
class FileSurface:
    """Values of one surface, collected from its commands.

    `glass` holds the words behind GLA and `glass_wavelengths_um` the wavelengths at that point of the file.
    `given` maps a quantity that has a value to the command that gives it; `solved` maps a quantity to its
    solve or pickup. `is_misread` tells that a loss changes the rays behind the surface, `is_moved` that it
    has decenters or tilts.
    """

    name: str
    location: str
    curvature_per_mm: float = 0.0
    radius_mm: float | None = None
    thickness_mm: float = 0.0
    glass: tuple[str, ...] = ()
    glass_location: str = ""
    glass_wavelengths_um: tuple[float, ...] = ()
    material: str | float | None = None
    conic: float = 0.0
    terms: dict[str, float] = field(default_factory=dict)
    semi_diameter_mm: float | None = None
    unchecked_mm: float | None = None
    stop: bool = False
    given: dict[str, str] = field(default_factory=dict)
    solved: dict[str, Solve] = field(default_factory=dict)
    is_misread: bool = False
    is_moved: bool = False

    def sag_mm(self, height_mm: float) -> float:
        """Return the sag at a height in mm; nan outside of the surface."""
        c, square = self.curvature_per_mm, height_mm**2
        inside = 1.0 - (1.0 + self.conic) * c * c * square
        if inside < 0.0:
            return math.nan
        return c * square / (1.0 + math.sqrt(inside)) + sum(
            self.terms.get(word, 0.0) * square**power for power, word in enumerate(TERMS, start=2)
        )


@dataclass
class Ray:
    """A paraxial ray: height in mm and slope."""

    y: float
    u: float

    def refract(self, curvature_per_mm: float, index: float, behind: float) -> None:
        """Refract the ray at a surface."""
        self.u = (index * self.u - (behind - index) * curvature_per_mm * self.y) / behind

    def transfer(self, distance_mm: float) -> None:
        """Move the ray to the next surface."""
        self.y += distance_mm * self.u


@dataclass(frozen=True)
class Beam:
    """What defines the paraxial marginal and chief rays: object distance, system aperture and field.

    `aperture` is EBR or NAO with its value, `field` OBH (in mm) or ANG (in degrees).
    """

    object_distance_mm: float
    aperture: tuple[str, float] | None
    field: tuple[str, float] | None

    def marginal(self) -> Ray:
        """Return the marginal ray at surface 1; without a system aperture, its height there is 1 mm."""
        distance = self.object_distance_mm
        word, value = self.aperture or ("EBR", 1.0)
        if distance == math.inf:
            return Ray(value, 0.0)
        if word == "NAO":
            tangent = math.tan(math.asin(value))
            return Ray(tangent * distance, tangent)
        return Ray(value, value / distance if distance else math.nan)

    def chief(self, parallel: Ray, through: Ray) -> Ray | None:
        """Return the chief ray at the stop from two rays there; None if the file does not define it.

        At surface 1, the ray `parallel` has height 1 and slope 0, the ray `through` height 0 and slope 1.
        """
        distance = self.object_distance_mm
        word, value = self.field or ("", 0.0)
        if word == "ANG" and distance == math.inf:
            slope = math.tan(math.radians(value))
            height = -slope * through.y / parallel.y if parallel.y else math.nan
        elif word == "OBH" and distance < math.inf:
            at_stop = parallel.y * distance + through.y
            slope = -value * parallel.y / at_stop if at_stop else math.nan
            height = value + distance * slope
        else:
            return None
        return Ray(0.0, height * parallel.u + slope * through.u)


@dataclass
class _Rays:
    """The rays of a beam on their way through the surfaces; `is_misread` tells that they are not known."""

    beam: Beam
    marginal: Ray
    parallel: Ray = field(default_factory=lambda: Ray(1.0, 0.0))
    through: Ray = field(default_factory=lambda: Ray(0.0, 1.0))
    chief: Ray | None = None
    is_behind_stop: bool = False
    is_misread: bool = False

    def every(self) -> list[Ray]:
        """Return the rays that are known."""
        return [ray for ray in (self.marginal, self.parallel, self.through, self.chief) if ray is not None]

    def reach_stop(self) -> None:
        """Set the chief ray, whose height at the stop is 0."""
        self.is_behind_stop, self.chief = True, self.beam.chief(self.parallel, self.through)

    def of_solve(self, solve: Solve, surface: FileSurface) -> Ray:
        """Return the ray that a solve refers to."""
        is_chief = solve.kind.endswith("C")
        reason = ""
        if self.is_misread:
            reason = "a surface up to this one has contents that a design cannot represent"
        elif not is_chief and self.beam.aperture is None and (solve.target or solve.kind != "PY"):
            reason = "the file lacks EBR and NAO"
        elif is_chief and not self.is_behind_stop:
            reason = "its surface stands in front of the aperture stop, whose center the chief ray meets"
        elif is_chief and self.chief is None:
            reason = "the file lacks the field of its object: OBH at a finite distance, ANG at infinity"
        if reason:
            raise _not_evaluated(solve, surface, reason)
        ray = self.chief if is_chief else self.marginal
        assert ray is not None
        return ray


def _not_evaluated(solve: Solve, surface: FileSurface, reason: str) -> InputError:
    return InputError(
        f"{solve.location}: the solve {quoted(solve.text)} of {surface.name} cannot be evaluated: {reason}"
    )


def evaluate_solves(
    surfaces: Sequence[FileSurface],
    beam: Beam,
    index_of: Callable[[FileSurface], float],
    remark: Callable[[str], None],
) -> None:
    """Replace solves and pickups of profiles and thicknesses by their values, in the order of the surfaces.

    Parameters
    ----------
    surfaces
        All surfaces from the object to the image; they are updated.
    beam
        The rays that solves refer to.
    index_of
        Returns the refractive index behind a surface.
    remark
        Called with a sentence for each replacement.

    Raises
    ------
    InputError
        If a solve or pickup cannot be evaluated.
    """
    front, *inner, image = surfaces
    for surface in (front, image):
        for forbidden in surface.solved.values():
            reason = "only surfaces between the object and the image may have one"
            raise _not_evaluated(forbidden, surface, reason)
    rays = _Rays(beam, beam.marginal(), is_misread=front.is_misread or front.material is not None)
    index = 1.0
    for i, surface in enumerate(inner, start=1):
        if surface.stop:
            rays.reach_stop()
        behind = index_of(surface)
        _pick_up_profile(surfaces, surface, remark)
        rays.is_misread = rays.is_misread or surface.is_misread
        if solve := surface.solved.get("radius"):
            curvature = _solved_curvature(solve, rays.of_solve(solve, surface), index, behind)
            surface.curvature_per_mm = _solved_value(surface, solve, "curvature", curvature, remark)
            surface.radius_mm = 1.0 / curvature if curvature else None
        for ray in rays.every():
            ray.refract(surface.curvature_per_mm, index, behind)
        if solve := surface.solved.get("thickness"):
            if solve.sources:
                thickness = _picked_up_thickness(surfaces, solve)
            elif solve.kind == "EC":
                thickness = _edge_contact(surfaces, i, solve, remark)
            else:
                ray = rays.of_solve(solve, surface)
                thickness = (solve.target - ray.y) / ray.u if ray.u else math.nan
            surface.thickness_mm = _solved_value(surface, solve, "thickness", thickness, remark)
        for ray in rays.every():
            ray.transfer(surface.thickness_mm)
        index = behind


def _solved_curvature(solve: Solve, ray: Ray, index: float, behind: float) -> float:
    """Return the curvature that refracts a ray to a slope (PU) or has an angle of incidence (PI)."""
    if solve.kind.startswith("PI"):
        return (solve.target - ray.u) / ray.y if ray.y else math.nan
    power = (index - behind) * ray.y
    return (behind * solve.target - index * ray.u) / power if power else math.nan


def _pick_up_profile(
    surfaces: Sequence[FileSurface], surface: FileSurface, remark: Callable[[str], None]
) -> None:
    """Replace a pickup of a profile (PK CV, PK CVM) by the values of its source; do nothing without one."""
    solve = surface.solved.get("radius")
    if solve is None or not solve.sources:
        return
    source = surfaces[solve.sources[0]]
    sign = -1.0 if solve.kind == "CVM" else 1.0
    curvature = sign * source.curvature_per_mm + solve.target
    surface.curvature_per_mm = _solved_value(surface, solve, "curvature", curvature, remark)
    surface.radius_mm = 1.0 / curvature if curvature else None
    if source.radius_mm is not None and not solve.target:
        surface.radius_mm = sign * source.radius_mm
    surface.conic = source.conic
    surface.terms = {word: sign * value for word, value in source.terms.items()}
    surface.is_misread = surface.is_misread or source.is_misread
    del surface.solved["radius"]


def _picked_up_thickness(surfaces: Sequence[FileSurface], solve: Solve) -> float:
    """Return the thickness of a surface (PK TH) or the distance between two (PK LN), plus a length."""
    first = solve.sources[0]
    end = solve.sources[1] if len(solve.sources) > 1 else first + 1
    length = sum(surface.thickness_mm for surface in surfaces[first:end])
    if not math.isfinite(length):
        raise InputError(f"{solve.location}: {quoted(solve.text)}: the distance that it copies is infinite")
    return (-length if solve.kind.endswith("M") else length) + solve.target


def _edge_contact(
    surfaces: Sequence[FileSurface], i: int, solve: Solve, remark: Callable[[str], None]
) -> float:
    """Return the thickness with which a surface and the next one touch at a height."""
    surface, following = surfaces[i], surfaces[i + 1]
    _pick_up_profile(surfaces, following, remark)
    reason = ""
    if surface.is_misread or following.is_misread:
        reason = "one of the two surfaces has contents that a design cannot represent"
    elif "radius" in following.solved:
        reason = f"the curvature of {following.name} is a solve itself"
    thickness = surface.sag_mm(solve.target) - following.sag_mm(solve.target)
    if not reason and math.isnan(thickness):
        reason = "one of the two surfaces does not reach that height"
    if reason:
        raise _not_evaluated(solve, surface, reason)
    return thickness


def _solved_value(
    surface: FileSurface, solve: Solve, quantity: str, value: float, remark: Callable[[str], None]
) -> float:
    """Return the value of a solve or a pickup, and add a remark on it."""
    if not math.isfinite(value):
        ray = "chief" if solve.kind.endswith("C") else "marginal"
        raise InputError(
            f"{solve.location}: no {quantity} of {surface.name} meets the solve {quoted(solve.text)}: the "
            f"{ray} ray runs along the axis or parallel to it"
        )
    unit = "/mm" if quantity == "curvature" else "mm"
    remark(f"{surface.name}: {solve.text} replaced by its value, a {quantity} of {value:.8g} {unit}")
    return value
