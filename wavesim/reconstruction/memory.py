"""Arrays that a reconstruction holds, and when: each listed once, and told before it runs what they take.

A new array is one line here, in the list of the step that makes it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

import numpy as np

from wavesim.reconstruction.recording.bands import bytes_of_bands
from wavesim.reconstruction.refocusing import MOST_JUDGED
from wavesim.reconstruction.retrieval.steps import bytes_at_work, rows_of_block
from wavesim.runtime import threads
from wavesim.runtime.fourier.columns import bytes_of_columns
from wavesim.runtime.fourier.panels import bytes_of_panels
from wavesim.runtime.inventory import ArrayGroup, Inventory, named, need_of, work
from wavesim.runtime.memory import BASE_BYTES, COMPLEX64, Need
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.targets.patch import LIGHT_BYTES

LIGHT_OF_MODE_BYTES = 56
"""For each sample of the object, while light of one direction is made, in double precision."""

TILTED_WAYS, TILTED_FIELDS = 6, 3
"""Planes, at most as a rule, from which the field on a tilted sensor follows, and fields while it does."""

READ_BYTES = 24
"""For each sample of the object, while a true object is read. Measured."""

REFOCUSED_BYTES, CARRIED_BYTES, PSNR_BYTES, PRODUCT_BYTES, SIMILARITY_BYTES = 330, 85, 12, 64, 160
"""For each sample whose sharpness is asked for, that is carried along the axis with these, or compared with
the truth; and for each of a block of rows that is. Measured."""

PICTURE_BYTES, SCREEN_BYTES, SCREEN, DRAWN_BYTES, PLANE_BYTES = 60_000_000, 100, 4_000_000, 12, 9
"""Of what draws pictures, of each sample as far as it is drawn by itself (`SCREEN` of them at most), and of
each of the object, or pixel of a plane. Measured."""


class Phase(Flag):
    """What a run does at one time.

    An iteration goes through the lens, changes the field by what pixels saw on each plane, goes back to the
    object, smoothes it, steps, and accelerates; the first one sees planes once more, for the scale. One of
    Appendix A is a pass.
    """

    LIGHTING, READING, MOVING = auto(), auto(), auto()
    DRAWING_NOISE = auto()
    STARTING = auto()
    MEASURING_NOISE = auto()
    LENS = auto()
    SEEING = auto()
    CHANGING = auto()
    BACK = auto()
    SMOOTHING = auto()
    STEPPING = auto()
    ACCELERATING = auto()
    PASSING = auto()
    ENDING = auto()
    JUDGING = auto()
    COMPARING = auto()
    SHARPNESS = auto()
    CARRYING = auto()
    DRAWING = auto()


BEFORE = Phase.LIGHTING | Phase.READING | Phase.MOVING
PLANES = Phase.SEEING | Phase.CHANGING
SEEN = PLANES | Phase.ENDING
STEPPING = Phase.STEPPING | Phase.ACCELERATING
ITERATING = Phase.LENS | PLANES | Phase.BACK | Phase.SMOOTHING | STEPPING
STARTING = Phase.STARTING | Phase.MEASURING_NOISE
DESCENDING = Phase.DRAWING_NOISE | STARTING | ITERATING | Phase.ENDING
RESULTS = Phase.JUDGING | Phase.COMPARING | Phase.SHARPNESS | Phase.CARRYING | Phase.DRAWING
AFTER_MOVING = DESCENDING | Phase.PASSING | RESULTS


@dataclass(frozen=True)
class Sizes:
    """What sizes and numbers of arrays follow from.

    Attributes
    ----------
    source, behind : tuple of int
        Samples of the object, and of the exit grid.
    distances_mm : tuple of float
        Of the recorded planes from the exit grid.
    engine_bytes : int
        That the engine takes.
    dtype : numpy dtype
        Of fields.
    """

    source: tuple[int, ...]
    behind: tuple[int, ...]
    distances_mm: tuple[float, ...]
    engine_bytes: int = 0
    dtype: Any = np.complex64

    @classmethod
    def of(cls, engine: Engine, distances_mm: Sequence[float]) -> Sizes:
        """With an engine, in complex64."""
        scene, taken = engine.scene, engine.cost().peak_bytes_in_single
        return cls(scene.object_grid.shape, scene.exit_grid.shape, tuple(distances_mm), taken)

    @property
    def real(self) -> np.dtype[Any]:
        """Of amplitudes."""
        return np.zeros(0, self.dtype).real.dtype

    @property
    def planes(self) -> int:
        """How many are recorded."""
        return len(self.distances_mm)

    @property
    def far(self) -> int:
        """How many have a way to them."""
        return sum(distance != 0.0 for distance in self.distances_mm)

    @property
    def quarter(self) -> tuple[int, ...]:
        """Frequencies of the exit grid that are not negative, for which a way is kept."""
        return tuple(n // 2 + 1 for n in (1, *self.behind)[-2:])


def given_arrays(
    sizes: Sizes, *, with_sigma: bool = True, backgrounds: int = 0, truth: bool = False
) -> Inventory:
    """What is reconstructed from: `backgrounds` planes have one; `truth`: with a true object, to compare."""
    source, behind, held, stated = sizes.source, sizes.behind, AFTER_MOVING, sizes.planes * with_sigma
    return (
        ArrayGroup("the illumination", source, sizes.dtype, held, lies="scratch"),
        ArrayGroup("the recorded amplitudes", behind, sizes.real, held, sizes.planes, lies="scratch"),
        ArrayGroup("the standard deviations", behind, sizes.real, held, stated, lies="scratch"),
        ArrayGroup("the backgrounds", behind, sizes.real, held, backgrounds, lies="scratch"),
        ArrayGroup("the true object", source, sizes.dtype, held, int(truth), lies="scratch"),
    )


def step_array(
    sizes: Sizes, kind: Kind, during: Phase = ITERATING & ~Phase.SEEING, count: int = 2
) -> ArrayGroup:
    """The object after a step, and the point from which the next one goes; `kind` of object: as sought."""
    dtype = sizes.real if kind == "amplitude" else sizes.dtype
    return ArrayGroup("a step", sizes.source, dtype, during, count, lies="scratch")


def descent_arrays(
    sizes: Sizes, kind: Kind, fill_factor: float, modes: int = 1, tilted: bool = False
) -> Inventory:
    """What :func:`wavesim.reconstruct` holds beside what it is given; `kind`, `fill_factor`: as of it.

    `modes` are those of the light of a wide source; `tilted`: the sensor is.
    """
    source, behind, quarter, dtype, real = sizes.source, sizes.behind, sizes.quarter, sizes.dtype, sizes.real
    step = step_array(sizes, kind)
    through_lens = Phase.STARTING | Phase.LENS | Phase.BACK | Phase.ENDING
    common: Inventory = (
        ArrayGroup("where there is light", source, bool, DESCENDING),
        ArrayGroup("ways to planes", quarter, dtype, DESCENDING, sizes.far),
        work("the engine's work", sizes.engine_bytes, through_lens),
        ArrayGroup("noise at the exit", behind, dtype, Phase.DRAWING_NOISE, 1 + int(sizes.planes > 1)),
        ArrayGroup("a way back", quarter, dtype, Phase.DRAWING_NOISE, int(sizes.far > 0)),
        ArrayGroup("the sum of noise at the exit", behind, dtype, Phase.STARTING),
        ArrayGroup("noise in the object", source, dtype, STARTING),
        step,
        step_array(sizes, kind, Phase.SEEING, 1),
        ArrayGroup("the field in the object", source, dtype, Phase.LENS),
        ArrayGroup("the field at the exit", behind, dtype, Phase.LENS),
        ArrayGroup("the change at the exit", behind, dtype, Phase.BACK),
        ArrayGroup("the change of the object", source, dtype, Phase.BACK),
        ArrayGroup("the object, smoothed, as it was, and its flow", source, step.dtype, Phase.SMOOTHING, 4),
        ArrayGroup("the object, smoothed", source, step.dtype, Phase.STEPPING),
        step_array(sizes, kind, Phase.STEPPING, 1),
        step_array(sizes, kind, Phase.ACCELERATING, 2),
        step_array(sizes, kind, Phase.ENDING, 1),
        ArrayGroup("residual maps", behind, real, Phase.ENDING, sizes.planes),
    )
    if tilted:
        common += _of_a_tilt(sizes)
    if modes > 1:
        return common + _of_modes(sizes, modes)
    return common + (_of_pixels(sizes) if fill_factor > 0.0 else _of_points(sizes))


def _of_a_tilt(sizes: Sizes) -> Inventory:
    """While the sensor is tilted."""
    ways = TILTED_WAYS * sizes.planes
    return (
        ArrayGroup("ways to parallel planes", sizes.quarter, sizes.dtype, DESCENDING, ways),
        ArrayGroup("fields on parallel planes", sizes.behind, sizes.dtype, SEEN, TILTED_FIELDS),
    )


def _of_modes(sizes: Sizes, modes: int) -> Inventory:
    """While planes are seen in the light of several modes, by pixels."""
    behind, dtype, real = sizes.behind, sizes.dtype, sizes.real
    all_through = Phase.LENS | SEEN | Phase.BACK
    return (
        ArrayGroup("spectra of modes at the exit", behind, dtype, all_through, modes),
        ArrayGroup("what rounds have changed of modes", behind, dtype, PLANES | Phase.BACK, modes),
        ArrayGroup("means over pixels", behind, real, all_through, sizes.planes),
        work("light of a mode", LIGHT_OF_MODE_BYTES * math.prod(sizes.source), Phase.LENS | Phase.BACK),
        ArrayGroup("the change of the object so far", sizes.source, dtype, PLANES | Phase.BACK),
        ArrayGroup("rows through pixels and their edges", behind, dtype, SEEN, 2),
        ArrayGroup("means along rows, and over pixels", behind, real, Phase.SEEING | Phase.ENDING, 3),
        ArrayGroup("what planes have changed", behind, dtype, Phase.CHANGING),
    )


def _of_pixels(sizes: Sizes) -> Inventory:
    """While planes are seen by pixels that integrate."""
    behind, dtype, real = sizes.behind, sizes.dtype, sizes.real
    return (
        ArrayGroup("the spectrum at the exit", behind, dtype, SEEN),
        ArrayGroup("rows through pixels and their edges", behind, dtype, SEEN, 2),
        ArrayGroup("means along rows", behind, real, Phase.SEEING | Phase.ENDING, 2),
        ArrayGroup("means over pixels", behind, real, Phase.SEEING),
        ArrayGroup("what rounds before have changed", behind, dtype, Phase.CHANGING),
        ArrayGroup("what planes have changed", behind, dtype, Phase.CHANGING),
        work("rows of bands, and beside them", bytes_of_bands(behind, dtype), Phase.CHANGING),
        work("columns at work", bytes_of_columns(behind[0], dtype), ITERATING | Phase.ENDING),
    )


def _of_points(sizes: Sizes) -> Inventory:
    """While planes are seen at points."""
    behind, dtype, real = sizes.behind, sizes.dtype, sizes.real
    far, near = sizes.far, sizes.planes - sizes.far
    changed_before = int(near > 0 and sizes.planes > 1) + int(far > 1)
    return (
        ArrayGroup("the field at the exit, seen", behind, dtype, SEEN),
        ArrayGroup("the spectrum at the exit", behind, dtype, SEEN, int(far > 0)),
        ArrayGroup("the field on a plane", behind, dtype, SEEN),
        ArrayGroup("squares of its parts", behind, real, Phase.SEEING, 2),
        ArrayGroup("a square of its parts", behind, real, Phase.ENDING),
        ArrayGroup("a way back", sizes.quarter, dtype, Phase.CHANGING, int(far > 0)),
        ArrayGroup("what rounds before have changed", behind, dtype, Phase.CHANGING),
        ArrayGroup("what planes before have changed", behind, dtype, Phase.CHANGING, changed_before),
    )


def reconstruction_bytes(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    kind: Kind = "complex",
    fill_factor: float = 0.0,
    with_sigma: bool = True,
    modes: int = 1,
    tilted: bool = False,
) -> Need:
    """Memory that :func:`wavesim.reconstruct` takes in complex64, beside Python and libraries (some 0.3 GB).

    Parameters
    ----------
    engine
        As of :func:`wavesim.reconstruct`.
    distances_mm
        Of the recorded planes, from the engine's exit grid.
    kind, fill_factor
        As of :func:`wavesim.reconstruct`.
    with_sigma
        Whether recorded amplitudes come with standard deviations.
    modes
        Of the light, if its source is wide.
    tilted
        Whether the sensor is tilted.

    Returns
    -------
    Need
        Illumination, recorded arrays and last steps are those that can lie in files.
    """
    sizes = Sizes.of(engine, distances_mm)
    own = descent_arrays(sizes, kind, fill_factor, modes, tilted)
    return need_of(given_arrays(sizes, with_sigma=with_sigma) + own)


def retrieval_arrays(sizes: Sizes, masked: bool = True) -> Inventory:
    """What :func:`wavesim.retrieve` holds beside its arguments; `masked`: not all pixels are known."""
    behind, dtype, passing = sizes.behind, sizes.dtype, Phase.PASSING
    plane = math.prod(behind[:-1]), behind[-1]
    blocks = plane[0] // rows_of_block(plane, np.dtype(dtype).itemsize, with_neighbours=True)
    on_plane, way = (bytes_of_panels((rows, plane[1]), dtype) for rows in (plane[0], plane[0] // 2 + 1))
    return (
        ArrayGroup("the field sought, and the one before", behind, dtype, passing, 2),
        work("fields on planes", sizes.far * on_plane, passing),
        work("ways to planes", sizes.far * way, passing),
        ArrayGroup("pixels that are known", behind, bool, passing, sizes.planes * masked),
        ArrayGroup("rows beside blocks", behind[-1:], dtype, passing, 2 * blocks),
        work("blocks", (os.cpu_count() or 1) * bytes_at_work(plane, dtype), passing),
    )


def retrieval_bytes(shape: tuple[int, ...], distances_mm: Sequence[float], masked: bool = True) -> int:
    """Most bytes that :func:`wavesim.retrieve` takes in single precision, beside its arguments.

    Parameters
    ----------
    shape
        Of the grid.
    distances_mm
        Of the recorded planes from the plane sought. One at 0 takes no transforms.
    masked
        Whether planes have pixels that tell nothing.
    """
    return need_of(retrieval_arrays(Sizes(shape, shape, tuple(distances_mm)), masked)).most_bytes


def run_arrays(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    method: str,
    kind: Kind,
    fill_factor: float,
    frames_bytes: int,
    shown: tuple[int, ...],
    carried: int,
    truth: bool,
    backgrounds: int = 0,
    modes: int = 1,
    tilted: bool = False,
) -> Inventory:
    """What the command `wavesim reconstruct` holds, from reading its frames to writing its results.

    Parameters
    ----------
    engine, distances_mm, kind, fill_factor
        As of :func:`reconstruction_bytes`; amplitudes are of float32 and come with standard deviations.
    method
        "object" or "paper".
    frames_bytes
        Of all frames as they are read.
    shown
        Samples of the object, along each axis, that are judged and written.
    carried
        Number of samples that are carried along the axis for refocusing; 0 without it.
    truth
        Whether a true object is compared.
    backgrounds
        How many planes have a background.
    modes, tilted
        As of :func:`reconstruction_bytes`.
    """
    sizes, of_object = Sizes.of(engine, distances_mm), method == "object"
    own = descent_arrays(sizes, kind, fill_factor, modes, tilted) if of_object else _paper_arrays(sizes)
    given = given_arrays(sizes, truth=truth, backgrounds=backgrounds)
    source = math.prod(sizes.source)
    before = (
        work("the process itself", BASE_BYTES, BEFORE | AFTER_MOVING),
        work("the frames", frames_bytes, BEFORE),
        work("light, as it is made", LIGHT_BYTES * source, Phase.LIGHTING),
        work("the true object, as it is read", truth * (COMPLEX64 + READ_BYTES) * source, Phase.READING),
        work("all that is given, as it was read", sum(one.bytes_of_all for one in given), Phase.MOVING),
    )
    # A new checkpoint is written before the earlier one goes.
    passing = ("the field sought, and the one before", Phase.PASSING)
    state, kept = ("a step", ITERATING) if of_object else passing
    files = (ArrayGroup("checkpoints", (named(own, state).bytes_of_all,), np.uint8, kept, 2, lies="file"),)
    return before + given + own + files + _results(sizes, method, shown, carried, truth)


def _paper_arrays(sizes: Sizes) -> Inventory:
    """What Appendix A holds, with the field that it starts from."""
    lifted = Phase.LENS | Phase.PASSING
    return (
        work("the engine's work", sizes.engine_bytes, Phase.LENS),
        ArrayGroup("the field at the exit", sizes.behind, sizes.dtype, Phase.LENS, 2),
        ArrayGroup(
            "amplitudes above the noise", sizes.behind, sizes.real, lifted, sizes.planes, lies="scratch"
        ),
        *retrieval_arrays(sizes),
    )


def _results(sizes: Sizes, method: str, shown: tuple[int, ...], carried: int, truth: bool) -> Inventory:
    """What is held from the last iteration on; all but `sizes` as of :func:`run_arrays`."""
    dtype, part, of_object = sizes.dtype, math.prod(shown), method == "object"
    block, behind = part // shown[0] * min(shown[0], threads.BLOCK), math.prod(sizes.behind)
    judged = max(2 * COMPLEX64 * part, COMPLEX64 * part + PRODUCT_BYTES * block)
    compared = COMPLEX64 * part + max(PSNR_BYTES * part, SIMILARITY_BYTES * block)
    drawn = PICTURE_BYTES + SCREEN_BYTES * min(part, SCREEN) + max(DRAWN_BYTES * part, PLANE_BYTES * behind)
    return (
        ArrayGroup("maps of residuals", sizes.behind, sizes.real, RESULTS, sizes.planes),
        ArrayGroup("what was found", sizes.source if of_object else sizes.behind, dtype, RESULTS),
        ArrayGroup("the part that is shown", shown, dtype, RESULTS, int(carried > 0 or not of_object)),
        ArrayGroup("a field that the lens passes", shown, dtype, Phase.JUDGING, 2 * truth, lies="scratch"),
        work("fields, and what the lens passes of them", truth * judged, Phase.JUDGING),
        work("a comparison", truth * compared, Phase.COMPARING),
        work("sharpness", REFOCUSED_BYTES * min(carried, MOST_JUDGED**2), Phase.SHARPNESS),
        work("what is carried along the axis", CARRIED_BYTES * carried, Phase.CARRYING),
        work("pictures", drawn, Phase.DRAWING),
    )
