"""Goodness of fit: whether a result explains the recorded frames within the noise, and what may differ.

Residuals are compared with the expected variances of noise, engine and pixels. On fitted pixels they are
smaller than the noise, by the fraction of the data that the fit uses up. On pixels that were held out they
are larger by about the same factor. The geometric mean of both therefore judges a model of many unknowns.

A result with small residuals is nevertheless not trusted if residuals are smaller than noise can be, if the
frames clearly prefer another bench, or if the data do not determine the object.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.text import finite_or_none, number_with_unit, words_and_unit
from wavesim.metrics.next_steps import next_step
from wavesim.metrics.noise_parameters import NoiseCheck, noise_check
from wavesim.metrics.plane_residuals import PlaneResidual
from wavesim.runtime.threads import row_blocks

Array = NDArray[np.floating[Any]]

LIMIT = 1.3
"""Largest residuals over the noise that count as explained. Correct models reach 0.9 to 1.26: the pixel model
of a reconstruction is coarser than that of the sensor, and the iterations are finite.
"""

HELD_LIMIT = 1.25
"""Limit of the geometric mean of the residuals on fitted and on held-out pixels. Perfect benches reach at
most 1.16.
"""

MODEL_ERROR = 0.005
"""Relative error of amplitudes that engine and pixel model may have without noise."""

LEAST_GAIN = 0.2
"""Least fraction of the squared misfit that a trial must explain to be named."""

FEW, MORE = 3, 10
"""The misfit of the first `FEW` iterations is not judged. Later it is extrapolated by `MORE` steps as large
as the last one; more iterations are advised if it then reaches the noise.
"""


class Trial(NamedTuple):
    """Trial explanation: one change of the model, and the ratio of the misfits with and without it.

    Both are misfits after a few iterations. `misfit` is the one with the change.
    """

    cause: str
    explanation: str
    misfit_ratio: float
    misfit: float = 0.0

    @property
    def gain(self) -> float:
        """Fraction of the squared misfit that the change explains."""
        return 1.0 - self.misfit_ratio**2


class Finding(NamedTuple):
    """A reason not to trust a result although its residuals are within the noise."""

    cause: str
    explanation: str
    chi_square: float = math.inf
    """Statistical strength, if it is a number; the strongest finding names the cause."""


@dataclass(frozen=True)
class Undetected:
    """An error of mounting or source that the frames cannot exclude.

    Attributes
    ----------
    parameter : str
        Name with its unit.
    size : float
        Smallest size that the test of the bench would report, in the unit of the name: it is significant, and
        changes the object. From a linear model.
    correlation : float
        Correlation of the object found with the one that the frames give with this error.
    """

    parameter: str
    size: float
    correlation: float


@dataclass(frozen=True)
class BenchUncertainty:
    """Correlations with the true object that the uncertainty of a calibrated bench leaves.

    Attributes
    ----------
    correlation : float
        Correlation that 99 % of all benches within the uncertainty reach.
    correlation_without_low_orders : float
        The same after position and low orders of the object are fitted.
    phase_waves : mapping
        Standard deviation in waves of each low order of the phase of a complex or phase object, by name;
        empty for an amplitude object.
    amplitude : mapping
        Relative standard deviation of each low order of the amplitude, by name; empty for a phase object.
    position_um : mapping
        Standard deviation in um of the position of an object on a dark ground, along "x" and "y"; empty for
        an object on a clear ground.
    """

    correlation: float
    correlation_without_low_orders: float
    phase_waves: Mapping[str, float]
    amplitude: Mapping[str, float] = field(default_factory=dict)
    position_um: Mapping[str, float] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """Position and low orders that are not determined, in words; empty where all are."""
        # Standard deviations from which an order counts as not determined, in waves and relative.
        least_waves, least_amplitude = 0.01, 0.02
        kinds = (
            ("phase, which light and mounting change alike (waves)", self.phase_waves, least_waves),
            ("amplitude, which uneven light changes alike (relative)", self.amplitude, least_amplitude),
        )
        sentences = []
        if self.position_um:
            parts = ", ".join(f"{axis} ±{size:.2g} µm" for axis, size in self.position_um.items())
            sentences.append(f"position of the object, which decenter and light change alike: {parts}")
        for what, orders, least in kinds:
            parts = ", ".join(f"{name} ±{size:.2g}" for name, size in orders.items() if size >= least)
            if parts:
                sentences.append(f"low orders of the object's {what}: {parts}")
        return "; ".join(sentences)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        mappings = {"phase_waves": self.phase_waves, "amplitude": self.amplitude}
        mappings["position_um"] = self.position_um
        return vars(self) | {name: dict(sizes) for name, sizes in mappings.items()}


@dataclass(frozen=True)
class PlaneFit:
    """Goodness of fit of one plane.

    Attributes
    ----------
    distance_mm : float
        Distance of the plane from the exit vertex in mm.
    over_noise : float or None
        Root mean square residual over that of the noise, on fitted pixels; None if there are none.
    held_out_over_noise : float or None
        The same ratio on pixels that were held out.
    contribution : float
        Fraction of the information on the object that comes from this plane. A pixel contributes
        signal / (signal + noise).
    signal_to_noise : float
        Square root of the ratio of recorded energy to that of the noise.
    region_px : (x, y, width, height)
        Block with the largest excess, in pixels from the first pixel of the frame.
    region_over_noise : float
        Residual over noise in this block.
    """

    distance_mm: float
    over_noise: float | None
    held_out_over_noise: float | None
    contribution: float
    signal_to_noise: float
    region_px: tuple[int, int, int, int]
    region_over_noise: float

    @property
    def excess(self) -> float:
        """Residuals over the largest ones that count as explained."""
        used, held = self.over_noise, self.held_out_over_noise
        if used is None or held is None:
            return (used or held or 0.0) / LIMIT
        # Smallest residual on fitted pixels in that mean, over the noise: where a fit uses up more than two
        # thirds of the data, held-out pixels alone judge it.
        least_fitted = 0.6
        mean = math.sqrt(max(used, least_fitted) * held)
        return max(used / LIMIT, mean / HELD_LIMIT)


@dataclass(frozen=True)
class GoodnessOfFit:
    """Goodness of fit of a result: tests, the most likely cause of a misfit, and the next step.

    Attributes
    ----------
    explained : bool
        True if residuals are within the noise on each plane and on held-out pixels, without other findings.
    over_noise : float
        Largest value of all planes.
    held_out_over_noise : float or None
        The same on pixels that were held out; None if none were.
    worst_plane : int
        Index of the plane with the largest excess.
    planes : tuple of PlaneFit
        Goodness of fit of each plane, in the order of the planes.
    cause, evidence, next_step : str
        Most likely cause of the misfit, its evidence, and the next step; empty if the frames are explained.
    trials : tuple of Trial
        Trial explanations.
    agreement : float or None
        Correlation of the objects of several starts.
    findings : tuple of Finding
        Reasons not to trust the result other than the size of its residuals.
    noise : NoiseCheck or None
        Residuals over the stated noise alone; None if no pixel was held out.
    undetected : tuple of Undetected
        Errors of the bench that the frames cannot exclude; empty if they were not computed.
    model_error : float
        Relative error of amplitudes that was allowed for engine and pixel model.
    judged : bool
        False if only the residuals are known, because the run ended before the tests of the result.
    noise_correlation : float or None
        Correlation with the true object that noise and errors of the model leave at least (95 %), if nothing
        is assumed about the object's structure; None if it was not computed.
    bench : BenchUncertainty or None
        What the uncertainty of a calibrated bench leaves; None without a calibration.
    untested : tuple of str
        What was not tested, in words.
    """

    explained: bool
    over_noise: float
    held_out_over_noise: float | None
    worst_plane: int
    planes: tuple[PlaneFit, ...]
    cause: str
    evidence: str
    next_step: str
    trials: tuple[Trial, ...]
    agreement: float | None = None
    findings: tuple[Finding, ...] = ()
    noise: NoiseCheck | None = None
    undetected: tuple[Undetected, ...] = ()
    model_error: float = MODEL_ERROR
    judged: bool = True
    noise_correlation: float | None = None
    bench: BenchUncertainty | None = None
    untested: tuple[str, ...] = ()

    @property
    def least_correlation(self) -> float | None:
        """Correlation with the true object that is reached at least (95 %), with errors of noise and bench.

        Errors of a bench that was calibrated have its covariance. Otherwise they are the worst of those that
        the frames cannot exclude.
        """
        return self._least(None if self.bench is None else self.bench.correlation)

    @property
    def least_correlation_without_low_orders(self) -> float | None:
        """The same after the low orders of the object are fitted; None without a calibration."""
        if self.bench is None:
            return None
        return self._least(self.bench.correlation_without_low_orders)

    def _least(self, of_bench: float | None) -> float | None:
        if self.noise_correlation is None or not self.explained:
            return None
        if of_bench is None:
            if not self.undetected:  # other benches were not tested
                return None
            of_bench = min(one.correlation for one in self.undetected)
        return self.noise_correlation * of_bench

    @property
    def words(self) -> str:
        """Verdict in a few sentences."""
        size = f"residuals {self.over_noise:.3g} times the noise"
        if self.held_out_over_noise is not None:
            size += f", {self.held_out_over_noise:.3g} times on pixels that were held out"
        if not self.judged:
            return f"not judged: {self.evidence}; {size}. Next: {self.next_step}"
        if self.explained:
            more = f"{self._contributions}{self._not_excluded}{self._not_tested}"
            return f"explained within the noise: {size}{more}"
        if self.within:
            return f"not to be trusted: {size}, but {self.evidence}{self._not_tested}. Next: {self.next_step}"
        worst = self.planes[self.worst_plane]
        x, y, width, height = worst.region_px
        return (
            f"not explained: {size}; most on the plane at "
            f"{worst.distance_mm:g} mm, {worst.region_over_noise:.3g} times in the {width} x {height} pixels "
            f"from {x}, {y} on. Most likely: {self.cause} ({self.evidence}){self._other_finding}"
            f"{self._not_tested}. Next: {self.next_step}"
        )

    @property
    def within(self) -> bool:
        """True if residuals are within the noise on all planes."""
        return max(plane.excess for plane in self.planes) <= 1.0

    @property
    def _other_finding(self) -> str:
        """The strongest finding, if it is not the cause."""
        others = [one for one in self.findings if one.explanation != self.evidence]
        return f"; also: {others[0].explanation}" if others else ""

    @property
    def _not_tested(self) -> str:
        return f". Not tested: {', '.join(self.untested)}" if self.untested else ""

    @property
    def _contributions(self) -> str:
        if len(self.planes) < 2:
            return ""
        parts = " and ".join(
            f"{100.0 * plane.contribution:.0f} % from {plane.distance_mm:g} mm" for plane in self.planes
        )
        return f". Information: {parts}"

    @property
    def _not_excluded(self) -> str:
        words = ""
        if self.undetected:
            words = f". Not excluded, each alone: {', '.join(map(_in_words, self.undetected))}"
        least, without = self.least_correlation, self.least_correlation_without_low_orders
        open_orders = "" if self.bench is None else self.bench.words
        if open_orders:
            words += f". Not determined: {open_orders}"
        if least is None:
            return words
        words += f". With the noise, the correlation with the true object is {least:.3f} or more (95 %, "
        words += "without assuming any structure)"
        return f"{words}, and {without:.3f} or more without these" if open_orders else words

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; `told` is the key of evidence and explanations in files."""
        values = {"told" if name == "evidence" else name: value for name, value in vars(self).items()}
        return values | {
            "planes": [vars(plane) | {"region_px": list(plane.region_px)} for plane in self.planes],
            "trials": [
                {"cause": trial.cause, "told": trial.explanation, "misfit_ratio": trial.misfit_ratio}
                for trial in self.trials
            ],
            "findings": [
                finding._asdict() | {"chi_square": finite_or_none(finding.chi_square)}
                for finding in self.findings
            ],
            "noise": None if self.noise is None else self.noise._asdict(),
            "undetected": [vars(one) for one in self.undetected],
            "bench": None if self.bench is None else self.bench.as_dict() | {"words": self.bench.words},
            "least_correlation": self.least_correlation,
            "least_correlation_without_low_orders": self.least_correlation_without_low_orders,
            "words": self.words,
        }


