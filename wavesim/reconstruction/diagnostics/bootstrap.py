"""How far noise moves a reconstruction, sample by sample, where the frames tell the object: a bootstrap.

The reconstruction is taken for the object and recorded again several times, each with other noise of the
stated standard deviations; each record is reconstructed by the same settings. How much the results scatter
about the object that they were made of is what noise does to them, with what the total variation rounds: the
mean of their differences is taken along, for it estimates how far the result itself is off.

Repeats that begin at one result stay in its hollow of the misfit. So the frames themselves are reconstructed
from other starts too: what fits them as well and differs adds to the scatter. Where it differs by much, or
the result does not fit the frames or a plane that was held out, nothing is stated.

Source: B. Efron and R. J. Tibshirani, "An Introduction to the Bootstrap" (Chapman and Hall, 1993), 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, TransferLensError, validate_whole_number
from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel, RealArray
from wavesim.reconstruction.from_object import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement

ITERATIONS = 12
"""From the reconstruction on, of which each record differs by noise alone."""

UNEXPLAINED = 1.5
"""Misfit over that of noise alone, from which on frames say that something else is wrong."""

AS_GOOD = 1.1
"""Ratio of misfits up to which a start counts, and beyond which another is the better one."""

APART = 0.1
"""Relative difference of two objects that fit as well, from which on the frames do not tell which it is."""

START_SAMPLES = 4.0
"""Standard deviation of the kernel that smooths a random start."""

LEAVES_OUT = (
    "errors that all starts have in common are not in it: a wrong model of lens, light or camera, and edges "
    "that the total variation rounds, beyond what it rounds of the result once more"
)


class UndeterminedError(TransferLensError):
    """Frames do not tell the object well enough for its uncertainty to be stated."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How far a reconstructed transmission may be off.

    Attributes
    ----------
    values : ndarray
        Standard deviation of each sample, of the object grid's shape: root of the summed variances of real
        and imaginary part, from noise and between starts; 0 where there is no light.
    of_noise, of_starts : float
        Root mean square of either share, where there is light.
    misfit_over_noise : float
        Of the result, over what noise alone would leave.
    held_out_over_noise : float or None
        The same on a plane that was held out.
    leaves_out : str
        What is not in it.
    """

    values: Array
    of_noise: float
    of_starts: float
    misfit_over_noise: float
    held_out_over_noise: float | None
    leaves_out: str


def uncertainty(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Measurement],
    found: Reconstructed,
    *,
    kind: Kind = "complex",
    tv_weight: float | Literal["auto"] = 0.0,
    iterations: int = ITERATIONS,
    fill_factor: float = 0.0,
    held_out: Measurement | None = None,
    repeats: int = 8,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Uncertainty:
    """How far a reconstructed transmission may be off, sample by sample, by noise and by the start.

    Parameters
    ----------
    engine, illumination, recorded, kind, tv_weight, fill_factor
        As of :func:`wavesim.reconstruct`, and as they were for `found`; all planes state their `sigma`.
    found
        What was reconstructed from them.
    iterations
        Of each repeat, from `found` on; other starts take as many as `found` did.
    held_out
        A plane that `found` was not made of.
    repeats
        Two at least. With n of them the standard deviation itself is known to one part in sqrt(2 (n - 1)).
    seed
        Of the noise and of a random start.
    progress
        Called with the number of reconstructions done, and that of all.

    Raises
    ------
    InputError
        If there are fewer than two repeats, or a plane has no sigma.
    UndeterminedError
        If the result leaves more of the frames than noise can (`UNEXPLAINED`), on the plane held out too; if
        another start fits them better (`AS_GOOD`), or as well by another object (`APART`).
    """
    validate_whole_number("repeats", repeats, 2)
    if any(plane.sigma is None for plane in (*recorded, *([] if held_out is None else [held_out]))):
        raise InputError("uncertainty: needs sigma on every plane")

    def modelled(planes: Sequence[Measurement]) -> list[RealArray]:
        model = ForwardModel(engine, illumination, planes, found.scale, fill_factor)
        return model.amplitudes(found.transmission.values)

    clean = modelled(recorded)
    over_noise = _explained(recorded, clean, "the frames")
    held_out_over_noise = None
    if held_out is not None:
        held_out_over_noise = _explained([held_out], modelled([held_out]), "the plane held out")
    settings: dict[str, Any] = {
        "kind": kind,
        "tv_weight": tv_weight,
        "scale": found.scale,
        "fill_factor": fill_factor,
    }
    lit = np.abs(illumination.values) > 0.0
    starts = _starts(illumination, kind, seed)
    others = []
    for number, start in enumerate(starts):
        other = reconstruct(
            engine, illumination, recorded, iterations=len(found.misfit), start=start, **settings
        )
        others += _as_good(found, other, lit)
        if progress is not None:
            progress(number + 1, len(starts) + repeats)
    results = []
    for number, one in enumerate(np.random.SeedSequence(seed).spawn(repeats)):
        random = np.random.default_rng(one)
        again = [_noisy(plane, a, random) for plane, a in zip(recorded, clean, strict=True)]
        repeat = reconstruct(
            engine, illumination, again, iterations=iterations, start=found.transmission, **settings
        )
        results.append(repeat.transmission.values)
        if progress is not None:
            progress(len(starts) + number + 1, len(starts) + repeats)
    by_noise = _mean_square(results, found.transmission.values, lit)
    by_start = _variance([found.transmission.values, *others])
    return Uncertainty(
        np.sqrt(by_noise + by_start),
        math.sqrt(float(by_noise[lit].mean())),
        math.sqrt(float(by_start[lit].mean())),
        over_noise,
        held_out_over_noise,
        LEAVES_OUT if held_out is not None else f"{LEAVES_OUT}; no plane was held out",
    )


def _mean_square(results: Sequence[NDArray[Any]], true: NDArray[Any], lit: NDArray[np.bool_]) -> Array:
    """Of the differences of results from the object of which they were made, in its phase."""
    total = np.zeros(true.shape)
    for values in results:
        overlap = np.vdot(values[lit], true[lit])
        turned = values * (overlap / max(abs(overlap), np.finfo(float).tiny))
        total += np.abs(turned - true) ** 2
    return np.asarray(total / len(results), float)


def _variance(results: Sequence[NDArray[Any]]) -> Array:
    """Of real and imaginary part together; 0 of one result."""
    values = np.asarray(results)
    squares = np.sum(np.abs(values - values.mean(axis=0)) ** 2, axis=0)
    return np.asarray(squares / max(len(values) - 1, 1), float)


def _explained(planes: Sequence[Measurement], modelled: Sequence[RealArray], what: str) -> float:
    """Misfit of a result over that of noise alone, on planes that must be explained by it."""
    missed = noise = 0.0
    for plane, amplitude in zip(planes, modelled, strict=True):
        assert plane.sigma is not None
        known = np.isfinite(plane.sigma)
        missed += float(np.sum((amplitude - plane.amplitude)[known] ** 2, dtype=float))
        noise += float(np.sum(plane.sigma[known] ** 2, dtype=float))
    ratio = math.sqrt(missed / noise)
    if ratio > UNEXPLAINED:
        raise UndeterminedError(
            f"uncertainty: the result leaves {ratio:.3g} times the noise of {what}: object, lens, light or "
            "camera are not as they are taken to be; take more planes or iterations, another start, calibrate"
        )
    return ratio


def _starts(illumination: Field, kind: Kind, seed: int) -> list[Field | Literal["amplitude"] | None]:
    """Even, of an amplitude object, and smooth and random."""
    random = np.random.default_rng(seed).standard_normal(illumination.grid.shape)
    smooth = gaussian_filter(random, START_SAMPLES)
    smooth /= smooth.std()
    values = 1.0 / (1.0 + np.exp(smooth)) if kind == "amplitude" else np.exp(1j * smooth)
    start = illumination.with_values(values.astype(illumination.values.dtype))
    return [None, start] if kind == "amplitude" else [None, "amplitude", start]


def _as_good(found: Reconstructed, other: Reconstructed, lit: NDArray[np.bool_]) -> list[NDArray[Any]]:
    """The object of another start, turned to the phase of the first, if it fits as well; not if worse."""
    mine, yours = found.misfit[-1], other.misfit[-1]
    if yours > AS_GOOD * mine:
        return []
    if mine > AS_GOOD * yours:
        raise UndeterminedError(
            f"uncertainty: another start leaves a misfit of {yours:.4g}, the result {mine:.4g}: it is not "
            "the object that fits best; take another start, more iterations or more planes"
        )
    one, turned = found.transmission.values, other.transmission.values
    overlap = np.vdot(turned[lit], one[lit])
    turned = turned * (overlap / max(abs(overlap), np.finfo(float).tiny))
    apart = float(np.linalg.norm((one - turned)[lit]) / np.linalg.norm(one[lit]))
    if apart > APART:
        raise UndeterminedError(
            f"uncertainty: another start fits as well by an object that differs by {100.0 * apart:.3g} %: "
            "the frames do not tell which; take more planes, more iterations or more total variation"
        )
    return [turned]


def _noisy(plane: Measurement, amplitude: RealArray, random: np.random.Generator) -> Measurement:
    assert plane.sigma is not None
    sigma = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
    noisy = np.abs(amplitude + sigma * random.standard_normal(amplitude.shape))
    return replace(plane, amplitude=noisy.astype(plane.amplitude.dtype))
