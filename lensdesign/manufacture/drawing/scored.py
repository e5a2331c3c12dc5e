"""Sheets whose tolerances are scored: what a lens yields that uses all that its drawing allows.

Tolerance studies are read by a package above this one (:mod:`lensdesign.optimization.as_built`), which also
derives what a study leaves open and predicts yields.
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
from lensdesign.manufacture.drawing.sheets import DrawingOptions, drawing_as_stated, lens_drawing
from lensdesign.manufacture.drawing.strokes import Drawing
from lensdesign.manufacture.drawing.tolerances import DERIVED_MARK, DrawingTolerances

MOST_LOSS = 0.02
"""Yield that a sheet may lose against its study before it is refused."""

WORST_SHOWN = 4


@dataclass(frozen=True)
class Derived:
    """Tolerances that a study leaves open, derived from it.

    Attributes
    ----------
    tolerances
        Of the sheet of each element.
    notes
        What was derived, in words.
    """

    tolerances: tuple[DrawingTolerances, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class SheetScore:
    """Predicted yield of a lens that uses all that its sheets allow.

    Attributes
    ----------
    study_yield, as_drawn_yield
        By the study itself, of the lens as designed; and by the sheets, of the lens as drawn.
    losses
        Each indication that the study does not have, with the yield that it costs alone, largest first.
        Worked out only where the sheets lose more than :data:`MOST_LOSS`.
    is_trustworthy
        Whether the neglected orders of the prediction are small, as far as it can tell.
    not_predicted
        Merits of the study that only trials can score.
    save
        Writes the study that the sheets stand for, of a design file, to a path.
    """

    study_yield: float
    as_drawn_yield: float
    losses: tuple[tuple[str, float], ...]
    is_trustworthy: bool
    not_predicted: tuple[str, ...]
    save: Callable[[Path, str], None]

    @property
    def loss(self) -> float:
        """Yield that the sheets lose."""
        return self.study_yield - self.as_drawn_yield

    @property
    def worst(self) -> str:
        """The indications that cost most, in words."""
        shown = [f"{text}: {100.0 * loss:.1f} points" for text, loss in self.losses[:WORST_SHOWN]]
        return ", ".join(shown)


class SheetScorer(Protocol):
    """A tolerance study that scores sheets."""

    def derive(self, lens: Lens, sheets: Sequence[DrawingTolerances]) -> Derived:
        """Derive what the study leaves open, for a lens as drawn."""

    def score(self, designed: Lens, drawn: Lens, sheets: Sequence[DrawingTolerances]) -> SheetScore | None:
        """Score the sheets; None if none of the study's merits can be predicted without trials."""


class _StudyWithSheets(Protocol):
    """A study as its entry point reads it."""

    def sheets(self) -> SheetScorer:
        """What scores the study's sheets."""


def read_scorer(study: Path) -> SheetScorer:
    """Read a tolerance study to score sheets by.

    Raises
    ------
    DesignError
        If it is no study, or no package that reads one is installed.
    """
    from lensdesign.optimization.as_built import read_as_built
    from lensdesign.optimization.specification.sections import Tolerances

    built: Any = read_as_built(Tolerances(study=str(study)))
    return cast(_StudyWithSheets, built).sheets()


@dataclass(frozen=True)
class ScoredDrawing:
    """A drawing with its score.

    Attributes
    ----------
    drawing, stated
        As :func:`lensdesign.manufacture.drawing.sheets.drawing_as_stated` gives them.
    score
        None where none of the study's merits can be predicted.
    """

    drawing: Drawing
    stated: Stated
    score: SheetScore | None


def scored_drawing(
    lens: Lens,
    options: DrawingOptions,
    assumed: AssumedTolerances,
    scorer: SheetScorer,
    accept_yield_loss: bool = False,
) -> ScoredDrawing:
    """Draw a lens for a shop with the tolerances of a study, and score what the sheets allow.

    Parameters
    ----------
    lens
        As designed.
    options
        Title block and tolerances.
    assumed
        What the study states.
    scorer
        The study.
    accept_yield_loss
        Whether sheets may lose more than two percentage points of yield against the study.

    Raises
    ------
    InputError
        If they do and it is not accepted; also as of
        :func:`lensdesign.manufacture.drawing.sheets.drawing_as_stated`.
    """
    _, first = drawing_as_stated(lens, options, assumed)
    derived = scorer.derive(first.lens, first.tolerances)
    made = options.replaced(tolerances=derived.tolerances)
    # Closer tolerances are rounded more finely.
    _, second = drawing_as_stated(lens, made)
    stated = Stated(second.lens, (*second.notes, *derived.notes), second.tolerances)
    score = scorer.score(lens, stated.lens, stated.tolerances)
    if score is not None:
        drawn, own = (f"{100.0 * found:.1f} %" for found in (score.as_drawn_yield, score.study_yield))
        if score.loss > MOST_LOSS and not accept_yield_loss:
            raise InputError(
                f"the sheet allows more than {assumed.source}: predicted yield as drawn {drawn}, by the "
                f"study {own}; most of it is lost by {score.worst}; add these perturbations to the study, "
                "state closer values for them (--sheet), or accept the loss with --accept-yield-loss"
            )
        made = made.replaced(remark=_remark(score, assumed, options))
    drawing = lens_drawing(stated.lens, made.replaced(tolerances=stated.tolerances))
    return ScoredDrawing(drawing, stated, score)


def _remark(score: SheetScore, assumed: AssumedTolerances, options: DrawingOptions) -> str:
    own = (
        f"{DERIVED_MARK} derived from {assumed.source}; predicted yield with all tolerances of this drawing "
        f"{100.0 * score.as_drawn_yield:.1f} %, by the study {100.0 * score.study_yield:.1f} %"
    )
    return f"{own}; {options.remark}" if options.remark else own
