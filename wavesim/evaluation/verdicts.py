"""Whether a result explains what was recorded, within the noise; where it does not, and what may differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wavesim.runtime.threads import row_blocks

Array = NDArray[np.floating[Any]]

LIMIT = 1.3
"""Times the noise up to which residuals count as explained. Healthy frames come to 0.9 to 1.26: pixels are
averaged in another way than they were made, and the iterations end."""

HELD_LIMIT = 1.45
"""The same of pixels that were held out, which nothing was fitted to."""

MODEL_ERROR = 0.005
"""Of the amplitude, that engine and pixels may err where there is no noise."""

BLOCKS = 8
"""Along each side of a plane, among which the largest excess is looked for."""

LEAST_GAIN = 0.2
"""Share of the squared misfit that a trial must take away to be named."""

FEW, MORE = 3, 10
"""So few iterations tell nothing. Of more, the misfit may go on to fall as in the last one, so many times:
where it then comes to the noise, iterations are what is wanted."""

FREER = {"shift": 1.15, "mounting": 1.65}
"""By how much trials must be better that change more than others, or resemble them: each plane's shift, in
place of the two angles of the light, which shift all planes, and the lens's decenter, which does so too."""

LEAST_AGREEMENT = 0.9
"""Correlation of the objects of several starts, below which frames do not tell the object."""

ADVICE = {
    "planes swapped": "give the frames the distances of their planes in the other order",
    "shift": "run `wavesim calibrate`: it finds the shift of each plane",
    "mounting": "run `wavesim calibrate`: it finds decenter and tilt of the lens",
    "working distance": "measure the object's distance anew, or run `wavesim calibrate`",
    "pixel pitch": "compare the pitch that frames and design state with the camera's data sheet",
    "lens": "compare design and wavelength with what is mounted; run `wavesim calibrate`",
    "distance": "measure the plane's distance anew, or run `wavesim calibrate`",
    "background": "block stray light, or run `wavesim calibrate`: it finds each plane's background",
    "field stop": "give --field-stop-at-mm and --field-stop-mm, or --field-stop find",
    "light": "run `wavesim calibrate`: it finds the light's direction and shape",
    "iterations": "give more --iterations: the misfit was still falling",
    "several objects": "record more planes, farther from each other, or state more of the object (--kind)",
    "lens or light": "run `wavesim calibrate`; compare the design with the lens that is mounted",
}


class PlaneResidual(NamedTuple):
    """What a result leaves of one plane.

    `amplitude` and `sigma` as recorded, `error` the result's amplitude less the recorded one; `held` are flat
    indices of pixels that were not used, and `held_sigma` their standard deviations. Pixels of infinite sigma
    tell nothing.
    """

    distance_mm: float
    amplitude: Array
    sigma: Array
    error: Array
    held: NDArray[np.intp]
    held_sigma: Array


class Trial(NamedTuple):
    """One thing that was changed, and the squared misfit then over that without the change."""

    cause: str
    told: str
    misfit_ratio: float

    @property
    def gain(self) -> float:
        """Share of the squared misfit that is gone."""
        return 1.0 - self.misfit_ratio**2


@dataclass(frozen=True)
class PlaneVerdict:
    """How well one plane is explained.

    Attributes
    ----------
    distance_mm : float
        From the exit vertex.
    over_noise, held_out_over_noise : float or None
        Root mean square residual over that of the noise, of pixels that were used and of those that were not;
        None where there are none.
    region_px : (x, y, width, height)
        Of the largest excess, in pixels from the frame's first one.
    region_over_noise : float
        There.
    """

    distance_mm: float
    over_noise: float | None
    held_out_over_noise: float | None
    region_px: tuple[int, int, int, int]
    region_over_noise: float


@dataclass(frozen=True)
class Verdict:
    """Whether a result explains the frames.

    Attributes
    ----------
    explained : bool
        Within the noise, on each plane, and on pixels that were held out.
    over_noise, held_out_over_noise : float
        Largest of all planes.
    worst_plane : int
        Number, from 0, of the plane with the largest excess.
    planes : tuple of PlaneVerdict
        One after the other.
    cause, told, next_step : str
        What most likely differs, what tells it, and what to do; empty where all is explained.
    trials : tuple of Trial
        What was tried.
    agreement : float or None
        Correlation of the objects of several starts.
    """

    explained: bool
    over_noise: float
    held_out_over_noise: float
    worst_plane: int
    planes: tuple[PlaneVerdict, ...]
    cause: str
    told: str
    next_step: str
    trials: tuple[Trial, ...]
    agreement: float | None = None

    @property
    def words(self) -> str:
        """In a sentence or two."""
        held = f"{self.held_out_over_noise:.3g} times on pixels that were held out"
        if self.explained:
            return f"explained within the noise: residuals {self.over_noise:.3g} times the noise, {held}"
        worst = self.planes[self.worst_plane]
        x, y, width, height = worst.region_px
        return (
            f"not explained: residuals {self.over_noise:.3g} times the noise, {held}; most on the plane at "
            f"{worst.distance_mm:g} mm, {worst.region_over_noise:.3g} times in the {width} x {height} pixels "
            f"from {x}, {y} on. Most likely: {self.cause} ({self.told}). Next: {self.next_step}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        told = vars(self) | {
            "planes": [vars(plane) | {"region_px": list(plane.region_px)} for plane in self.planes],
            "trials": [trial._asdict() for trial in self.trials],
            "words": self.words,
        }
        return dict(told)


