"""What may change in a search."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from lensdesign.common.section import Finite, Positive, Section, tuples
from lensdesign.lens.shapes.base import term_of
from lensdesign.lens.shapes.registry import parameters
from lensdesign.raytrace.gradients import Variable


class VariableRange(Section):
    """One thing that may change.

    Attributes
    ----------
    parameter
        ``radius_mm``, ``conic``, ``asphere_4``, ``asphere_6``, ... (coefficients in mm^-3, mm^-5, ...),
        ``thickness_mm``, ``working_distance_mm``, ``material`` or ``stop`` (which surface is the stop).
    surface
        Which surface, counted from 1; none for the working distance and for the stop.
    bounds
        Smallest and largest value, in the parameter's own unit.
    smallest_radius_mm
        For a radius, in place of bounds: the surface may be anything from this radius through a plane
        to the same radius bent the other way.
    choices
        In place of bounds: the glasses of a material, or the surfaces that may be the stop.
    """

    parameter: str
    surface: Annotated[int, Field(ge=1)] | None = None
    bounds: tuple[Finite, Finite] | None = None
    smallest_radius_mm: Positive | None = None
    choices: tuple[str | float, ...] = ()

    _lists = field_validator("bounds", "choices", mode="before")(tuples)

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
        if (self.surface is None) != (self.parameter in ("working_distance_mm", "stop")):
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

    @property
    def discrete(self) -> bool:
        """Whether it is one of some choices, each of which is a search of its own."""
        return self.parameter in ("material", "stop")

    def kind(self) -> str:
        """Kind as :class:`lensdesign.raytrace.gradients.Variable` names it."""
        lengths = ("thickness_mm", "working_distance_mm")
        if self.parameter in lengths:
            return self.parameter.removesuffix("_mm")
        if self.parameter in parameters():
            return term_of(self.parameter)
        allowed = ", ".join([*parameters(), *lengths, "material", "stop"])
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
