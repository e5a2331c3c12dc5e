"""Light of a source that is wide or coloured: modes that do not interfere, whose intensities add up."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.scene.bench import LightErrors
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.source import SourceMode


def of_mode(
    engine: Engine, behind_object: Field, mode: SourceMode, make: Callable[[Scene], Engine] | None
) -> tuple[Engine, Field]:
    """Engine and light of one direction and wavelength of the source; the object is the same to all."""
    lit = LightErrors(mode.tilt_deg).on(behind_object)
    if mode.wavelength_um == behind_object.wavelength_um:
        return engine, lit
    if make is None:
        raise InputError("make: light of several wavelengths needs an engine for each")
    own = make(replace(engine.scene, wavelength_um=mode.wavelength_um))
    return own, replace(lit, wavelength_um=mode.wavelength_um)


def added_modes(
    modes: Sequence[SourceMode], through: Callable[[SourceMode, str], Iterator[tuple[Array, float]]]
) -> list[tuple[Array, float]]:
    """Light of modes that do not interfere, on each plane: their intensities add up."""
    total: list[tuple[Array, float]] = []
    for number, mode in enumerate(modes):
        parts = [(mode.weight * one, mode.weight * beyond) for one, beyond in through(mode, f"mode_{number}")]
        if total:
            parts = [(a + b, c + d) for (a, c), (b, d) in zip(total, parts, strict=True)]
        total = parts
    return total
