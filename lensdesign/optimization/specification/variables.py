"""Variables of an optimization."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.lens.shapes.base import term_of
from lensdesign.lens.shapes.registry import parameters
from lensdesign.raytrace.gradients import Variable

LENGTHS = {
    "thickness_mm": "thickness",
    "working_distance_mm": "working_distance",
    "field_diameter_mm": "log_field",
}
"""Parameters above 0 that are lengths, and their kinds of
:class:`lensdesign.raytrace.gradients.Variable`.
"""

OF_THE_LENS = ("working_distance_mm", "field_diameter_mm", "stop")
"""Parameters that do not belong to one surface."""


class VariableRange(FrozenModel):
    """A variable with its bounds or choices.

    Attributes
    ----------
    parameter
        ``radius_mm``, ``conic``, ``asphere_4``, ``asphere_6``, ... (coefficients in mm^-3, mm^-5, ...),
        ``thickness_mm``, ``working_distance_mm``, ``field_diameter_mm``, ``material`` or ``stop`` (the number
        of the stop surface).
    surface
        Number of the surface, from 1; None for the working distance, the field and the stop.
    bounds
        Smallest and largest value, in the unit of the parameter.
    smallest_radius_mm
        Bound of a radius, in place of `bounds`: the curvature may vary between plus and minus one over this
        radius.
    choices
        Allowed values of a material (glasses) or of the stop (surface numbers), in place of `bounds`.
    """

    parameter: str
    surface: Annotated[int, Field(ge=1)] | None = None
    bounds: tuple[Finite, Finite] | None = None
    smallest_radius_mm: Positive | None = None
    choices: tuple[str | float, ...] = ()

    @model_validator(mode="after")
    def _complete(self) -> VariableRange:
        if not self.discrete:
            self.kind()
        bent = self.parameter.startswith("radius")
        needed = "smallest_radius_mm" if bent else "choices" if self.discrete else "bounds"
        for name in ("bounds", "smallest_radius_mm", "choices"):
            given = getattr(self, name) not in (None, ())
            if given != (name == needed):
                raise ValueError(f"{self.parameter} needs {needed}" + (f", not {name}" if given else ""))
        if (self.surface is None) != (self.parameter in OF_THE_LENS):
            raise ValueError(f"{self.parameter} {'takes no' if self.surface else 'needs a'} surface number")
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds = {list(self.bounds)}: the first must be less than the second")
        if (
            self.bounds is not None
            and self.parameter in LENGTHS
            and not 0.0 < self.bounds[0] < self.bounds[1] <= 1e9
        ):
            raise ValueError(
                f"bounds = {list(self.bounds)}: {self.parameter} must be greater than 0 and at most 1e9"
            )
        return self

    @property
    def discrete(self) -> bool:
        """True for a variable with choices, each of which requires its own search."""
        return self.parameter in ("material", "stop")

    def kind(self) -> str:
        """Return the kind of :class:`lensdesign.raytrace.gradients.Variable`."""
        if self.parameter in LENGTHS:
            return LENGTHS[self.parameter]
        if self.parameter in parameters():
            return term_of(self.parameter)
        if self.parameter in ("pixel_pitch_um", "numerical_aperture"):
            raise ValueError(
                f"parameter = {self.parameter!r}: is fixed in a search; `lensdesign limits` finds the "
                "largest one with which the constraints can be met"
            )
        allowed = ", ".join([*parameters(), *LENGTHS, "material", "stop"])
        raise ValueError(f"parameter = {self.parameter!r}: unknown; allowed: {allowed}")

    @property
    def name(self) -> str:
        """Name in reports."""
        return self.parameter if self.surface is None else f"surface {self.surface} {self.parameter}"

    def variable(self) -> Variable:
        """Return the variable of the ray derivatives."""
        return Variable(self.kind(), (self.surface or 1) - 1)

    def limits(self) -> tuple[float, float]:
        """Return the bounds of the internal variable.

        It is the curvature for a radius, the logarithm for the field diameter, and else the value itself.
        """
        if self.smallest_radius_mm is not None:
            return -1.0 / self.smallest_radius_mm, 1.0 / self.smallest_radius_mm
        assert self.bounds is not None  # the validator requires it
        lower, upper = self.bounds
        return (math.log(lower), math.log(upper)) if self.parameter == "field_diameter_mm" else self.bounds
