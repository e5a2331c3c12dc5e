"""Drawings with a predicted yield: the yield of lenses that use the full tolerances of their drawing.

The package that reads tolerance studies is above this one and is found through
:mod:`lensdesign.optimization.as_built`. It also derives tolerances that a study does not specify, and
predicts yields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, cast

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.assumed import AssumedTolerances
from lensdesign.manufacture.drawing.nominal import Stated
from lensdesign.manufacture.drawing.primitives import Drawing
from lensdesign.manufacture.drawing.sheets import DrawingOptions, drawing_as_stated, lens_drawing
from lensdesign.manufacture.drawing.tolerances import DERIVED_MARK, DrawingTolerances

MAX_YIELD_LOSS = 0.02
"""Largest allowed difference between the yields of the study and of the drawing."""


@dataclass(frozen=True)
class DerivedTolerances:
    """Tolerances of a drawing, completed with values derived from a study.

    Attributes
    ----------
    tolerances
        Tolerances of the sheet of each element.
    notes
        Sentences on the derived values.
    """

    tolerances: tuple[DrawingTolerances, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class DrawingYield:
    """Predicted yield of a lens that uses the full tolerances of its drawing.

    Attributes
    ----------
    study_yield, as_drawn_yield
        Yield (0 to 1) of the designed lens with the tolerances of the study, and of the drawn lens with
        those of the drawing; None if not every limit of the study can be predicted.
    study_interval, as_drawn_interval
        95 % intervals of these yields (0 to 1); None without a yield.
    loss
        Loss of yield by the drawing, in comparison with the study. Where the yield is not predicted, or its
        difference is within its interval, it is the loss within the limits on wavefronts and rays.
    losses
        Indications that the study does not have, each with the yield that it alone costs, largest first.
        Computed only if the total loss exceeds :data:`MAX_YIELD_LOSS`.
    is_trustworthy
        Whether the estimated higher-order terms of the prediction are small.
    reason
        Why the yields are not predicted; empty if they are.
    save
        Function that writes the study with the drawing's tolerances: ``save(path, design)``.
    """

    study_yield: float | None
    as_drawn_yield: float | None
    study_interval: tuple[float, float] | None
    as_drawn_interval: tuple[float, float] | None
    loss: float
    losses: tuple[tuple[str, float], ...]
    is_trustworthy: bool
    reason: str
    save: Callable[[Path, str], None]

    @property
    def sentence(self) -> str:
        """Yields with all tolerances of the drawing and of the study, in words."""
        as_drawn = _with_interval(self.as_drawn_yield, self.as_drawn_interval)
        by_study = _with_interval(self.study_yield, self.study_interval)
        if not (as_drawn and by_study):
            return f"yield with all tolerances of this drawing not predicted: {self.reason}"
        return f"predicted yield with all tolerances of this drawing {as_drawn}, by the study {by_study}"

    @property
    def worst(self) -> str:
        """The four indications that cost most yield, in words."""
        return ", ".join(f"{text}: {100.0 * loss:.1f} percentage points" for text, loss in self.losses[:4])


def _with_interval(fraction: float | None, interval: tuple[float, float] | None) -> str:
    """Return a yield with its 95 % interval in percent; an empty text without a yield."""
    if fraction is None or interval is None:
        return ""
    return f"{100.0 * fraction:.1f} % ({100.0 * interval[0]:.1f} to {100.0 * interval[1]:.1f} %)"


class YieldPredictor(Protocol):
    """A tolerance study that completes the tolerances of a drawing and predicts its yield."""

    def derive(self, lens: Lens, sheets: Sequence[DrawingTolerances]) -> DerivedTolerances:
        """Derive the tolerances that the study does not specify, for the lens as drawn."""

    def predict(
        self, designed: Lens, drawn: Lens, sheets: Sequence[DrawingTolerances]
    ) -> DrawingYield | None:
        """Predict the yield; None if none of the study's merits can be predicted without trials."""


class _StudyForDrawings(Protocol):
    """A tolerance study as its entry point returns it."""

    def yield_predictor(self) -> YieldPredictor:
        """Return the object that predicts the yields of drawings."""


def read_yield_predictor(study: Path) -> YieldPredictor:
    """Read a tolerance study that predicts the yields of drawings.

    Raises
    ------
    DesignError
        If the file is not a study, or no installed package can read it.
    """
    from lensdesign.optimization.as_built import read_as_built
    from lensdesign.optimization.specification.sections import Tolerances

    built: Any = read_as_built(Tolerances(study=str(study)))
    return cast(_StudyForDrawings, built).yield_predictor()


@dataclass(frozen=True)
class DrawingWithYield:
    """A drawing with its predicted yield.

    Attributes
    ----------
    drawing, stated
        The drawing and its lens; see :func:`lensdesign.manufacture.drawing.sheets.drawing_as_stated`.
    predicted_yield
        Predicted yield; None if none of the study's merits can be predicted.
    """

    drawing: Drawing
    stated: Stated
    predicted_yield: DrawingYield | None


def drawing_with_yield(
    lens: Lens,
    options: DrawingOptions,
    assumed: AssumedTolerances,
    predictor: YieldPredictor,
    accept_yield_loss: bool = False,
) -> DrawingWithYield:
    """Draw a lens with the tolerances of a study, and predict the yield of the drawing.

    Parameters
    ----------
    lens
        The lens as designed.
    options
        Title block and tolerances.
    assumed
        Values that the study specifies.
    predictor
        The study.
    accept_yield_loss
        Whether the drawing may lose more than two percentage points of yield against the study (default:
        False).

    Raises
    ------
    InputError
        If the drawing loses more yield and this is not accepted, or if
        :func:`lensdesign.manufacture.drawing.sheets.drawing_as_stated` rejects the lens.
    """
    _, first = drawing_as_stated(lens, options, assumed)
    derived = predictor.derive(first.lens, first.tolerances)
    completed = options.replaced(tolerances=derived.tolerances)
    # Derived tolerances may be tighter, which requires finer rounding.
    _, second = drawing_as_stated(lens, completed)
    stated = Stated(second.lens, (*second.notes, *derived.notes), second.tolerances)
    predicted_yield = predictor.predict(lens, stated.lens, stated.tolerances)
    if predicted_yield is not None:
        if predicted_yield.loss > MAX_YIELD_LOSS and not accept_yield_loss:
            raise InputError(
                f"the sheet allows more than {assumed.source}: it loses {100.0 * predicted_yield.loss:.1f} "
                f"percentage points of its yield; {predicted_yield.sentence}; the largest losses are "
                f"{predicted_yield.worst}; add these perturbations to the study, state closer values for "
                "them (--sheet), or accept the loss with --accept-yield-loss"
            )
        completed = completed.replaced(remark=_remark(predicted_yield, assumed, options))
    drawing = lens_drawing(stated.lens, completed.replaced(tolerances=stated.tolerances))
    return DrawingWithYield(drawing, stated, predicted_yield)


def _remark(predicted_yield: DrawingYield, assumed: AssumedTolerances, options: DrawingOptions) -> str:
    own = f"{DERIVED_MARK} derived from {assumed.source}; {predicted_yield.sentence}"
    return f"{own}; {options.remark}" if options.remark else own
