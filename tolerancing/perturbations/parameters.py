"""Perturbed parameters of the lens, its surfaces and elements, the object, the sensor and the light."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from lensdesign.common.frozen_model import FiniteNumber, FrozenModel
from lensdesign.common.toml_files import joined_faults, pick, unknown_key, validate
from lensdesign.errors import DesignError, MaterialError
from lensdesign.lens.coatings.coating import NO_FILMS, has_films
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SURFACE_DELTAS, Pose
from lensdesign.lens.shapes.registry import parameters
from lensdesign.lens.surface_roughness import NO_ROUGHNESS
from lensdesign.lens.temperature import ALUMINIUM_PER_K
from tolerancing.perturbations.distributions.base import Distribution
from tolerancing.perturbations.distributions.discrete import Discrete
from tolerancing.perturbations.distributions.registry import DISTRIBUTIONS

SHAPE_PARAMETERS = tuple(parameters())
"""Parameters of all surface shapes."""

RADII = {
    f"{radius.removesuffix('mm')}{unit}": radius
    for radius in SHAPE_PARAMETERS
    if radius.startswith("radius")
    for unit in ("mm", "percent", "fringes")
}
"""Parameters that change a radius, and the design file's key of that radius."""

IRREGULARITIES = ("irregularity_pv_waves", "irregularity_rms_waves")
GLASS_PARAMETERS = ("index", "abbe_percent")

ROUGHNESS = "roughness_rms_nm"
"""Parameter that changes how much light a surface scatters, and no ray."""

COATING_THICKNESS = "coating_thickness_percent"
"""Parameter that changes how much light a surface transmits and with which phase, and no ray."""

LENS_PARAMETERS = tuple(f.name for f in fields(Pose) if f.name != "pivot_z_mm")
"""Parameters of the whole lens: the values of a pose."""

RUNOUTS = ("tir_x_mm", "tir_y_mm")
"""Total indicator runout of a surface at its clear semi-diameter, along one axis."""

TILTS = ("tilt_x_deg", "tilt_y_deg")
ROLLS = ("roll_x_deg", "roll_y_deg")
EDGE_DIFFERENCES = ("edge_difference_x_mm", "edge_difference_y_mm")

PLANE_DISTANCE = re.compile(r"plane_distance_([1-9]\d?)_mm")

FIXED_TARGETS = ("object", "sensor", "light", "environment", "reconstruction")

PARAMETERS = {
    "lens": LENS_PARAMETERS,
    # Waves and fringes are those of 632.8 nm over the clear semi-diameter.
    "surface": tuple(
        dict.fromkeys(
            (*SURFACE_DELTAS, *RUNOUTS, *RADII, *SHAPE_PARAMETERS, GLASS_PARAMETERS[1], *IRREGULARITIES)
        )
    ),
    # Motions of a whole glass element, and wedge between its surfaces.
    "element": ("decenter_x_mm", "decenter_y_mm", "despace_mm", *TILTS, *ROLLS, *EDGE_DIFFERENCES),
    # A longer working distance moves the object away from the lens.
    "object": ("decenter_x_mm", "decenter_y_mm", "working_distance_mm"),
    # The sensor in all planes, and errors of the distance of a single plane from the lens.
    "sensor": (
        "decenter_x_mm",
        "decenter_y_mm",
        "distance_mm",
        "plane_distance_1_mm",
        "plane_distance_2_mm",
        "tilt_x_deg",
        "tilt_y_deg",
    ),
    # The deviation from the wavelength that the reconstruction assumes.
    "light": ("wavelength_um",),
    # The deviation from the design temperature of 20 degrees Celsius.
    "environment": ("temperature_c",),
    # The number of slices of each surface: a value, not a delta.
    "reconstruction": ("slices",),
}
"""Parameters that can be perturbed, by the first word of the target."""

UNITS = ("mm", "um", "nm", "deg", "percent", "fringes", "waves", "c")

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]