def with_finding(judged: GoodnessOfFit, finding: Finding) -> GoodnessOfFit:
    """Return the verdict with one more reason not to trust the result.

    Where residuals exceed the noise, the cause that explains them remains. What was not judged stays so.
    """
    doubted = replace(judged, explained=False, findings=(*judged.findings, finding))
    if not judged.explained:
        return doubted
    return replace(
        doubted, cause=finding.cause, evidence=finding.explanation, next_step=next_step(finding.cause)
    )


def not_judged(residuals_judged: GoodnessOfFit, *, on_request: bool = False) -> GoodnessOfFit:
    """Return the verdict of a result that was not tested: sizes of residuals alone.

    Parameters
    ----------
    residuals_judged
        Verdict by the residuals, without tests.
    on_request
        Whether no verdict was requested. Otherwise the run ended before the tests of its result.
    """
    cause = "not requested" if on_request else "not judged"
    evidence = "the run ended after the search and before the tests of the result"
    if on_request:
        evidence = "no verdict was requested"
    return replace(
        residuals_judged,
        explained=False,
        judged=False,
        cause=cause,
        evidence=evidence,
        next_step=next_step(cause),
        findings=(),
    )


def _in_words(one: Undetected) -> str:
    words, unit = words_and_unit(one.parameter)
    size, unit = (1e3 * one.size, "um") if unit == "mm" else (one.size, unit)
    return f"{words} {number_with_unit(f'{size:.2g}', unit)}"


