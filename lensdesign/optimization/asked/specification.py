"""Specification files: what to optimize, within which bounds, to which end, under which constraints.

A specification is a design file with three more tables: ``[optimize]``, ``[constraints]`` and one
``[[variable]]`` for each thing that may change. The design in it is the start.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from lensdesign.common.input_files import refuse_outside
from lensdesign.common.section import Finite, Positive, Section, tuples
from lensdesign.common.toml_files import read_toml, validate
from lensdesign.errors import DesignError
from lensdesign.files.design import refuse_doubtful, refuse_other_kind
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import term_of
from lensdesign.lens.shapes.registry import parameters
from lensdesign.optimization.nlopt_driver import ALGORITHMS
from lensdesign.tracing.gradients import Variable


class VariableRange(Section):
    """One thing that may change.

    Attributes
    ----------
    parameter
        ``radius_mm``, ``conic``, ``asphere_4``, ``asphere_6``, ... (coefficients in mm^-3, mm^-5, ...),
        ``thickness_mm``, ``working_distance_mm`` or ``material``.
    surface
        Which surface, counted from 1; none for the working distance.
    bounds
        Smallest and largest value, in the parameter's own unit.
    smallest_radius_mm
        For a radius, in place of bounds: the surface may be anything from this radius through a plane
        to the same radius bent the other way.
    choices
        For a material, in place of bounds: the glasses to try.
    """

    parameter: str
    surface: Annotated[int, Field(ge=1)] | None = None
    bounds: tuple[Finite, Finite] | None = None
    smallest_radius_mm: Positive | None = None
    choices: tuple[str | float, ...] = ()

    _lists = field_validator("bounds", "choices", mode="before")(tuples)

    @model_validator(mode="after")
    def _complete(self) -> VariableRange:
        if self.parameter != "material":
            self.kind()
        bent = self.parameter.startswith("radius")
        needed = "smallest_radius_mm" if bent else "choices" if self.parameter == "material" else "bounds"
        for name in ("bounds", "smallest_radius_mm", "choices"):
            given = getattr(self, name) not in (None, ())
            if given != (name == needed):
                raise ValueError(f"{self.parameter} needs {needed}" + (f", not {name}" if given else ""))
        if (self.surface is None) != (self.parameter == "working_distance_mm"):
            raise ValueError(f"{self.parameter} {'takes no' if self.surface else 'needs a'} surface number")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds = {list(self.bounds)}: the first must be less than the second")
        lengths = ("thickness_mm", "working_distance_mm")
        if (
            self.bounds is not None
            and self.parameter in lengths
            and not 0.0 < self.bounds[0] < self.bounds[1] <= 1e9
        ):
            raise ValueError(
                f"bounds = {list(self.bounds)}: {self.parameter} must be greater than 0 and at most 1e9"
            )
        return self

    def kind(self) -> str:
        """Kind as :class:`lensdesign.tracing.gradients.Variable` names it."""
        lengths = ("thickness_mm", "working_distance_mm")
        if self.parameter in lengths:
            return self.parameter.removesuffix("_mm")
        if self.parameter in parameters():
            return term_of(self.parameter)
        allowed = ", ".join([*parameters(), *lengths, "material"])
        raise ValueError(f"parameter = {self.parameter!r}: unknown; allowed: {allowed}")

    @property
    def name(self) -> str:
        """As reports call it."""
        return self.parameter if self.surface is None else f"surface {self.surface} {self.parameter}"

    def variable(self) -> Variable:
        """As the ray derivatives call it."""
        return Variable(self.kind(), (self.surface or 1) - 1)

    def limits(self) -> tuple[float, float]:
        """Bounds of what is varied inside: curvature for a radius, else the value itself."""
        if self.smallest_radius_mm is not None:
            return -1.0 / self.smallest_radius_mm, 1.0 / self.smallest_radius_mm
        assert self.bounds is not None  # the validator saw to it
        return self.bounds


Angle = Annotated[float, Field(gt=0.0, lt=90.0)]


class FieldSpread(Section):
    """A spread limit of its own for one field height."""

    field_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    max_spread_deg: Annotated[float, Field(gt=0.0, lt=90.0)]


class Constraints(Section):
    """What must hold, over the whole field, the whole stop and all wavelengths.

    Attributes
    ----------
    max_spread_deg
        Largest spread angle; ``"sensor"`` is Eq. 2 of the paper, ``"none"`` no limit.
    max_spread_xy_deg
        Tighter limits of the spread along x and along y: arcsines of the direction cosines.
    field_spread
        Tighter limits for single field heights.
    max_footprint_radius_mm
        Largest distance from the axis on each sensor plane (one number, or one for each plane);
        ``"sensor"`` is half the sensor's shorter side, ``"sensor rectangle"`` all of the sensor, side by
        side, ``"none"`` no limit.
    min_throughput
        Share of each field's rays that must pass all clear semi-diameters.
    min_edge_thickness_mm
        At the ground edge: the cylinder of the edge table, or else the largest clear semi-diameter. Flat
        rings and bevels do not count.
    min_center_thickness_mm
        On the axis, of each glass element.
    min_air_gap_mm
        Between elements, on the axis and at the ground edge: room for a spacer.
    max_edge_slope_deg
        Slope of each surface at its clear edge.
    """

    max_spread_deg: Annotated[float, Field(gt=0.0, lt=90.0)] | Literal["sensor", "none"] = "sensor"
    max_spread_xy_deg: tuple[Angle, Angle] | None = None
    field_spread: tuple[FieldSpread, ...] = ()
    max_footprint_radius_mm: (
        Positive | tuple[Positive, ...] | Literal["sensor", "sensor rectangle", "none"]
    ) = "sensor"
    min_throughput: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    min_edge_thickness_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.5
    min_center_thickness_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.5
    min_air_gap_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    max_edge_slope_deg: Annotated[float, Field(gt=0.0, lt=90.0)] = 75.0

    _lists = field_validator("max_spread_xy_deg", "field_spread", "max_footprint_radius_mm", mode="before")(
        tuples
    )


class Settings(Section):
    """How to search.

    Attributes
    ----------
    goal
        ``smallest spread`` (the largest share that a wavelength takes of its own limit, Eq. 2),
        ``smallest spread angle`` (the largest angle at any wavelength), ``thinnest lens``,
        ``smallest aperture`` or ``shortest track`` (object to last sensor plane).
    start
        ``design`` is the lens in the file, ``plate`` makes its variable surfaces flat, ``random`` draws
        from the bounds.
    stop
        ``fixed`` keeps the stop's semi-diameter; ``numerical aperture`` makes it follow the NA.
    algorithm
        One of nlopt's, see :data:`lensdesign.optimization.nlopt_driver.ALGORITHMS`. What searches the whole
        box is polished by SLSQP.
    starts
        Most starts of each choice of glasses; those after the first are random.
    agreeing
        Starts are made until so many came to the best lens so far.
    max_evaluations
        Evaluations of a lens for each choice of glasses.
    max_seconds
        For everything together, shared by the choices of glasses; None sets no limit. What it cuts depends
        on the machine.
    """

    goal: Literal[
        "smallest spread", "smallest spread angle", "thinnest lens", "smallest aperture", "shortest track"
    ] = "smallest spread"
    start: Literal["design", "plate", "random"] = "design"
    stop: Literal["fixed", "numerical aperture"] = "fixed"
    algorithm: str = "slsqp"
    starts: Annotated[int, Field(ge=1, le=10000)] = 12
    agreeing: Annotated[int, Field(ge=1, le=10000)] = 3
    max_evaluations: Annotated[int, Field(ge=1, le=10**9)] = 20_000
    max_seconds: Positive | None = None

    @field_validator("algorithm")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in ALGORITHMS:
            raise ValueError(f"unknown algorithm {value!r}; allowed: {', '.join(ALGORITHMS)}")
        return value


class Specification(Lens):
    """A lens to start from, and what may become of it."""

    optimize: Settings = Settings()
    constraints: Constraints = Constraints()
    variables: Annotated[tuple[VariableRange, ...], Field(alias="variable", min_length=1)]

    _variable_lists = field_validator("variables", mode="before")(tuples)

    @model_validator(mode="after")
    def _consistent(self) -> Specification:
        for number, surface in enumerate(self.surfaces, start=1):
            if surface.figure is not None:
                raise ValueError(f"surface {number}: optimize the nominal lens, without a measured figure")
        seen = set()
        for v in self.variables:
            if v.surface is not None and v.surface > len(self.surfaces):
                raise ValueError(
                    f"variable {v.name}: there is no such surface; the lens has {len(self.surfaces)} surfaces"
                )
            if v.parameter == "thickness_mm" and v.surface == len(self.surfaces):
                raise ValueError(f"variable {v.name}: the last surface has no thickness")
            if v.name in seen:
                raise ValueError(f"variable {v.name} is given twice")
            seen.add(v.name)
        radii = self.constraints.max_footprint_radius_mm
        if isinstance(radii, tuple) and len(radii) != len(self.sensor.plane_distances_mm):
            raise ValueError(
                f"max_footprint_radius_mm holds {len(radii)} values for "
                f"{len(self.sensor.plane_distances_mm)} sensor planes"
            )
        for limit in self.constraints.field_spread:
            if limit.field_mm > self.half_field_mm:
                raise ValueError(
                    f"field_spread at {limit.field_mm:g} mm lies outside the half field of "
                    f"{self.half_field_mm:g} mm"
                )
        return self

    @property
    def lens(self) -> Lens:
        """The start, as a plain lens."""
        return Lens(**{name: getattr(self, name) for name in Lens.model_fields})

    def spread_limit(self, wavelength_um: float) -> float:
        """Largest allowed sine of the spread angle at a wavelength; inf where there is no limit."""
        limit = self.constraints.max_spread_deg
        if limit == "none":
            return math.inf
        if limit == "sensor":
            return min(1.0, wavelength_um / (2.0 * self.sensor.pixel_pitch_um))
        return math.sin(math.radians(float(limit)))

    def footprint_limits(self) -> tuple[float, ...]:
        """Largest allowed distance from the axis on each sensor plane, in mm; inf for none all round."""
        limit = self.constraints.max_footprint_radius_mm
        planes = len(self.sensor.plane_distances_mm)
        if limit in ("none", "sensor rectangle"):
            return (math.inf,) * planes
        if limit == "sensor":
            return (0.5 * min(self.sensor.size_mm),) * planes
        return limit if isinstance(limit, tuple) else (float(limit),) * planes


def load_specification(path: str | os.PathLike[str]) -> Specification:
    """Read a specification file.

    Raises
    ------
    DesignError
        If it cannot be read, is wrong, or cannot be met: the etendue bound says so before any search.
    MaterialError
        If a glass, one of the choices included, is not known at a wavelength.
    """
    path = Path(path)
    data = read_toml(path)
    refuse_other_kind(data, path, "specification")
    specification = validate(Specification, data, path)
    refuse_doubtful(specification, path)
    catalogs = tuple((path.parent / c).resolve() for c in specification.glass_catalogs)
    for catalog in catalogs:
        refuse_outside(catalog, path, "glass_catalogs", DesignError)
    specification = specification.model_copy(update={"glass_catalogs": catalogs})
    try:
        for wavelength in specification.wavelengths_um:
            specification.indices(wavelength)
            _check_choices(specification, wavelength)
        refuse_impossible(specification)
    except (DesignError, ValueError) as error:
        raise type(error)(f"{path}: {error}") from error
    return specification


def _check_choices(specification: Specification, wavelength_um: float) -> None:
    from lensdesign.lens.glass import refractive_index

    for variable in specification.variables:
        for glass in variable.choices:
            refractive_index(glass, wavelength_um, catalogs=specification.glass_catalogs)


def refuse_impossible(specification: Specification) -> None:
    """Refuse what no lens can do: FOV x NA (the Lagrange invariant) must fit through sensor and edge.

    Raises
    ------
    DesignError
        With the numbers, before any ray is traced.
    """
    scene = specification.object
    invariant = scene.field_diameter_mm * scene.numerical_aperture
    sine = min(specification.spread_limit(w) for w in specification.wavelengths_um)
    if math.isinf(sine):
        return
    widest = 2.0 * min(specification.footprint_limits())
    if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
        widest = math.hypot(*specification.sensor.size_mm)
    if invariant > widest * sine:
        raise DesignError(
            "infeasible: by the etendue (Lagrange) bound the exit beam is at least "
            f"FOV x NA / sin(spread limit) = {scene.field_diameter_mm:g} x {scene.numerical_aperture:g} / "
            f"{sine:.5g} = {invariant / sine:.4g} mm wide, but the footprint may be only {widest:.4g} mm; "
            "reduce field or NA, or allow a larger footprint or spread"
        )