class PerturbedParameter(FrozenModel):
    """A parameter of the lens, of one of its surfaces or elements, or of its surroundings.

    Attributes
    ----------
    name
        Lower-case letters, digits and underscores; default: target and parameter.
    target
        ``lens``, ``surface N`` or ``element N`` with N counted from 1, ``object``, ``sensor``, ``light``,
        ``environment`` or ``reconstruction``.
    parameter
        One of the target's `PARAMETERS`. Values are deltas in the unit of its suffix.
    seat
        Pivot of an element's tilt or roll. A tilt pivots about the vertex of the ``front`` or ``back``
        surface, or about a point this many mm behind the front vertex. A roll pivots about the centre of
        curvature of the ``front`` or ``back`` surface, which rests on the seat of the mount.
    mount_expansion_per_k
        Coefficient of linear expansion of the mount, for target ``environment``; default: aluminium.
    """

    name: Name = ""
    target: str
    parameter: str
    seat: Literal["front", "back"] | Annotated[float, Field(strict=False, allow_inf_nan=False)] = "front"
    mount_expansion_per_k: FiniteNumber = ALUMINIUM_PER_K

    @field_validator("target")
    @classmethod
    def _target(cls, value: str) -> str:
        if value not in ("lens", *FIXED_TARGETS) and not re.fullmatch(
            r"(surface|element) [1-9]\d{0,3}", value
        ):
            raise ValueError(
                f"{value!r} is not a target; allowed: lens, surface N, element N (N from 1), "
                f"{', '.join(FIXED_TARGETS)}"
            )
        return value

    @model_validator(mode="after")
    def _known(self) -> PerturbedParameter:
        allowed = PARAMETERS[self.target.split()[0]]
        if self.parameter not in allowed and not (
            self.target == "sensor" and PLANE_DISTANCE.fullmatch(self.parameter)
        ):
            raise ValueError(
                f"parameter = {self.parameter!r}: {self.target} has no such parameter; "
                f"allowed: {', '.join(allowed)}"
            )
        if "seat" in self.model_fields_set:
            self._check_seat()
        if "mount_expansion_per_k" in self.model_fields_set and self.target != "environment":
            raise ValueError(
                f"mount_expansion_per_k = {self.mount_expansion_per_k:g}: only target = 'environment' has "
                f"this key; remove it from {self.target}"
            )
        return self

    def _check_seat(self) -> None:
        has_pivot = self.target.startswith("element") and self.parameter in (*TILTS, *ROLLS)
        if not has_pivot:
            raise ValueError(f"seat = {self.seat!r}: only tilts and rolls of an element have a seat")
        if self.parameter in ROLLS and isinstance(self.seat, float):
            raise ValueError(f"seat = {self.seat:g}: a roll needs a surface; allowed: front, back")

    @property
    def element(self) -> int | None:
        """Index of the element, from 0; None for other targets."""
        return int(self.target.split()[1]) - 1 if self.target.startswith("element") else None

    @property
    def surface(self) -> int | None:
        """Index of the surface, from 0; None for other targets."""
        return int(self.target.split()[1]) - 1 if self.target.startswith("surface") else None

    @property
    def plane(self) -> int | None:
        """Index of the sensor plane whose distance is perturbed, from 0; None for other parameters."""
        match = PLANE_DISTANCE.fullmatch(self.parameter) if self.target == "sensor" else None
        return None if match is None else int(match[1]) - 1

    @property
    def is_irregularity(self) -> bool:
        """True if the values are sizes of random surface figures, whose shapes are drawn separately."""
        return self.parameter in IRREGULARITIES

    @property
    def is_setting(self) -> bool:
        """True if the values are settings of the reconstruction rather than deltas from nominal."""
        return self.target == "reconstruction"

    def check_setting(self, values: Iterable[float]) -> None:
        """Raise a ValueError for values that are not allowed for a setting of the reconstruction."""
        most_slices = 5000
        for value in values if self.is_setting else ():
            if not (1.0 <= value <= most_slices and value == round(value)):
                raise ValueError(
                    f"{self.column} = {value:g}: must be a whole number from 1 to {most_slices}, the number "
                    "of slices itself"
                )

    @property
    def quantity(self) -> str:
        """The parameter in words, without its unit."""
        return self.parameter.removesuffix(f"_{self.unit}").replace("_", " ")

    @property
    def unit(self) -> str:
        """Unit of the deltas; empty for a conic constant or an index."""
        suffix = self.parameter.rpartition("_")[2]
        return suffix if suffix in UNITS else ""

    @property
    def column(self) -> str:
        """Column name of the values in tables, with the unit."""
        return with_unit(self.name or f"{self.target} {self.parameter}".replace(" ", "_"), self.unit)

    def check(self, lens: Lens) -> None:
        """Check that a lens has the parameter.

        Raises
        ------
        ValueError
            If the lens has no such surface, element or plane, or it has no such parameter.
        """
        if self.plane is not None and self.plane >= len(lens.sensor.plane_distances_mm):
            count = len(lens.sensor.plane_distances_mm)
            raise ValueError(f"parameter = {self.parameter!r}: the design has {count} sensor plane(s)")
        if self.element is not None:
            self._check_element(lens, self.element)
        if self.target == "environment":
            self._check_environment(lens)
        if self.surface is None:
            return
        count = len(lens.surfaces)
        if self.surface >= count:
            allowed = ", ".join(["lens", *(f"surface {i + 1}" for i in range(count)), *FIXED_TARGETS])
            raise ValueError(f"target = {self.target!r}: the design has no such surface; allowed: {allowed}")
        self._check_surface(lens, self.surface)

    @staticmethod
    def _check_environment(lens: Lens) -> None:
        from lensdesign.lens.temperature import check_heat

        try:
            check_heat(lens)
        except MaterialError as error:
            raise ValueError(f"target = 'environment': {error}") from error

    def _check_element(self, lens: Lens, index: int) -> None:
        count = len(lens.glass_fronts)
        if index >= count:
            allowed = ", ".join(f"element {i + 1}" for i in range(count))
            raise ValueError(f"target = {self.target!r}: the design has no such element; allowed: {allowed}")
        surface = lens.surfaces[lens.glass_fronts[index] + (self.seat == "back")]
        if self.parameter in ROLLS and surface.radius_mm is None:
            raise ValueError(f"parameter = {self.parameter!r}: the {self.seat} of {self.target} is a plane")

    def _check_surface(self, lens: Lens, index: int) -> None:
        surface, key = lens.surfaces[index], f"parameter = {self.parameter!r}"
        of_shape = RADII.get(self.parameter, self.parameter)
        if of_shape in SHAPE_PARAMETERS and of_shape not in surface.shape_parameters:
            raise ValueError(
                f"{key}: the shape of {self.target} ({surface.shape_class.NAME}) has no {of_shape}; "
                f"it has {', '.join(surface.shape_parameters)}"
            )
        if self.parameter in RADII and getattr(surface, of_shape) is None:
            raise ValueError(f"{key}: {self.target} is a plane and has no {of_shape}")
        counted = self.unit == "fringes" or self.parameter in (*IRREGULARITIES, *RUNOUTS)
        if counted and surface.semi_diameter_mm is None:
            raise ValueError(
                f"{key}: {self.target} has no semi_diameter_mm, to which this parameter refers; give it one"
            )
        if self.parameter == ROUGHNESS and surface.roughness is None:
            raise ValueError(f"{key}: {self.target}: {NO_ROUGHNESS}")
        if self.parameter == COATING_THICKNESS and not has_films(surface.coating):
            raise ValueError(f"{key}: {self.target}: {NO_FILMS}")
        if index < len(lens.surfaces) - 1:
            if self.parameter in GLASS_PARAMETERS and is_gap(surface.material):
                raise ValueError(f"{key}: {self.target} has air behind it, no glass")
        elif self.parameter in ("thickness_mm", *GLASS_PARAMETERS):
            raise ValueError(
                f"{key}: {self.target} is the last surface; the space behind it is set by distance_mm of the "
                "sensor"
            )