def verdict(
    planes: Sequence[PlaneResidual],
    trials: Sequence[Trial] = (),
    curve: Sequence[float] = (),
    agreement: float | None = None,
) -> Verdict:
    """Judge a result by what it leaves of the planes.

    Parameters
    ----------
    planes
        What is left, plane by plane.
    trials
        Of what may differ.
    curve
        Misfit of each iteration.
    agreement
        Correlation of the objects that several starts end at, if there were any.
    """
    judged = [_judged(plane) for plane in planes]
    used = [one.over_noise or 0.0 for one in judged]
    held = [one.held_out_over_noise or 0.0 for one in judged]
    excess = [max(u / LIMIT, h / HELD_LIMIT) for u, h in zip(used, held, strict=True)]
    within = max(excess) <= 1.0
    explained = within and (agreement is None or agreement >= LEAST_AGREEMENT)
    cause, told = ("", "") if explained else _likeliest(trials, curve, max(excess))
    if within and not explained:
        cause, told = "several objects", f"starts end at objects whose correlation is {agreement:.3g}"
    return Verdict(
        explained,
        max(used),
        max(held),
        int(np.argmax(excess)),
        tuple(judged),
        cause,
        told,
        ADVICE.get(cause, ""),
        tuple(trials),
        agreement,
    )


def wants_iterations(curve: Sequence[float], excess: float) -> bool:
    """Whether more iterations would come to the noise.

    Parameters
    ----------
    curve
        Misfit of each iteration.
    excess
        Residuals over those that count as explained.
    """
    return bool(curve) and (len(curve) <= FEW or excess * (curve[-1] / curve[-2]) ** MORE < 1.0)


def _likeliest(trials: Sequence[Trial], curve: Sequence[float], excess: float) -> tuple[str, str]:
    """Cause, and what tells it; the excess is that over what counts as explained."""
    best = min(trials, key=lambda trial: trial.misfit_ratio * FREER.get(trial.cause, 1.0), default=None)
    if best is not None and best.gain > LEAST_GAIN:
        return best.cause, f"tried: {best.told}, misfit {best.misfit_ratio:.2g} times what it was"
    if wants_iterations(curve, excess):
        return "iterations", "the misfit was still falling"
    return "lens or light", "nothing else that was tried explains it" if trials else "nothing was tried"


def _judged(plane: PlaneResidual) -> PlaneVerdict:
    rows = _edges(plane.error.shape[0])
    columns = _edges(plane.error.shape[1])
    missed, expected = np.zeros((2, len(rows) - 1, len(columns) - 1))
    for i in range(len(rows) - 1):
        for block in row_blocks(rows[i + 1] - rows[i]):
            part = slice(rows[i] + block.start, rows[i] + block.stop)
            known = np.isfinite(plane.sigma[part])
            square = np.where(known, plane.error[part].astype(float) ** 2, 0.0)
            noise = np.where(known, _expected(plane.amplitude[part], plane.sigma[part], known), 0.0)
            for total, values in ((missed, square), (expected, noise)):
                total[i] += np.add.reduceat(values.sum(axis=0), columns[:-1])
    i, j = divmod(int(np.argmax(missed - expected)), missed.shape[1])
    error, amplitude = (values.ravel()[plane.held].astype(float) for values in (plane.error, plane.amplitude))
    held = _expected(amplitude, plane.held_sigma, np.ones(len(error), bool))
    return PlaneVerdict(
        plane.distance_mm,
        _ratio(float(missed.sum()), float(expected.sum())),
        _ratio(float(error @ error), float(held.sum())),
        (
            int(columns[j]),
            int(rows[i]),
            int(columns[j + 1] - columns[j]),
            int(rows[i + 1] - rows[i]),
        ),
        _ratio(float(missed[i, j]), float(expected[i, j])) or 0.0,
    )


def _expected(amplitude: Array, sigma: Array, known: NDArray[np.bool_]) -> Array:
    """Squares of residuals to expect: of noise, and of engine and pixels."""
    return np.asarray(
        np.where(known, sigma, 0.0).astype(float) ** 2 + (MODEL_ERROR * amplitude.astype(float)) ** 2
    )


def _edges(count: int) -> list[int]:
    """Borders of blocks along a side."""
    return np.unique(np.linspace(0, count, min(BLOCKS, count) + 1).astype(int)).tolist()


def _ratio(missed: float, expected: float) -> float | None:
    return math.sqrt(missed / expected) if expected > 0.0 else None