def verdict(
    planes: Sequence[PlaneResidual],
    trials: Sequence[Trial] = (),
    curve: Sequence[float] = (),
    agreement: float | None = None,
    *,
    model_error: float = MODEL_ERROR,
    findings: Sequence[Finding] = (),
    undetected: Sequence[Undetected] = (),
    calibrated: bool = False,
    rounding: float = 0.0,
    noise_correlation: float | None = None,
    untested: Sequence[str] = (),
) -> GoodnessOfFit:
    """Judge a result by its residuals on the planes.

    Parameters
    ----------
    planes
        Residuals of each plane.
    trials
        Trial explanations.
    curve
        Misfit of each iteration.
    agreement
        Correlation of the objects of several starts, if there are any.
    model_error
        Relative error of amplitudes that engine and pixel model may have.
    findings
        Other reasons not to trust the result.
    undetected
        Errors of the bench that the frames cannot exclude.
    calibrated
        Whether the bench was calibrated before, so that a calibration is not advised.
    rounding
        Largest fraction of a dark pixel's variance that is due to rounding to counts.
    noise_correlation
        Least correlation with the true object that noise and errors of the model leave.
    untested
        What was not tested.
    """
    judged = plane_verdicts(planes, model_error)
    excess = [plane.excess for plane in judged]
    within = max(excess) <= 1.0
    noise = noise_check(planes, rounding)
    against = sorted(findings, key=lambda finding: -finding.chi_square)
    if noise is not None and noise.is_too_small:
        against.insert(0, Finding("noise parameters", noise.explanation))
    # Correlation of the objects of several starts, below which frames do not determine the object.
    least_agreement = 0.9
    if agreement is not None and agreement < least_agreement:
        explanation = f"starts end at objects whose correlation is {agreement:.3g}"
        against.append(Finding("several objects", explanation))
    cause, evidence = "", ""
    if not within:
        cause, evidence = _likeliest(trials, findings, curve, max(excess), _excess_chi_square(planes))
    elif against:
        cause, evidence = against[0][:2]
    return GoodnessOfFit(
        within and not against,
        max(plane.over_noise or 0.0 for plane in judged),
        max((one.held_out_over_noise for one in judged if one.held_out_over_noise is not None), default=None),
        int(np.argmax(excess)),
        tuple(judged),
        cause,
        evidence,
        next_step(cause, calibrated=calibrated),
        tuple(trials),
        agreement,
        tuple(against),
        noise,
        tuple(undetected),
        model_error,
        noise_correlation=noise_correlation,
        untested=tuple(untested),
    )


