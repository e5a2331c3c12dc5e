"""Tables of a specification: constraints, tolerances, environment and settings of the search."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from lensdesign.analysis.oversampling import ObjectKind
from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.lens.catalogues.thermal import COLDEST_C, HOTTEST_C, REFERENCE_C
from lensdesign.lens.temperature import ALUMINIUM_PER_K
from lensdesign.optimization.nlopt_driver import ALGORITHMS

Angle = Annotated[Positive, Field(lt=90.0)]


class FieldSpread(FrozenModel):
    """A limit of the spread angle for one field height.

    Attributes
    ----------
    field_mm
        Field height.
    max_spread_deg
        Largest spread angle at this height.
    """

    field_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    max_spread_deg: Annotated[Positive, Field(lt=90.0)]


class Constraints(FrozenModel):
    """Constraints over the whole field, the whole stop and all wavelengths.

    Attributes
    ----------
    max_spread_deg
        Largest spread angle in the medium in front of the sensor; ``"sensor"`` means Eq. 2 of the paper,
        ``"none"`` no limit.
    max_spread_xy_deg
        Tighter limits of the spread along x and along y, as arcsines of the direction cosines.
    field_spread
        Tighter limits for single field heights.
    max_footprint_radius_mm
        Largest distance from the axis on each sensor plane (one number, or one for each plane);
        ``"sensor"`` means half the sensor's shorter side, ``"sensor rectangle"`` the sides of the sensor
        separately, ``"none"`` no limit.
    min_throughput
        Smallest fraction of the rays of each field point that pass all clear semi-diameters.
    min_edge_thickness_mm
        Smallest thickness of glass at the ground diameter that will be drawn: that of the edge table, or else
        the clear diameter with room for the mount and the bevels. A surface that ends before it continues
        as a flat ring.
    min_center_thickness_mm
        Smallest thickness of each glass element on the axis.
    min_air_gap_mm
        Smallest gap between elements, on the axis and at the largest clear semi-diameter of the lens.
    max_edge_slope_deg
        Largest slope of each surface at its clear edge.
    max_lens_thickness_mm
        Largest distance from the first vertex to the last.
    max_track_mm
        Largest distance from the object to the last sensor plane.
    max_semi_diameter_mm
        Largest distance from the axis of any ray on any surface.
    min_yield
        Smallest fraction of lenses as built that keep all limits of the tolerance study.
    max_as_built_rms_waves
        Largest wavefront error as built, root mean square over pupil and lenses, at each object point.
    max_as_built_reconstruction_loss
        Largest mean over lenses as built of each merit `reconstruction_loss` of the study.
    max_ghost_fraction
        Largest power of all ghosts on the sensor relative to the direct light, on each sensor plane, for the
        lens as designed at its first wavelength. Surfaces count as bare if all coatings are ideal.
    """

    max_spread_deg: Annotated[Positive, Field(lt=90.0)] | Literal["sensor", "none"] = "sensor"
    max_spread_xy_deg: tuple[Angle, Angle] | None = None
    field_spread: tuple[FieldSpread, ...] = ()
    max_footprint_radius_mm: (
        Positive | tuple[Positive, ...] | Literal["sensor", "sensor rectangle", "none"]
    ) = "sensor"
    min_throughput: Annotated[Positive, Field(le=1.0)] = 1.0
    min_edge_thickness_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.5
    min_center_thickness_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.5
    min_air_gap_mm: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    max_edge_slope_deg: Annotated[Positive, Field(lt=90.0)] = 75.0
    max_lens_thickness_mm: Positive | None = None
    max_track_mm: Positive | None = None
    max_semi_diameter_mm: Positive | None = None
    min_yield: Annotated[Positive, Field(lt=1.0)] | None = None
    max_as_built_rms_waves: Positive | None = None
    max_as_built_reconstruction_loss: Annotated[Positive, Field(lt=1.0)] | None = None
    max_ghost_fraction: Annotated[Positive, Field(lt=1.0)] | None = None


class Recording(FrozenModel):
    """Recording from which the object must be found.

    Attributes
    ----------
    frames
        Number of the sensor planes, from the first, on which a frame is recorded.
    object
        Kind of the object: ``amplitude``, ``phase`` or ``complex``.
    oversampling
        Smallest oversampling ratio (:func:`lensdesign.analysis.oversampling_of`) at each wavelength.
    support_mm
        Diameter of the part of the object that is unknown (default: the field).
    """

    frames: Annotated[int, Field(ge=1, le=1000)]
    object: ObjectKind
    oversampling: Positive
    support_mm: Positive | None = None


class Tolerances(FrozenModel):
    """Manufacturing tolerances of the lens.

    Attributes
    ----------
    study
        Path of a tolerance study, relative to the specification. Its perturbations, compensators and limits
        of merits are used; a good lens keeps all limits. The design that it names is ignored.
    factor
        Factor by which all tolerances are multiplied.
    cost
        Cost of each lens including its elements, in place of `factor`: all tolerances are multiplied by the
        factor that gives this cost.
    costs
        Path of a table of costs, relative to the specification (default: the table of the toolkit).
    trials
        Number of Monte Carlo trials of each lens that is compared at the end.
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


