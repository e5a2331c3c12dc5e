"""What a search must keep, and how it goes about it: tables of a specification."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from lensdesign.common.section import Positive, Section, tuples
from lensdesign.lens.catalogues.thermal import COLDEST_C, HOTTEST_C, REFERENCE_C
from lensdesign.lens.temperature import ALUMINIUM_PER_K
from lensdesign.optimization.nlopt_driver import ALGORITHMS

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
    max_lens_thickness_mm
        From the first vertex to the last.
    max_track_mm
        From the object to the last sensor plane.
    max_semi_diameter_mm
        Largest distance from the axis of any ray on any surface.
    min_yield
        Fraction of lenses as built that keep all limits of the tolerance study.
    max_as_built_rms_waves
        Largest wavefront error as built, root mean square over pupil and lenses, at each object point.
    max_as_built_reconstruction_loss
        Largest mean over lenses as built of each merit `reconstruction_loss` of the study.
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
    max_lens_thickness_mm: Positive | None = None
    max_track_mm: Positive | None = None
    max_semi_diameter_mm: Positive | None = None
    min_yield: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    max_as_built_rms_waves: Positive | None = None
    max_as_built_reconstruction_loss: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None

    _lists = field_validator("max_spread_xy_deg", "field_spread", "max_footprint_radius_mm", mode="before")(
        tuples
    )


class Tolerances(Section):
    """What a lens is built by.

    Attributes
    ----------
    study
        Tolerance study, relative to the specification: its perturbations and compensators, and the limits of
        its merits, all of which a good lens keeps. The design that it names counts for nothing.
    factor
        By which all tolerances are multiplied.
    cost
        In its place: what the tolerances of each lens cost, multiplied alike, its elements included.
    costs
        Table of costs, relative to the specification; that of the toolkit where left out.
    trials
        Monte Carlo trials of each lens that is compared in the end.
    """

    study: str
    factor: Positive = 1.0
    cost: Positive | None = None
    costs: str | None = None
    trials: Annotated[int, Field(ge=100, le=100_000)] = 1000

    @model_validator(mode="after")
    def _one_of_both(self) -> Tolerances:
        if self.cost is not None and self.factor != 1.0:
            raise ValueError(f"cost = {self.cost:g} and factor = {self.factor:g}: give one of them")
        return self


class Environment(Section):
    """Temperatures at which a lens must do what is asked of it, beside that at which it is designed.

    Attributes
    ----------
    temperatures_c
        Of lens, mount and air. At each of them spread, footprint, throughput and wavefronts as built must be
        what is asked for, with sensor planes where the mount takes them; lengths are as designed.
    mount_expansion_per_k
        Linear expansion of what holds elements, object and sensor apart.
    """

    temperatures_c: Annotated[
        tuple[Annotated[float, Field(ge=COLDEST_C, le=HOTTEST_C)], ...], Field(min_length=1)
    ]
    mount_expansion_per_k: Annotated[float, Field(ge=-1e-3, le=1e-3)] = ALUMINIUM_PER_K

    _lists = field_validator("temperatures_c", mode="before")(tuples)

    @field_validator("temperatures_c")
    @classmethod
    def _others(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if REFERENCE_C in value:
            raise ValueError(f"{REFERENCE_C:g} C is the temperature of the design, which counts anyway")
        if len(set(value)) < len(value):
            raise ValueError(f"{list(value)}: a temperature is given twice")
        return value


LOSS_GOAL = "as-built reconstruction loss"
"""Goal that takes a merit `reconstruction_loss`."""

AS_BUILT_GOALS = ("as-built rms", "yield", LOSS_GOAL)
"""Goals that take tolerances."""


class Settings(Section):
    """How to search.

    Attributes
    ----------
    goal
        ``smallest spread`` (the largest share that a wavelength takes of its own limit, Eq. 2),
        ``smallest spread angle`` (the largest angle at any wavelength), ``thinnest lens``,
        ``smallest aperture``, ``shortest track`` (object to last sensor plane), ``as-built rms`` (the largest
        wavefront error of built lenses at the tolerances' object points), ``yield`` (the fraction of
        lenses that keep all limits of the study), or ``as-built reconstruction loss`` (the largest mean
        over built lenses of a merit `reconstruction_loss` of the study).
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
        "smallest spread",
        "smallest spread angle",
        "thinnest lens",
        "smallest aperture",
        "shortest track",
        "as-built rms",
        "yield",
        "as-built reconstruction loss",
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
