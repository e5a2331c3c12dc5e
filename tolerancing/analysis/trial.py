"""One trial of a store: drawn, traced and scored again, and held against what the store says."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, TransferLensError, atomic_path
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import Axis, PupilMerit
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.store.store import Store
from tolerancing.study.evaluate import context_of, realise, score_dear, score_trials
from tolerancing.study.results import RANDOM, TrialResults
from tolerancing.study.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

POINTS = 161
SPREAD_HALF_WIDTH_UM = 6.0


@dataclass(frozen=True, eq=False)
class SingleTrial:
    """A trial, stored and again.

    Attributes
    ----------
    number
        Of the trial.
    study
        The study that it is one of.
    context, batch
        The nominal lens, and the trial's perturbations.
    again : TrialResults
        As it comes out now.
    stored : TrialResults or None
        As the store has it; None where the run has not got to it.
    dear : dict of str to float
        Scores of the dear merits, where the store has any of this trial.
    """

    number: int
    study: Study
    context: Context
    batch: PerturbationBatch
    again: TrialResults
    stored: TrialResults | None
    dear: dict[str, float]

    @property
    def same(self) -> bool | None:
        """Whether values and scores are those stored, to the last bit; None where none are stored."""
        if self.stored is None:
            return None
        return all(
            np.array_equal(a, b, equal_nan=True)
            for a, b in (
                (self.stored.values, self.again.values),
                (self.stored.scores, self.again.scores),
            )
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; names carry their units."""
        study, again = self.study, self.again
        scores = {m.column: _or_none(again.scores[0, k]) for k, m in enumerate(study.merits)}
        stored = self.stored
        return {
            "trial": self.number,
            "seed": study.seed,
            "deviations": {p.column: again.values[0, k].item() for k, p in enumerate(study.perturbations)},
            "scores": scores,
            "stored_scores": None
            if stored is None
            else {m.column: _or_none(stored.scores[0, k]) for k, m in enumerate(study.merits)},
            "extras": {
                name: _or_none(value)
                for name, value in zip(study.extra_columns, again.extras[0], strict=True)
            },
            "dear_scores": self.dear,
            "passed": bool(again.passed[0]),
            "message": again.messages[0],
            "same_as_stored": self.same,
        }


def single_trial(store: Store, number: int, *, dear: bool = False) -> SingleTrial:
    """Draw, trace and score one trial again.

    Parameters
    ----------
    store
        An open store; it is not written to.
    number
        Of the trial.
    dear
        Whether to score the dear merits too.

    Raises
    ------
    InputError
        If the study has no trial of this number.
    """
    loaded, planned = store.loaded, store.record().planned_trials
    if not 0 <= number < planned:
        raise InputError(f"trial = {number}: the study has trials 0 to {planned - 1}")
    study = loaded.study
    context = context_of(loaded.lens, study)
    again = score_trials(context, study, [number])
    scores: dict[str, float] = {}
    if dear and study.dear_merits:
        found = score_dear(context, study, [number], [RANDOM])
        scores = {m.column: float(s) for m, s in zip(study.dear_merits, found.scores[0], strict=True)}
    stored = store.trials(only=number)
    return SingleTrial(
        number=number,
        study=study,
        context=context,
        batch=realise(study, [number]),
        again=again,
        stored=stored if len(stored) else None,
        dear=scores,
    )


def trial_figure(trial: SingleTrial) -> Figure:
    """What a trial does at each field point of the pupil merits: path, point spread, line pairs.

    Raises
    ------
    TransferLensError
        If no field point can be drawn.
    """
    from tolerancing.report.figures.style import styled, styled_figure

    pictured = _pictured(trial.study)
    rows: list[tuple[tuple[float, float], PupilMerit]] = list(pictured.items())
    with styled({"axes.grid": False}):
        figure = styled_figure(9.0, 2.9 * len(rows) + 0.4)
        figure.suptitle(
            f"Trial {trial.number} of {trial.study.title or trial.study.design}", fontweight="bold"
        )
        axes = figure.subplots(len(rows), 3, squeeze=False)
        for row, (point, merit) in zip(axes, rows, strict=True):
            try:
                _draw_row(figure, row, trial, point, merit)
            except TransferLensError as error:
                for axis in row:
                    axis.set_axis_off()
                row[0].text(0.0, 0.5, str(error), wrap=True, fontsize=7.5)
    return figure