class Environment(FrozenModel):
    """Temperatures, besides that of the design, at which a lens must meet its specification.

    Attributes
    ----------
    temperatures_c
        Temperatures of lens, mount and air. At each of them, spread, footprint, throughput and wavefronts as
        built must meet the constraints, with the sensor planes moved by the mount. Constraints on lengths
        apply to the lens as designed.
    mount_expansion_per_k
        Linear expansion coefficient of the mount of elements, object and sensor.
    """

    temperatures_c: Annotated[
        tuple[Annotated[float, Field(ge=COLDEST_C, le=HOTTEST_C)], ...], Field(min_length=1)
    ]
    mount_expansion_per_k: Annotated[float, Field(ge=-1e-3, le=1e-3)] = ALUMINIUM_PER_K

    @field_validator("temperatures_c")
    @classmethod
    def _others(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if REFERENCE_C in value:
            raise ValueError(
                f"{REFERENCE_C:g} C is the temperature of the design, which always counts; remove it"
            )
        if len(set(value)) < len(value):
            raise ValueError(f"{list(value)}: a temperature is given twice")
        return value


LOSS_GOAL = "as-built reconstruction loss"
"""Goal that needs a merit `reconstruction_loss`."""

GHOST_GOAL = "smallest ghost fraction"
"""Goal that minimizes the power of ghosts on the sensor."""

AS_BUILT_GOALS = ("as-built rms", "yield", LOSS_GOAL)
"""Goals that need tolerances."""


LARGEST = {"longest working distance": "working_distance_mm", "largest field": "field_diameter_mm"}
"""Goals that maximize a variable, and its parameter."""


class Settings(FrozenModel):
    """Settings of the search.

    Attributes
    ----------
    goal
        ``smallest spread`` (the largest ratio of spread to limit over the wavelengths, Eq. 2),
        ``smallest spread angle`` (the largest angle at any wavelength), ``thinnest lens``,
        ``smallest aperture``, ``shortest track`` (object to last sensor plane), ``longest working distance``
        and ``largest field`` (which must be a variable), ``smallest ghost fraction`` (the power of all ghosts
        on the worst sensor plane), ``as-built rms`` (the largest wavefront error of built lenses at the
        tolerances' object points), ``yield`` (the fraction of lenses that keep all limits
        of the study), or ``as-built reconstruction loss`` (the largest mean over built lenses of a merit
        `reconstruction_loss` of the study).
    start
        First start: ``design`` is the lens in the file, ``plate`` the same with flat variable surfaces,
        ``random`` a random point within the bounds.
    stop
        ``fixed`` keeps the semi-diameter of the stop; ``numerical aperture`` adapts it to the NA.
    algorithm
        Algorithm of nlopt, see :data:`lensdesign.optimization.nlopt_driver.ALGORITHMS`. The result of a
        global algorithm is refined by SLSQP.
    starts
        Largest number of starts of each choice of glasses; those after the first are random.
    agreeing
        Number of starts that must lead to the best lens before the search ends.
    max_evaluations
        Largest number of evaluations of a lens for each choice of glasses.
    max_seconds
        Time limit of the whole search, divided among the choices of glasses; None sets no limit. A result
        that the limit has shortened depends on the machine.
    """

    goal: Literal[
        "smallest spread",
        "smallest spread angle",
        "thinnest lens",
        "smallest aperture",
        "shortest track",
        "longest working distance",
        "largest field",
        "smallest ghost fraction",
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