def plane_verdicts(planes: Sequence[PlaneResidual], model_error: float = MODEL_ERROR) -> list[PlaneFit]:
    """Return the goodness of fit of each plane."""
    judged = [_judged(plane, model_error) for plane in planes]
    total = sum(plane.contribution for plane in judged)
    if total <= 0.0:
        return judged
    return [PlaneFit(**vars(plane) | {"contribution": plane.contribution / total}) for plane in judged]


def wants_iterations(curve: Sequence[float], excess: float) -> bool:
    """Return True if more iterations would reach the noise.

    Parameters
    ----------
    curve
        Misfit of each iteration.
    excess
        Ratio of the residuals to the largest ones that count as explained.
    """
    return bool(curve) and (len(curve) <= FEW or excess * (curve[-1] / curve[-2]) ** MORE < 1.0)


def _excess_chi_square(planes: Sequence[PlaneResidual]) -> float:
    """Return the sum of squared residuals over the variances of the noise, less the number of pixels."""
    total = 0.0
    for plane in planes:
        for rows in row_blocks(len(plane.error)):
            error, sigma = plane.error[rows].astype(float), plane.sigma[rows].astype(float)
            known = np.isfinite(sigma) & (sigma > 0.0)
            total += float(np.sum((error[known] / sigma[known]) ** 2 - 1.0))
    return max(total, 0.0)