class Perturbation(PerturbedParameter):
    """A parameter that varies at random from lens to lens.

    Attributes
    ----------
    name
        Lower-case letters, digits and underscores; default: target and parameter.
    target
        ``lens``, ``surface N`` or ``element N`` with N counted from 1, ``object``, ``sensor``, ``light``,
        ``environment`` or ``reconstruction``.
    parameter
        One of the target's parameters in :data:`tolerancing.perturbations.PARAMETERS`. Values are deviations
        from nominal, in the unit of the parameter's suffix.
    seat
        Pivot of an element's tilt or roll; see :class:`tolerancing.perturbations.PerturbedParameter`.
    mount_expansion_per_k
        Coefficient of linear expansion of the mount in 1/K, for target ``environment``; default: aluminium.
    group
        Name of a group. Perturbations of one group share the same draw.
    distribution
        Distribution of the deviations.

    Examples
    --------
    >>> from tolerancing import Perturbation
    >>> from tolerancing.perturbations.distributions import Uniform
    >>> thickness = Perturbation(
    ...     target="surface 1", parameter="thickness_mm", distribution=Uniform(half_width=0.02)
    ... )
    >>> thickness.column, thickness.tolerance
    ('surface_1_thickness_mm', 0.02)
    """

    group: Name | None = None
    distribution: SerializeAsAny[Distribution]

    @model_validator(mode="after")
    def _whole_settings(self) -> Perturbation:
        if self.is_setting:
            if not isinstance(self.distribution, Discrete):
                raise ValueError(
                    f"distribution = {self.distribution.kind!r}: {self.column} has separate values; allowed: "
                    "discrete"
                )
            self.check_setting(self.distribution.levels)
        return self

    @property
    def file_name(self) -> str | None:
        """Name of the file that the distribution reads, relative to the study; None if it reads no file."""
        return self.distribution.file_name

    @property
    def tolerance(self) -> float:
        """Largest allowed deviation: from the mean, or for an irregularity from a perfect surface."""
        shape = self.distribution
        return shape.largest + (abs(shape.centre) if self.is_irregularity else 0.0)

    def scaled(self, factor: float) -> Self:
        """Return the perturbation with its tolerance multiplied; the mean of an irregularity scales as well.

        Raises
        ------
        InputError
            If the factor is not a finite number above 0.
        DesignError
            If a width leaves its allowed range.
        """
        shape = self.distribution.scaled(factor)
        if self.is_irregularity:
            shape = shape.model_copy(update={"mean": factor * shape.mean})
        return self.model_copy(update={"distribution": shape})

    def loaded(self, folder: Path) -> Self:
        """Return the perturbation with the data of its distribution's file, read relative to `folder`."""
        return self.model_copy(update={"distribution": self.distribution.loaded(folder)})


