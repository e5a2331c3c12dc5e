"""Partially coherent light of extended or polychromatic sources: a sum over mutually incoherent modes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.scene.engine import Engine
from wavesim.scene.polarization import SCALAR
from wavesim.scene.scene import Scene
from wavesim.scene.source import SourceMode


def of_mode(
    engine: Engine, behind_object: Field, mode: SourceMode, make: Callable[[Scene], Engine] | None
) -> tuple[Engine, Field]:
    """Return engine and field behind the object for one direction and wavelength of the source."""
    lit = mode.on(behind_object)
    if mode.wavelength_um == behind_object.wavelength_um:
        return engine if mode.component is None else engine.component(mode.component), lit
    if make is None:
        raise InputError(
            "make: missing; light of several wavelengths needs a function that makes an engine for each"
        )
    # All wavelengths have as many components as the first one.
    polarization = engine.scene.polarization if engine.components > 1 else SCALAR
    made = make(replace(engine.scene, wavelength_um=mode.wavelength_um, polarization=polarization))
    return made if mode.component is None else made.component(mode.component), lit


def added_modes(
    modes: Sequence[SourceMode], light_of_mode: Callable[[SourceMode, str], Iterator[tuple[Array, float]]]
) -> list[tuple[Array, float]]:
    """Return the summed intensity of all modes on each plane, and its fraction beyond the Nyquist limit."""
    total: list[tuple[Array, float]] = []  # intensity, and energy beyond the limit
    for index, mode in enumerate(modes):
        planes = light_of_mode(mode, f"mode_{index}")
        weighted = [
            (mode.weight * intensity, mode.weight * float(intensity.sum()) * beyond)
            for intensity, beyond in planes
        ]
        if total:
            weighted = [(a + b, c + d) for (a, c), (b, d) in zip(total, weighted, strict=True)]
        total = weighted
    energies = (float(intensity.sum()) for intensity, _ in total)
    return [
        (intensity, beyond / energy if energy > 0.0 else 0.0)
        for (intensity, beyond), energy in zip(total, energies, strict=True)
    ]