def _likeliest(
    trials: Sequence[Trial],
    findings: Sequence[Finding],
    curve: Sequence[float],
    excess: float,
    excess_chi_square: float,
) -> tuple[str, str]:
    """Return the most likely cause and its evidence: the one that explains most of the excess chi-square.

    A finding states its gain of chi-square for the result itself. A trial gains as much as its misfit is
    below that of the result.
    """
    pictures = [one for one in findings if one.cause == "orientation" and math.isfinite(one.chi_square)]
    strongest = max(pictures, key=lambda one: one.chi_square, default=None)
    least_misfit = min((trial.misfit for trial in trials), default=math.inf)
    fraction = max(1.0 - (least_misfit / curve[-1]) ** 2, 0.0) if curve else 0.0
    gain_of_trials = fraction * excess_chi_square
    if strongest is not None and strongest.chi_square > max(gain_of_trials, LEAST_GAIN * excess_chi_square):
        return strongest.cause, strongest.explanation
    # Some trials must be better by a factor, because they change more than others or resemble them: each
    # plane's shift instead of the two angles of the light, which shift all planes, and the lens's decenter,
    # which does so too.
    factor_of_cause = {"shift": 1.15, "mounting": 1.65}
    # Trials that explain more than the whole search for the result are sure; others only converge faster.
    least_square = (1.0 - LEAST_GAIN) * curve[-1] ** 2 if curve else 0.0
    trials = [trial for trial in trials if trial.misfit**2 < least_square] or trials
    best = min(
        trials, key=lambda trial: trial.misfit_ratio * factor_of_cause.get(trial.cause, 1.0), default=None
    )
    if best is not None and best.gain > LEAST_GAIN:
        evidence = f"tried: {best.explanation}, which multiplies the misfit by {best.misfit_ratio:.2g}"
        # Causes that wash pictures out.
        blurs = ("source", "bandwidth", "vibration")
        if best.cause in blurs:
            others = [
                t.explanation
                for t in trials
                if t.cause in blurs and t.cause != best.cause and t.gain > LEAST_GAIN
            ]
            evidence = f"{evidence}; also helps: {others[0]}" if others else evidence
        return best.cause, evidence
    if wants_iterations(curve, excess):
        return "iterations", "the misfit was still falling"
    strongest = max(findings, key=lambda one: one.chi_square, default=None)
    if strongest is not None:
        return strongest.cause, strongest.explanation
    evidence = "nothing else that was tried explains it" if trials else "nothing was tried"
    return "lens or light", evidence


