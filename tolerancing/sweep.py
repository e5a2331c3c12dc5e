"""Sweeps: one parameter varied by itself, as in the paper's Figs. 7(b) and 7(c)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from lensdesign.system import Finite, Lens, Positive, tuples
from tolerancing.merit import check_field_point
from tolerancing.perturbations import PerturbedParameter
from tolerancing.pupil_merits import LinePairContrast, Orientation


class Sweep(PerturbedParameter):
    """One parameter taken through some values while all else stays nominal.

    Attributes
    ----------
    values
        Deltas from nominal, in the parameter's unit.
    merits
        Names of the study's merits to score at each value.
    line_widths_um
        Line pairs whose contrast to score at each value, with and without refocusing.
    orientation
        Axis along which the bars follow each other, or the worse of both.
    field_mm
        Object point (x, y) of the line pairs.
    picture_values
        Those of the values at which to keep pictures of the line pairs.
    """

    values: Annotated[tuple[Finite, ...], Field(min_length=1)]
    merits: tuple[str, ...] = ()
    line_widths_um: tuple[Positive, ...] = ()
    orientation: Orientation = "worse"
    field_mm: tuple[Finite, Finite] = (0.0, 0.0)
    picture_values: tuple[Finite, ...] = ()

    _lists = field_validator(
        "values", "merits", "line_widths_um", "field_mm", "picture_values", mode="before"
    )(tuples)

    @model_validator(mode="after")
    def _consistent(self) -> Sweep:
        if not self.merits and not self.line_widths_um:
            raise ValueError("nothing to score: give merits or line_widths_um")
        strangers = [v for v in self.picture_values if v not in self.values]
        if strangers:
            raise ValueError(
                f"picture_values = {strangers}: allowed are those of values, {list(self.values)}"
            )
        if self.picture_values and not self.line_widths_um:
            raise ValueError("picture_values: pictures are of line pairs; give line_widths_um")
        for key in ("values", "line_widths_um", "merits"):
            items = getattr(self, key)
            if len(set(items)) < len(items):
                raise ValueError(f"{key} = {list(items)}: one stands there twice")
        return self

    @property
    def label(self) -> str:
        """What to call the sweep."""
        return self.name or f"{self.target} {self.parameter}".replace(" ", "_")

    def check(self, lens: Lens) -> None:
        super().check(lens)
        check_field_point(lens, self.field_mm, "field_mm")

    def line_pairs(self) -> tuple[LinePairContrast, ...]:
        """The contrasts to score, each line width refocused and not; limit 0 is where lines reverse."""
        return tuple(
            LinePairContrast(
                kind="line_pair_contrast",
                name=f"contrast_{width:g}um{'_refocused' if refocus else ''}".replace(".", "p"),
                at_least=0.0,
                line_width_um=width,
                orientation=self.orientation,
                field_mm=self.field_mm,
                refocus=refocus,
            )
            for width in self.line_widths_um
            for refocus in (True, False)
        )
