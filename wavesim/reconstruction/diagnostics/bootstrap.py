"""Standard deviation of a reconstruction, sample by sample, by a parametric bootstrap.

The reconstruction serves as the object, which is recorded again several times, each time with other noise of
the stated standard deviations. Each record is reconstructed with the same settings. The deviations of these
results from their object are the effect of noise and of the total variation. Their mean is included, because
it estimates the bias of the result itself.

Noise is added to intensities, and the standard deviations of the amplitudes follow from the noisy ones, as
those of a record do. Pixels that noise brightens then have larger weights, which adds to the scatter.

Repeats that start at one result stay near the same minimum of the misfit. The frames are therefore also
reconstructed from other starts. Differences between results that fit equally well add to the uncertainty. No
uncertainty is stated if they differ much, or if the result does not explain the frames or a held-out plane.

References
----------
B. Efron and R. J. Tibshirani, "An Introduction to the Bootstrap" (Chapman and Hall, 1993), section 6.5.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, TransferLensError, validate_whole_number
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel, RealArray
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, intensity_deviation, with_intensity

LARGEST_NOISE_RATIO = 1.5
"""Misfit over that of noise alone above which the frames are not explained."""

EQUIVALENT_RATIO = 1.1
"""Ratio of misfits up to which two results count as fitting equally well."""

LARGEST_DIFFERENCE = 0.1
"""Relative difference of two equivalent objects above which the frames do not determine the object."""


class UndeterminedError(TransferLensError):
    """The frames do not determine the object well enough to state its uncertainty."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainty of a reconstructed transmission.

    Attributes
    ----------
    values : ndarray
        Standard deviation of each sample, on the object grid: root of the summed variances of real and
        imaginary part, from noise and between starts; 0 where there is no light.
    noise_rms, starts_rms : float
        Root mean square of the part that follows from noise, and of that between starts, where there is
        light.
    misfit_over_noise : float
        Misfit of the result over that of noise alone.
    held_out_over_noise : float or None
        The same ratio on a held-out plane.
    not_included : str
        Description of errors that are not included.
    """

    values: Array
    noise_rms: float
    starts_rms: float
    misfit_over_noise: float
    held_out_over_noise: float | None
    not_included: str


def uncertainty(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Measurement],
    found: Reconstructed,
    *,
    kind: Kind = "complex",
    tv_weight: float | Literal["auto"] = 0.0,
    iterations: int = 12,
    fill_factor: float = 0.0,
    held_out: Measurement | None = None,
    repeats: int = 8,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Uncertainty:
    """Return the uncertainty of a reconstructed transmission, sample by sample, due to noise and the start.

    Parameters
    ----------
    engine, illumination, recorded, kind, tv_weight, fill_factor
        Arguments of :func:`wavesim.reconstruct` that gave `found`; all planes state their `sigma`.
    found
        Result of the reconstruction.
    iterations
        Iterations of each repeat, which starts at `found`; other starts use as many as `found` did.
    held_out
        Measured plane that was not used for `found`.
    repeats
        Number of repeats, at least two. With n of them the standard deviation itself is known
        to one part in sqrt(2 (n - 1)).
    seed
        Seed of the noise and of a random start.
    progress
        Callback `progress(completed, total)` with the number of reconstructions.

    Returns
    -------
    Uncertainty
        Standard deviations, and the ratios of misfit to noise.

    Raises
    ------
    InputError
        If there are fewer than two repeats, or a plane has no sigma.
    UndeterminedError
        If the result does not explain the frames or the held-out plane within `LARGEST_NOISE_RATIO`, if
        another start fits better by more than `EQUIVALENT_RATIO`, or if one fits equally well with an object
        that differs by more than `LARGEST_DIFFERENCE`.
    """
    validate_whole_number("repeats", repeats, 2)
    if any(plane.sigma is None for plane in (*recorded, *([] if held_out is None else [held_out]))):
        raise InputError("uncertainty: needs sigma on every plane")

    own = found.transmission.values

    def modelled(planes: Sequence[Measurement]) -> list[RealArray]:
        return ChannelModel.of_source(engine, illumination, planes, found.scale, fill_factor).amplitudes(own)

    clean = modelled(recorded)
    misfit_over_noise = _noise_ratio(recorded, clean, "the frames")
    held_out_over_noise = None
    if held_out is not None:
        held_out_over_noise = _noise_ratio([held_out], modelled([held_out]), "the plane held out")
    settings: dict[str, Any] = {
        "kind": kind,
        "tv_weight": tv_weight,
        "scale": found.scale,
        "fill_factor": fill_factor,
    }
    lit = np.abs(illumination.values) > 0.0
    starts = _starts(illumination, kind, seed)
    others = []
    for index, start in enumerate(starts):
        other = reconstruct(
            engine, illumination, recorded, iterations=len(found.misfit), start=start, **settings
        )
        others += _equivalent_objects(found, other, lit)
        if progress is not None:
            progress(index + 1, len(starts) + repeats)
    noise = [_noise_levels(plane) for plane in recorded]
    results = []
    for index, sequence in enumerate(np.random.SeedSequence(seed).spawn(repeats)):
        random = np.random.default_rng(sequence)
        noisy_planes = [
            _noisy(plane, amplitude, levels, random)
            for plane, amplitude, levels in zip(recorded, clean, noise, strict=True)
        ]
        repeat = reconstruct(
            engine, illumination, noisy_planes, iterations=iterations, start=found.transmission, **settings
        )
        results.append(_in_phase(repeat.transmission.values, own, lit))
        if progress is not None:
            progress(len(starts) + index + 1, len(starts) + repeats)
    by_noise = np.asarray(np.mean(np.abs(np.asarray(results) - own) ** 2, axis=0), float)
    by_start = _variance([own, *others])
    not_included = (
        "errors that all starts have in common are not included: a wrong model of lens, light or camera, and "
        "the part of the rounding of edges by the total variation that a second reconstruction does not show"
    )
    return Uncertainty(
        np.sqrt(by_noise + by_start),
        math.sqrt(float(by_noise[lit].mean())),
        math.sqrt(float(by_start[lit].mean())),
        misfit_over_noise,
        held_out_over_noise,
        not_included if held_out is not None else f"{not_included}; no plane was held out",
    )


def _in_phase(values: NDArray[Any], reference: NDArray[Any], lit: NDArray[np.bool_]) -> NDArray[Any]:
    """Return values whose common phase is that of a reference."""
    overlap = np.vdot(values[lit], reference[lit])
    return np.asarray(values * (overlap / max(abs(overlap), np.finfo(float).tiny)))


def _variance(results: Sequence[NDArray[Any]]) -> Array:
    """Return the variance of real and imaginary part together; 0 for a single result."""
    values = np.asarray(results)
    squares = np.sum(np.abs(values - values.mean(axis=0)) ** 2, axis=0)
    return np.asarray(squares / max(len(values) - 1, 1), float)


def _noise_ratio(planes: Sequence[Measurement], modelled: Sequence[RealArray], source: str) -> float:
    """Return the misfit of a result over that of noise alone, on planes that it must explain."""
    squared_misfit = noise = 0.0
    for plane, amplitude in zip(planes, modelled, strict=True):
        assert plane.sigma is not None
        known = np.isfinite(plane.sigma)
        squared_misfit += float(np.sum((amplitude - plane.amplitude)[known] ** 2, dtype=float))
        noise += float(np.sum(plane.sigma[known] ** 2, dtype=float))
    ratio = math.sqrt(squared_misfit / noise)
    if ratio > LARGEST_NOISE_RATIO:
        raise UndeterminedError(
            f"uncertainty: the residuals are {ratio:.3g} times the noise of {source}: object, lens, light or "
            "camera differ from the model; use more planes or iterations or another start, or calibrate"
        )
    return ratio


def _starts(illumination: Field, kind: Kind, seed: int) -> list[Field | Literal["amplitude"] | None]:
    """Return a constant start, an amplitude object, and a smooth random start."""
    random = np.random.default_rng(seed).standard_normal(illumination.grid.shape)
    # Standard deviation, in samples, of the kernel that smooths a random start.
    start_samples = 4.0
    smooth = gaussian_filter(random, start_samples)
    smooth /= smooth.std()
    values = 1.0 / (1.0 + np.exp(smooth)) if kind == "amplitude" else np.exp(1j * smooth)
    start = illumination.with_values(values.astype(illumination.values.dtype))
    return [None, "amplitude", start] if kind == "complex" else [None, start]


def _equivalent_objects(
    found: Reconstructed, other: Reconstructed, lit: NDArray[np.bool_]
) -> list[NDArray[Any]]:
    """Return the object of another start in the phase of the first if it fits equally well, else nothing."""
    own_misfit, other_misfit = found.misfit[-1], other.misfit[-1]
    if other_misfit > EQUIVALENT_RATIO * own_misfit:
        return []
    if own_misfit > EQUIVALENT_RATIO * other_misfit:
        raise UndeterminedError(
            f"uncertainty: the misfit of the result is {own_misfit:.4g}, that of another start "
            f"{other_misfit:.4g}: the result is not the object that fits best; use another start, "
            "more iterations or more planes"
        )
    values, aligned = found.transmission.values, other.transmission.values
    aligned = _in_phase(aligned, values, lit)
    difference = float(np.linalg.norm((values - aligned)[lit]) / np.linalg.norm(values[lit]))
    if difference > LARGEST_DIFFERENCE:
        raise UndeterminedError(
            "uncertainty: another start gives an object that fits equally well, but differs by "
            f"{100.0 * difference:.3g} %: the frames do not determine it; use more planes, more "
            "iterations or more total variation"
        )
    return [aligned]


def _noise_levels(plane: Measurement) -> tuple[Array, Array]:
    """Return intensities, and the variance of each of them, as the pixels of a record sample it."""
    assert plane.sigma is not None
    known = np.isfinite(plane.sigma)
    recorded, variance = plane.amplitude[known].astype(float), intensity_deviation(plane)[known] ** 2
    bins = np.minimum(200.0 * recorded / max(float(recorded.max()), np.finfo(float).tiny), 199.0).astype(int)
    counts = np.bincount(bins)
    intensity, mean_variance = (
        np.bincount(bins, values)[counts > 0] / counts[counts > 0] for values in (recorded**2, variance)
    )
    return intensity, mean_variance


def _noisy(
    plane: Measurement, amplitude: RealArray, levels: tuple[Array, Array], random: np.random.Generator
) -> Measurement:
    """Return a record of modelled amplitudes with the noise of another record and its noise levels."""
    assert plane.sigma is not None
    intensity = amplitude.astype(float) ** 2
    intensity += np.sqrt(np.interp(intensity, *levels)) * random.standard_normal(intensity.shape)
    variance = np.where(np.isfinite(plane.sigma), np.interp(intensity, *levels), np.inf)
    return with_intensity(plane, intensity, variance)