def _judged(plane: PlaneResidual, model_error: float) -> PlaneFit:
    rows = _edges(plane.error.shape[0])
    columns = _edges(plane.error.shape[1])
    missed, expected = np.zeros((2, len(rows) - 1, len(columns) - 1))
    information = energy = noise_energy = 0.0
    for i in range(len(rows) - 1):
        for block in row_blocks(rows[i + 1] - rows[i]):
            part = slice(rows[i] + block.start, rows[i] + block.stop)
            known = np.isfinite(plane.sigma[part])
            square = np.where(known, plane.error[part].astype(float) ** 2, 0.0)
            sigma = np.where(known, plane.sigma[part], 0.0)
            noise = np.where(known, _expected(plane.amplitude[part], sigma, plane, part, model_error), 0.0)
            for total, values in ((missed, square), (expected, noise)):
                total[i] += np.add.reduceat(values.sum(axis=0), columns[:-1])
            signal = np.where(known, (plane.amplitude[part] + plane.error[part]).astype(float) ** 2, 0.0)
            variance = sigma.astype(float) ** 2
            information += float(np.sum(signal / np.maximum(signal + variance, 1e-300)))
            energy, noise_energy = energy + float(signal.sum()), noise_energy + float(variance.sum())
    i, j = divmod(int(np.argmax(missed - expected)), missed.shape[1])
    error, amplitude = (values.ravel()[plane.held].astype(float) for values in (plane.error, plane.amplitude))
    engine = 0.0 if plane.engine_error is None else plane.engine_error.ravel()[plane.held]
    held = plane.held_sigma.astype(float) ** 2 + (model_error * amplitude) ** 2 + engine**2
    return PlaneFit(
        plane.distance_mm,
        _ratio(float(missed.sum()), float(expected.sum())),
        _ratio(float(error @ error), float(held.sum())),
        information,
        _ratio(energy, noise_energy) or 0.0,
        (
            int(columns[j]),
            int(rows[i]),
            int(columns[j + 1] - columns[j]),
            int(rows[i + 1] - rows[i]),
        ),
        _ratio(float(missed[i, j]), float(expected[i, j])) or 0.0,
    )


def _expected(amplitude: Array, sigma: Array, plane: PlaneResidual, rows: slice, model_error: float) -> Array:
    """Return the expected squares of residuals due to noise, engine and pixel model."""
    square = sigma.astype(float) ** 2 + (model_error * amplitude.astype(float)) ** 2
    if plane.engine_error is not None:
        square += plane.engine_error[rows].astype(float) ** 2
    return np.asarray(square)


def _edges(count: int) -> list[int]:
    """Return the borders of blocks along a side."""
    # Blocks along each side of a plane, among which the largest excess is searched.
    blocks = 8
    return np.unique(np.linspace(0, count, min(blocks, count) + 1).astype(int)).tolist()


def _ratio(missed: float, expected: float) -> float | None:
    return math.sqrt(missed / expected) if expected > 0.0 else None