def with_unit(name: str, unit: str) -> str:
    """Return a name that ends with its unit."""
    return name if not unit or name.endswith(f"_{unit}") else f"{name}_{unit}"


def perturbation_from_table(table: dict[str, Any], source: str) -> Perturbation:
    """Read one ``[[perturbation]]`` table, which also has the keys of its distribution.

    Parameters
    ----------
    table
        Keys and values of the table.
    source
        File and table, for error messages.

    Raises
    ------
    DesignError
        If a key or value is not allowed. The message lists every fault.

    Examples
    --------
    >>> table = {"target": "lens", "parameter": "tilt_x_deg", "distribution": "normal", "sigma": 0.1}
    >>> perturbation_from_table(table, "study.toml").column
    'lens_tilt_x_deg'
    """
    shape = pick(DISTRIBUTIONS, table, "distribution", source)
    own = [name for name in Perturbation.model_fields if name != "distribution"]
    allowed = [*own, "distribution", *shape.model_fields]
    unknown = [key for key in table if key not in allowed]
    if unknown:
        lines = [f"{source}: {key}: {unknown_key(key, allowed)}" for key in unknown]
        raise DesignError(joined_faults(lines))
    distribution = validate(shape, {k: v for k, v in table.items() if k in shape.model_fields}, source)
    return validate(
        Perturbation, {k: v for k, v in table.items() if k in own} | {"distribution": distribution}, source
    )


def validate_in_meridian(parameter: PerturbedParameter) -> None:
    """Check that the effect of a parameter can be computed on a meridional line, in the plane x = 0.

    Raises
    ------
    ValueError
        If the parameter moves light out of the plane x = 0 or has no effect on the line.
    """
    name = parameter.parameter
    out_of_plane = (
        ("_x_mm" in name and not name.startswith("radius"))
        or name in ("tilt_y_deg", "roll_y_deg")
        or (parameter.target == "sensor" and name == "tilt_x_deg")
        or parameter.is_irregularity
    )
    if out_of_plane:
        raise ValueError(
            f"{parameter.column}: cannot be simulated on a meridional line along y; allowed: perturbations "
            "that keep light in the plane x = 0, such as decenter_y_mm and tilt_x_deg of the lens"
        )
