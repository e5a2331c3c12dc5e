"""Noise of a step: the part of a descent's step that the noise of the measured amplitudes causes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.exit_field import ALL_ROWS, ROWS
from wavesim.scene.engine import Tiled

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


def noise_of_step(model: ChannelModel) -> float:
    """Return the standard deviation that noise causes in a step, for the real or imaginary part at scale 1.

    One draw of the noise is propagated back through the lens, as light of the middle of the source. This
    accounts for aperture, windows and weights. Where the light has its peak brightness the result is about::

        s sqrt(exit cell / (2 planes object cell)) / max |u|,

    because the engine is nearly unitary and half of the noise energy is in the real part. The noise is
    inversely proportional to the scale.

    Parameters
    ----------
    model
        Model of one transmission.

    Raises
    ------
    InputError
        If a plane has no standard deviations.
    """
    if any(p.sigma is None for p in model.recorded):
        raise InputError("tv_weight = 'auto': needs sigma on every plane; state sigma, or give a number")
    on_object, light = _noise_on_object(model), model.illumination.values
    total, count = 0.0, 0
    for start in range(0, len(on_object), ROWS):
        rows = slice(start, start + ROWS)
        lit = model.lit[rows] & (on_object[rows] != 0.0)
        change = np.abs(on_object[rows][lit] * light[rows][lit])
        total, count = total + float(np.vdot(change, change)), count + len(change)
    return math.sqrt(0.5 * total / count) / (model.peak_powers[0] * len(model.recorded))


def noise_of_steps(model: ChannelModel, seed: int = 0) -> RealArray:
    """Return the standard deviation that noise causes in a step at scale 1, for each transmission.

    On a plane, a channel gets the part of the noise that belongs to its fraction of the light that passes
    objects of transmission 1.

    Parameters
    ----------
    model
        Model of several transmissions.
    seed
        Seed of the draw.
    """
    random = np.random.default_rng(seed)
    spectra = model.spectra(np.ones(model.lit.shape, model.real))
    noises = []
    for index, plane in enumerate(model.planes):
        known = np.isfinite(plane.sigma)
        sigma = np.where(known, plane.sigma, 1.0)
        weight = np.minimum(plane.full_weight_sigma / sigma, 1.0) ** 2 * known
        noise = (weight * sigma * random.standard_normal(sigma.shape)).astype(model.real)
        intensity = model.intensity(index, spectra)
        # The change of a field by a change of the amplitude is relative to the amplitude.
        noises.append(noise / np.sqrt(np.maximum(intensity, 1e-6 * float(intensity.mean()))))
    totals = [np.zeros_like(spectrum) for spectrum in spectra]
    for index, (spectrum, total) in enumerate(zip(spectra, totals, strict=True)):
        model.add_adjoint(index, spectrum, noises, total)
    changes = model.to_transmission(totals)
    return np.array(
        [
            math.sqrt(0.5 * float(np.mean(np.abs(change[lit]) ** 2)))
            for change, lit in zip(changes, model.lit, strict=True)
        ],
        model.real,
    )


def _noise_on_object(model: ChannelModel) -> ComplexArray:
    """Return one draw of the noise of all planes on the object; 0 where it did not pass the lens."""
    engine = model.engine
    field = Field(engine.scene.exit_grid, _noise_at_exit(model), model.illumination.wavelength_um)
    if not isinstance(engine, Tiled):
        return np.asarray(engine.adjoint(field).values)
    # Smallest number of parts of a tiled engine from which the noise of a step is estimated.
    noise_parts = 8
    step = math.ceil(engine.parts / noise_parts)
    return np.asarray(engine.adjoint_on(field, range(0, engine.parts, step)).values)


def _noise_at_exit(model: ChannelModel) -> ComplexArray:
    """Return one draw of the noise of all planes on the exit grid."""
    random = np.random.default_rng(0)
    shape = model.engine.scene.exit_grid.shape
    total: ComplexArray | None = None
    for plane in model.planes:
        # Real noise passes the lens as well as noise of any other phase.
        noise = np.zeros(plane.amplitude.shape, model.dtype)
        for row, sigma in zip(noise.real, plane.sigma, strict=True):
            is_known = np.isfinite(sigma)
            stated = np.where(is_known, sigma, model.real.type(1.0))
            size = np.minimum(plane.full_weight_sigma / stated, 1.0) ** 2 * stated * is_known
            np.multiply(size, random.standard_normal(len(row), model.real), out=row, casting="same_kind")
        if plane.rows != ALL_ROWS:
            total = np.zeros(shape, model.dtype) if total is None else total
            total[plane.rows] += noise
            continue
        plane_noise = noise.reshape(shape)
        if not plane.propagator.is_identity:
            plane_noise = scipy.fft.ifftn(plane.propagator.adjoint(plane_noise), workers=-1, overwrite_x=True)
        total = plane_noise if total is None else np.add(total, plane_noise, out=total)
    assert total is not None
    return total