def write_trial_figure(trial: SingleTrial, path: str | os.PathLike[str]) -> None:
    """Write :func:`trial_figure`; the kind of picture by the path's suffix.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    path = Path(path)
    allowed = (".png", ".svg", ".pdf")
    if path.suffix not in allowed:
        raise InputError(f"cannot write {path}: the suffix must be one of {', '.join(allowed)}")
    figure = trial_figure(trial)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:], dpi=150)


def _pictured(study: Study) -> dict[tuple[float, float], PupilMerit]:
    """Field points of the pupil merits, with the merit that tells wavelength, refocus and line width."""
    from tolerancing.merits.line_pairs import LinePairContrast

    found: dict[tuple[float, float], PupilMerit] = {}
    for merit in sorted(
        (m for m in study.all_merits if isinstance(m, PupilMerit)),
        key=lambda m: not isinstance(m, LinePairContrast),
    ):
        for point in merit.points:
            found.setdefault(point, merit)
    plain = PupilMerit(kind="rms_waves", at_most=1.0)
    return found or {(0.0, 0.0): plain}


def _draw_row(
    figure: Figure, axes: Array, trial: SingleTrial, point: tuple[float, float], merit: PupilMerit
) -> None:
    from wavesim import psf, rms_waves, strehl

    (pupil,) = trial.context.pupils(trial.batch, point, merit.wavelength_um, merit.refocus, True)
    half = pupil.grid.half_width
    x, y = pupil.grid.centre
    shown = np.where(pupil.valid_on_grid > 0.0, pupil.waves_on_grid, np.nan)
    extent = (x - half, x + half, y - half, y + half)
    image = axes[0].imshow(shown, cmap="RdBu_r", origin="lower", extent=extent)
    figure.colorbar(image, ax=axes[0], shrink=0.8, label="waves")
    axes[0].set_title(f"({point[0]:g}, {point[1]:g}) mm: {rms_waves(pupil):.3f} waves rms", fontsize=8.0)
    axes[0].set_xlabel("direction cosine L")
    axes[0].set_ylabel("direction cosine M")
    width = min(SPREAD_HALF_WIDTH_UM, 0.49 * pupil.grid.window_um)
    coordinates, spread = psf(pupil, width, POINTS)
    limits = (coordinates[0], coordinates[-1], coordinates[0], coordinates[-1])
    axes[1].imshow(np.sqrt(spread), cmap="magma", origin="lower", extent=limits, vmin=0.0)
    axes[1].set_title(f"point spread (amplitude), Strehl {strehl(pupil):.3f}", fontsize=8.0)
    axes[1].set_xlabel("x (um)")
    _draw_lines(axes[2], trial, pupil, merit)


def _draw_lines(panel: Axes, trial: SingleTrial, pupil: Any, merit: PupilMerit) -> None:
    from wavesim import line_pair_contrast, line_pair_image

    width = getattr(merit, "line_width_um", 0.75 * pupil.wavelength_um / pupil.grid.half_width)
    axes: tuple[Axis, ...] = ("x", "y")
    contrast = {along: line_pair_contrast(pupil, width, along) for along in axes}
    worse = min(contrast, key=contrast.__getitem__)
    coordinates, intensity = line_pair_image(pupil, width, worse, points=POINTS)
    limits = (coordinates[0], coordinates[-1], coordinates[0], coordinates[-1])
    panel.imshow(intensity, cmap="gray", origin="lower", extent=limits, vmin=0.0)
    panel.set_title(f"{width:.3g} um lines along {worse}, contrast {contrast[worse]:.2f}", fontsize=8.0)
    panel.set_xlabel("x (um)")


def _or_none(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)
