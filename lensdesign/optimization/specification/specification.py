"""Specification files: start lens, variables with bounds, goal and constraints of an optimization.

A specification is a design file with three more tables: ``[optimize]``, ``[constraints]`` and one
``[[variable]]`` for each variable. The design in it is the start.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from lensdesign.analysis.oversampling import (
    INTENSITY_DEGREES,
    UNKNOWNS_OF_KIND,
    largest_oversampling,
)
from lensdesign.analysis.space_bandwidth import sbp_object, spread_limit_sine
from lensdesign.common.input_files import validate_inside
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import DesignError
from lensdesign.files.design import validate_kind, validated_lens
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens, ObjectSpace
from lensdesign.lens.temperature import check_heat, lens_at_temperature
from lensdesign.optimization.as_built import AsBuilt, read_as_built
from lensdesign.optimization.specification.sections import (
    GHOST_GOAL,
    LARGEST,
    LOSS_GOAL,
    Constraints,
    Environment,
    Recording,
    Settings,
    Tolerances,
)
from lensdesign.optimization.specification.variables import VariableRange


class Specification(Lens):
    """A start lens with the variables, goal and constraints of its optimization.

    :func:`load_specification` reads it from a file. The attributes of :class:`Lens` describe the start.

    Attributes
    ----------
    optimize
        Goal, start, algorithm and limits of the search.
    constraints
        Constraints on the lens.
    tolerances
        Manufacturing tolerances; None if neither goal nor constraints concern lenses as built.
    environment
        Further temperatures at which the constraints hold; None means the design temperature alone.
    recording
        Frames from which a kind of object must be found; None sets no constraint on them.
    variables
        Variables with their bounds or choices.

    Examples
    --------
    >>> from lensdesign import load_specification
    >>> specification = load_specification("designs/thinnest_singlet_spec.toml")
    >>> specification.optimize.goal, len(specification.variables)
    ('thinnest lens', 4)
    >>> round(specification.spread_limit(0.532), 4)
    0.0831
    """

    optimize: Settings = Settings()
    constraints: Constraints = Constraints()
    tolerances: Tolerances | None = None
    environment: Environment | None = None
    recording: Recording | None = None
    variables: Annotated[tuple[VariableRange, ...], Field(alias="variable", min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> Specification:
        for number, surface in enumerate(self.surfaces, start=1):
            if surface.figure is not None:
                raise ValueError(f"surface {number}: optimize the nominal lens, without a measured figure")
        if self.asks_as_built and self.tolerances is None:
            raise ValueError(
                "goals and constraints of lenses as built need their tolerances: [tolerances] study"
            )
        goal = self.optimize.goal
        if goal in LARGEST and all(v.parameter != LARGEST[goal] for v in self.variables):
            raise ValueError(f"goal = {goal!r}: needs a [[variable]] with {LARGEST[goal]}, and bounds")
        if self.field_range_mm is not None:
            self._check_variable_field()
        seen = set()
        for v in self.variables:
            if v.surface is not None and v.surface > len(self.surfaces):
                raise ValueError(
                    f"variable {v.name}: there is no such surface; the lens has {len(self.surfaces)} surfaces"
                )
            if v.parameter == "stop":
                numbers = range(1, len(self.surfaces) + 1)
                wrong = [c for c in v.choices if c not in numbers]
                if wrong:
                    raise ValueError(
                        f"variable stop: choices = {list(v.choices)}: there is no surface {wrong[0]}"
                    )
            if v.parameter == "thickness_mm" and v.surface == len(self.surfaces):
                raise ValueError(f"variable {v.name}: the last surface has no thickness")
            if v.name in seen:
                raise ValueError(f"variable {v.name} is given twice")
            seen.add(v.name)
        radii = self.constraints.max_footprint_radius_mm
        if isinstance(radii, tuple) and len(radii) != len(self.sensor.plane_distances_mm):
            raise ValueError(
                f"max_footprint_radius_mm has {len(radii)} values for "
                f"{len(self.sensor.plane_distances_mm)} sensor planes; give one for each plane, or a single "
                "one"
            )
        self._check_recording()
        for limit in self.constraints.field_spread:
            if limit.field_mm > self.half_field_mm:
                raise ValueError(
                    f"field_spread at {limit.field_mm:g} mm lies outside the half field of "
                    f"{self.half_field_mm:g} mm"
                )
        return self

    def _check_recording(self) -> None:
        """Refuse frames that the sensor does not have, and a support that the field does not contain."""
        if self.recording is None:
            return
        frames, planes = self.recording.frames, len(self.sensor.plane_distances_mm)
        if frames > planes:
            raise ValueError(
                f"recording, frames = {frames}: the sensor has {planes} plane{'s'[: planes > 1]}; reduce "
                "frames, or add to plane_distances_mm"
            )
        support, field = self.recording.support_mm, self.object.field_diameter_mm
        if support is None:
            return
        if self.field_range_mm is not None:
            raise ValueError(
                "recording, support_mm: cannot be combined with a variable field_diameter_mm, which is the "
                "support; remove one of both"
            )
        if support > field:
            raise ValueError(
                f"recording, support_mm = {support:g}: must not exceed the field of {field:g} mm"
            )

    def _check_variable_field(self) -> None:
        """Refuse what belongs to fixed object points, which a variable field may leave."""
        if self.constraints.field_spread:
            raise ValueError(
                "variable field_diameter_mm: field_spread limits fixed field heights; remove one of both"
            )
        if self.asks_as_built:
            raise ValueError(
                "variable field_diameter_mm: goals and constraints of lenses as built need a fixed field; "
                "`lensdesign limits` finds the largest field for them"
            )

    @property
    def field_range_mm(self) -> tuple[float, float] | None:
        """Smallest and largest diameter of a variable field; None if the field is fixed."""
        return next((v.bounds for v in self.variables if v.parameter == "field_diameter_mm"), None)

    @property
    def required_object(self) -> ObjectSpace:
        """Object that every lens must cover: that of the start, with the smallest diameter of the field."""
        if self.field_range_mm is None:
            return self.object
        return self.object.replaced(field_diameter_mm=self.field_range_mm[0])

    def with_fixed_field(self) -> Self:
        """Return the specification with the smallest diameter of a variable field, which is then fixed.

        Raises
        ------
        DesignError
            If no variable remains.
        """
        if self.field_range_mm is None:
            return self
        fixed = tuple(v for v in self.variables if v.parameter != "field_diameter_mm")
        if not fixed:
            raise DesignError("field_diameter_mm is the only variable; this search needs another one")
        goal = "thinnest lens" if self.optimize.goal == "largest field" else self.optimize.goal
        settings = self.optimize.replaced(goal=goal)
        return self.model_copy(
            update={"object": self.required_object, "variables": fixed, "optimize": settings}
        )

    def without_as_built(self) -> Self:
        """Return the specification without the constraints on lenses as built; the goal stays."""
        limits = self.constraints.replaced(
            min_yield=None, max_as_built_rms_waves=None, max_as_built_reconstruction_loss=None
        )
        return self.model_copy(update={"constraints": limits})

    @property
    def asks_ghosts(self) -> bool:
        """True if goal or constraints concern ghosts."""
        return self.constraints.max_ghost_fraction is not None or self.optimize.goal == GHOST_GOAL

    @property
    def asks_as_built(self) -> bool:
        """True if goal or constraints concern lenses as built."""
        return self.asks_yields or self.asks_losses

    @property
    def asks_yields(self) -> bool:
        """True if goal or constraints concern yields or wavefronts of lenses as built."""
        limits = self.constraints
        limited = limits.min_yield is not None or limits.max_as_built_rms_waves is not None
        return limited or self.optimize.goal in ("yield", "as-built rms")

    @property
    def asks_losses(self) -> bool:
        """True if goal or constraints concern reconstruction losses of lenses as built."""
        limited = self.constraints.max_as_built_reconstruction_loss is not None
        return limited or self.optimize.goal == LOSS_GOAL

    @property
    def as_built(self) -> AsBuilt | None:
        """The tolerance study; None if neither goal nor constraints need it.

        Raises
        ------
        DesignError
            If the study cannot be read.
        """
        if self.tolerances is None or not self.asks_as_built:
            return None
        return read_as_built(self.tolerances)

    @property
    def lens(self) -> Lens:
        """The start as a plain lens."""
        return Lens(**{name: getattr(self, name) for name in Lens.model_fields})

    def spread_limit(self, wavelength_um: float, medium_index: float | None = None) -> float:
        """Return the largest allowed sine of the spread angle at a wavelength; inf without a limit.

        Parameters
        ----------
        wavelength_um
            Vacuum wavelength.
        medium_index
            Index of the medium in front of the sensor (default: that of the start lens). Lenses of a search
            have other ones if the material behind the last surface is a variable.
        """
        limit = self.constraints.max_spread_deg
        if limit == "none":
            return math.inf
        if limit == "sensor":
            index = self.sensor_medium_index(wavelength_um) if medium_index is None else medium_index
            return spread_limit_sine(wavelength_um, self.sensor.pixel_pitch_um, index)
        return math.sin(math.radians(float(limit)))

    def footprint_limits(self) -> tuple[float, ...]:
        """Return the largest allowed footprint radius on each sensor plane in mm; inf without a limit."""
        limit = self.constraints.max_footprint_radius_mm
        planes = len(self.sensor.plane_distances_mm)
        if limit in ("none", "sensor rectangle"):
            return (math.inf,) * planes
        if limit == "sensor":
            return (0.5 * min(self.sensor.size_mm),) * planes
        return limit if isinstance(limit, tuple) else (float(limit),) * planes


def load_specification(path: str | os.PathLike[str]) -> Specification:
    """Read a specification file.

    Parameters
    ----------
    path
        A TOML file: a design file with the tables ``[optimize]``, ``[constraints]`` and ``[[variable]]``.

    Returns
    -------
    Specification
        The validated specification.

    Raises
    ------
    DesignError
        If the file cannot be read or is not valid, or if etendue excludes every lens of the specification.
    MaterialError
        If the index of a glass is not known at a wavelength; all choices of glasses are checked.

    Examples
    --------
    >>> from lensdesign import load_specification
    >>> specification = load_specification("designs/thinnest_singlet_spec.toml")
    >>> [variable.name for variable in specification.variables]
    ['surface 1 radius_mm', 'surface 2 radius_mm', 'surface 2 conic', 'surface 1 thickness_mm']
    """
    path = Path(path)
    data = read_toml(path)
    validate_kind(data, path, "specification")
    specification = validated_lens(Specification, data, path)
    catalogs = tuple((path.parent / c).resolve() for c in specification.glass_catalogs)
    for catalog in catalogs:
        validate_inside(catalog, path, "glass_catalogs", DesignError)
    specification = specification.model_copy(update={"glass_catalogs": catalogs})
    specification = _with_tolerances(specification, path)
    try:
        for wavelength in specification.wavelengths_um:
            specification.indices(wavelength)
        if specification.environment is not None:
            _check_heat(specification, specification.environment.temperatures_c[0])
        for variable in specification.variables:
            for glass in variable.choices if variable.parameter == "material" else ():
                validate_known(specification, variable.surface or 1, glass)
        validate_possible(specification)
    except (DesignError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error
    return specification


def _with_tolerances(specification: Specification, path: Path) -> Specification:
    """Return the specification with absolute paths of its study files, after checking the study."""
    if specification.tolerances is None:
        return specification
    files = {}
    for key in ("study", "costs"):
        if (given := getattr(specification.tolerances, key)) is not None:
            file = (path.parent / given).resolve()
            validate_inside(file, path, key, DesignError)
            files[key] = str(file)
    tolerances = specification.tolerances.replaced(**files)
    specification = specification.model_copy(update={"tolerances": tolerances})
    if specification.as_built is not None:
        specification.as_built.check(specification.lens)
        specification.as_built.check_trials()
        if specification.asks_yields:
            specification.as_built.check_yields()
        limited = specification.constraints.max_as_built_rms_waves is not None
        if (
            limited or specification.optimize.goal == "as-built rms"
        ) and not specification.as_built.points_mm:
            raise DesignError(
                f"{path}: as-built rms: no merit of {tolerances.study} limits the refocused wavefront: add "
                "one of kind rms_waves or strehl, with field_points_mm, to the study"
            )
        if specification.asks_losses and not specification.as_built.loss_merits:
            raise DesignError(
                f"{path}: as-built reconstruction loss: {tolerances.study} has no merit of kind "
                "reconstruction_loss: add one, with patch_mm and field_points_mm, to the study"
            )
        if specification.asks_losses:
            specification.as_built.check_losses(specification.lens)
    return specification


def _check_heat(specification: Specification, temperature_c: float) -> None:
    """Check the thermal data of the glasses, and that the study applies to a lens at a temperature."""
    check_heat(specification.lens)
    if specification.as_built is not None:
        specification.as_built.check(lens_at_temperature(specification.lens, temperature_c))


def validate_known(specification: Specification, surface: int, glass: str | float) -> None:
    """Check that the required data of a glass behind a surface (number from 1) are known.

    Raises
    ------
    MaterialError
        If its index is not known at a wavelength, or its thermal data are not known although the
        specification has temperatures.
    """
    for wavelength in specification.wavelengths_um:
        refractive_index(glass, wavelength, catalogs=specification.glass_catalogs)
    if specification.environment is not None:
        check_heat(specification.lens.with_surface(surface - 1, material=glass))


def validate_possible(specification: Specification) -> None:
    """Check the bounds that hold for every lens.

    By the etendue bound, FOV x NA (the Lagrange invariant) must fit footprint and spread limit. The
    oversampling ratio of a recording is largest if light fills the footprint on each of its planes.

    Raises
    ------
    DesignError
        If no lens can meet the specification; the message has the numbers.
    """
    _validate_oversampling(specification)
    scene = specification.required_object
    invariant = scene.field_diameter_mm * scene.numerical_aperture
    sine = min(_largest_optical_sine(specification, w) for w in specification.wavelengths_um)
    if math.isinf(sine):
        return
    widest = 2.0 * min(specification.footprint_limits())
    if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
        widest = math.hypot(*specification.sensor.size_mm)
    if invariant > widest * sine:
        raise DesignError(
            "infeasible: by the etendue (Lagrange) bound the exit beam is at least "
            f"FOV x NA / (n sin(spread limit)) = {scene.field_diameter_mm:g} x "
            f"{scene.numerical_aperture:g} / "
            f"{sine:.5g} = {invariant / sine:.4g} mm wide, but the footprint may be only {widest:.4g} mm; "
            "reduce field or NA, or allow a larger footprint or spread"
        )


def _largest_optical_sine(specification: Specification, wavelength_um: float) -> float:
    """Return the limit of index x sine of the spread, in the medium at the sensor that allows the most."""
    last = len(specification.surfaces)
    variable = next(
        (v for v in specification.variables if (v.parameter, v.surface) == ("material", last)), None
    )
    media = [specification.surfaces[-1].material] if variable is None else variable.choices
    indices = (
        1.0 if medium is None else refractive_index(medium, wavelength_um, specification.glass_catalogs)
        for medium in media
    )
    return max(index * specification.spread_limit(wavelength_um, index) for index in indices)


def _validate_oversampling(specification: Specification) -> None:
    """Check that light which fills the footprint on every plane gives the required oversampling ratio.

    Raises
    ------
    DesignError
        If no lens can reach it; the message states the limit of each value that could give way.
    """
    recording = specification.recording
    if recording is None:
        return
    scene, kind, required = specification.required_object, recording.object, recording.oversampling
    article = "a" if kind in ("phase", "complex") else "an"
    unknowns = UNKNOWNS_OF_KIND[kind]
    highest = INTENSITY_DEGREES / unknowns
    frames = recording.frames
    if required > frames * highest * (1.0 + 1e-9):
        least = math.ceil(required / highest - 1e-9)
        raise DesignError(
            f"infeasible: recording, oversampling = {required:g}: {article} {kind} object has at most "
            f"{highest:g} measurements for each unknown in a frame, because its intensity has only "
            f"{INTENSITY_DEGREES} times the degrees of freedom of its light; {_counted(frames)} can give "
            f"{frames * highest:g}, with any field, support, NA and pixel pitch; record at least {least} "
            f"frames, or require at most {frames * highest:g}"
        )
    from scipy.optimize import brentq

    half_side_mm = 0.5 * min(specification.sensor.size_mm)
    lights_mm = [2.0 * min(half_side_mm, limit) for limit in specification.footprint_limits()[:frames]]
    wavelength, pitch = min(specification.wavelengths_um), specification.sensor.pixel_pitch_um
    size_mm = scene.field_diameter_mm if recording.support_mm is None else recording.support_mm
    name = "field" if recording.support_mm is None else "support"
    degrees = sbp_object(size_mm, scene.numerical_aperture, wavelength)

    def largest_ratio(factor: float) -> float:
        """Return the largest ratio for a size, NA or pixel pitch that is multiplied by a factor."""
        return largest_oversampling(kind, lights_mm, factor * pitch, degrees)

    largest = largest_ratio(1.0)
    if required <= largest * (1.0 + 1e-9):
        return
    # With this factor each frame has all measurements that it can have.
    smallest = min(0.4e3 * min(lights_mm) / (pitch * math.sqrt(degrees)), 1.0)
    reachable = min(required, largest_ratio(smallest))
    factor = brentq(lambda factor: largest_ratio(factor) - reachable, smallest, 1.0)
    widest = largest_oversampling(kind, [max(lights_mm)], pitch, degrees)
    more = math.ceil((required - largest) / widest - 1e-9)
    circles = ", ".join(f"{light:.4g}" for light in dict.fromkeys(lights_mm))
    raise DesignError(
        f"infeasible: recording, oversampling = {required:g}: the pixels in a circle of {circles} mm "
        f"give {article} {kind} object of {size_mm:g} mm at NA {scene.numerical_aperture:g} and "
        f"{wavelength:g} µm at most {largest:.4g} measurements for each unknown in {_counted(frames)}, "
        f"whatever the lens; one of these must give way: the {name} at most "
        f"{_floored(factor * size_mm)} mm, or NA at most {_floored(factor * scene.numerical_aperture)}, or "
        f"pixel_pitch_um at most {_floored(factor * pitch)}, or at least {frames + more} frames"
    )


def _counted(frames: int) -> str:
    return "one frame" if frames == 1 else f"{frames} frames"


def _floored(value: float) -> str:
    """Return a value with four digits, rounded down."""
    step = 10.0 ** (math.floor(math.log10(value)) - 3)
    return f"{math.floor(value / step * (1.0 + 1e-12)) * step:.4g}"
