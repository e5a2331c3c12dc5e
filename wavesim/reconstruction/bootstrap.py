"""How far noise moves a reconstruction, sample by sample: a parametric bootstrap.

The reconstruction is taken for the object and recorded again several times, each with other noise of the
stated standard deviations; each record is reconstructed by the same settings. How much the results scatter is
what noise does to them. What all have in common, such as edges that the total variation rounds, a wrong model
of the lens or a wrong start, does not scatter and is not in it.

Source: B. Efron and R. J. Tibshirani, "An Introduction to the Bootstrap" (Chapman and Hall, 1993), 6.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, refuse_not_whole
from wavesim.camera.recorded import Recorded
from wavesim.fields.field import Field
from wavesim.reconstruction.from_object import Kind, Reconstructed, reconstruct
from wavesim.reconstruction.recording_model import RealArray, RecordingModel
from wavesim.scene.engine import Engine

ITERATIONS = 12
"""From the reconstruction on, of which each record differs by noise alone."""


def uncertainty(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    found: Reconstructed,
    *,
    kind: Kind = "complex",
    tv_weight: float | Literal["auto"] = 0.0,
    iterations: int = ITERATIONS,
    active_width: float = 0.0,
    repeats: int = 8,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Array:
    """Standard deviation of each sample of a reconstructed transmission from the noise of the amplitudes.

    Parameters
    ----------
    engine, illumination, recorded, kind, tv_weight, active_width
        As of :func:`wavesim.reconstruct`, and as they were for `found`; all planes state their `sigma`.
    found
        What was reconstructed from them.
    iterations
        Of each repeat, from `found` on.
    repeats
        Two at least. With n of them the standard deviation itself is known to one part in sqrt(2 (n - 1)).
    seed
        Of the noise.
    progress
        Called with the number of repeats done, and that of all.

    Returns
    -------
    ndarray, of the object grid's shape
        Root of the summed variances of real and imaginary part; 0 where there is no light.

    Raises
    ------
    InputError
        If there are fewer than two repeats, or a plane has no sigma.
    """
    refuse_not_whole("repeats", repeats, 2)
    if any(plane.sigma is None for plane in recorded):
        raise InputError("uncertainty: needs sigma on every plane")
    clean = RecordingModel(engine, illumination, recorded, found.scale, active_width).amplitudes(
        found.transmission.values
    )
    results = []
    for number, one in enumerate(np.random.SeedSequence(seed).spawn(repeats)):
        random = np.random.default_rng(one)
        again = [_noisy(plane, a, random) for plane, a in zip(recorded, clean, strict=True)]
        repeat = reconstruct(
            engine,
            illumination,
            again,
            kind=kind,
            tv_weight=tv_weight,
            iterations=iterations,
            scale=found.scale,
            start=found.transmission,
            active_width=active_width,
        )
        results.append(repeat.transmission.values)
        if progress is not None:
            progress(number + 1, repeats)
    values = np.asarray(results)
    variance = np.sum(np.abs(values - values.mean(axis=0)) ** 2, axis=0) / (repeats - 1)
    return np.asarray(np.sqrt(variance), float)


def _noisy(plane: Recorded, amplitude: RealArray, random: np.random.Generator) -> Recorded:
    assert plane.sigma is not None
    sigma = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
    noisy = np.abs(amplitude + sigma * random.standard_normal(amplitude.shape))
    return replace(plane, amplitude=noisy.astype(plane.amplitude.dtype))
