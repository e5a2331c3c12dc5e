"""Memory of a reconstruction, estimated from the numbers of samples, planes and modes.

A run reads its inputs, iterates, tests the bench, and then compares and draws the result. Each of these
stages needs some bytes for every sample of the object grid, some for every sample of the exit grid, and some
for every pixel of all planes, besides those of the engine. The estimate is the largest stage. The bytes per
sample are rounded from measured peaks in single precision, and estimates lie within 30 % of the peaks
(`tests/wavesim/reconstruction/test_memory.py`). For whole commands, 1.4 and 2.0 GB are predicted, and 1.1 and
2.2 GB used, on the one-eighth and the one-quarter twin of the paper's lens (two planes, a patch of 0.38 mm);
with Appendix A on the one-eighth twin 0.85 and 0.82 GB.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from wavesim.forward.channel_model import KEPT_BYTES
from wavesim.reconstruction.refocusing import MOST_JUDGED
from wavesim.runtime.memory import BASE_BYTES, COMPLEX64, FLOAT32, MemoryNeed, in_memory, movable
from wavesim.runtime.threads import THREADS
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.settings import Kind, ReconstructionSettings
from wavesim.scene.source import SourceMode
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import LIGHT_BYTES

READ_BYTES, COMPARED_BYTES, MOVABLE_COMPARED_BYTES = 32, 20, 16
"""Bytes per sample while a true object is read, and while the result is compared with it: arrays that stay in
memory, and movable ones.
"""

SHARPNESS_BYTES, REFOCUSED_BYTES = 330, 85
"""Bytes per sample of the measure of sharpness (at most `MOST_JUDGED` squared samples), and of refocusing."""

PICTURE_BYTES, SCREEN_BYTES, SCREEN, DRAWN_BYTES = 60_000_000, 100, 4_000_000, 12
"""Bytes for pictures: in total, per sample on the screen (at most `SCREEN`), and per sample drawn."""

BLOCK_BYTES = 2_500_000
"""Bytes of the blocks of rows that a thread of Appendix A works on."""


def reconstruction_bytes(
    engine: Engine,
    recorded: Sequence[Measurement],
    *,
    kind: Kind = "complex",
    fill_factor: float = 0.0,
    modes: Sequence[SourceMode] = (),
) -> MemoryNeed:
    """Return the memory of :func:`wavesim.reconstruct` in complex64, with its arguments.

    Python and libraries take some 0.3 GB more.

    Parameters
    ----------
    engine, recorded, kind, fill_factor, modes
        See :func:`wavesim.reconstruct`.

    Returns
    -------
    MemoryNeed
        Memory with all arrays in memory, and with illumination, measured arrays and last steps in files.
    """
    on_object, at_exit, planes = engine.scene.object_grid.size, engine.scene.exit_grid.size, len(recorded)
    is_tilted = any(any(plane.tilt_deg) for plane in recorded)
    # The mask of lit samples, and transfer functions (for a tilted sensor those to parallel planes).
    wavelengths = len({mode.wavelength_um for mode in modes}) or 1
    engines = wavelengths * engine.cost().peak_bytes_in_single
    held = on_object + (14 if is_tilted else 2) * wavelengths * planes * at_exit
    through_lens = COMPLEX64 * (on_object + at_exit)
    smoothing = 4 * _step_bytes(on_object, kind)
    # On planes: fields at the exit and on one plane, their changes, and at the end residual maps. A single
    # plane of points needs the fewest of these.
    per_sample = 36 + 4 * planes if fill_factor > 0.0 or planes > 1 else 29
    on_planes = (per_sample + (24 if is_tilted else 0)) * at_exit
    if len(modes) > 1:  # spectra and changes of all modes, means over pixels, and fields on all planes
        held += (16 * len(modes) + 4 * planes) * at_exit
        kept = 16 * len(modes) * planes * at_exit
        held += kept if kept <= KEPT_BYTES else 0
        through_lens += 64 * on_object
    working = held + engines + max(through_lens, smoothing, on_planes)
    return _inputs(engine, recorded) + movable(2 * _step_bytes(on_object, kind)) + in_memory(working)


def retrieval_bytes(shape: tuple[int, ...], planes: int) -> int:
    """Return the largest memory of :func:`wavesim.retrieve` in single precision, besides its arguments, in
    bytes.

    Parameters
    ----------
    shape
        Shape of the grid.
    planes
        Number of planes.

    Examples
    --------
    >>> from wavesim.reconstruction import retrieval_bytes
    >>> retrieval_bytes((256, 256), 2) > 2 * 8 * 256**2
    True
    """
    # Three fields, and for each plane a transfer function and a mask.
    return (24 + 3 * planes) * math.prod(shape) + THREADS * BLOCK_BYTES


def run_bytes(
    engine: Engine,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    *,
    modes: Sequence[SourceMode],
    frames_bytes: int,
    shown: int,
    refocused: int,
    has_truth: bool,
    tests_bench: bool,
) -> MemoryNeed:
    """Return the memory of the command `wavesim reconstruct`, from reading frames to writing results.

    Parameters
    ----------
    engine, recorded, settings
        Engine, measurements and settings of the run.
    modes
        Modes of the light of the source.
    frames_bytes
        Bytes of all frames as they are read.
    shown, refocused
        Numbers of samples that are judged and written, and that are refocused.
    has_truth
        Whether the result is compared with a true object.
    tests_bench
        Whether the verdict tests other benches.
    """
    on_object, at_exit = engine.scene.object_grid.size, engine.scene.exit_grid.size
    truth = movable(COMPLEX64 * on_object * has_truth)
    inputs = _inputs(engine, recorded) + truth
    reading = in_memory(
        frames_bytes + max(inputs.most_bytes, (READ_BYTES if has_truth else LIGHT_BYTES) * on_object)
    )
    if settings.method == "object":
        iterating = truth + reconstruction_bytes(
            engine, recorded, kind=settings.kind, fill_factor=settings.fill_factor, modes=modes
        )
        state_bytes, found_bytes = 2 * _step_bytes(on_object, settings.kind), COMPLEX64 * on_object
        testing_bytes = _bench_test_bytes(engine, len(recorded), settings.kind) if tests_bench else 0
    else:
        iterating = truth + paper_bytes(engine, recorded)
        state_bytes, found_bytes = 2 * COMPLEX64 * at_exit, COMPLEX64 * (at_exit + shown)
        testing_bytes = 0
    # A new checkpoint is written before the old one is deleted.
    iterating += MemoryNeed(0, 0, 2 * state_bytes)
    held = inputs + in_memory(found_bytes + FLOAT32 * len(recorded) * at_exit)
    drawing = in_memory(PICTURE_BYTES + SCREEN_BYTES * min(shown, SCREEN) + DRAWN_BYTES * max(shown, at_exit))
    compared = shown * has_truth
    comparing = movable(MOVABLE_COMPARED_BYTES * compared) + in_memory(COMPARED_BYTES * compared)
    refocusing = in_memory(max(SHARPNESS_BYTES * min(refocused, MOST_JUDGED**2), REFOCUSED_BYTES * refocused))
    results = held + (in_memory(testing_bytes) | comparing | refocusing | drawing)
    return in_memory(BASE_BYTES) + (reading | iterating | results)


def _bench_test_bytes(engine: Engine, planes: int, kind: Kind) -> int:
    """Return the memory of the score test of the bench, with a second engine of another wavelength."""
    if isinstance(engine, Tiled):  # it is not tested
        return 0
    # Parameters, and samples at the two bounds of an object. Seven arrays for each on the pixels, and four on
    # the object, exist while the object is eliminated.
    scene, columns = engine.scene, 4 + 3 * planes + 2
    on_pixels = 7 * FLOAT32 * planes * scene.exit_grid.size
    effects = columns * (on_pixels + 4 * _step_bytes(scene.object_grid.size, kind))
    return 2 * engine.cost().peak_bytes_in_single + effects


def paper_bytes(engine: Engine, recorded: Sequence[Measurement]) -> MemoryNeed:
    """Return the memory of the initial field and the iterations of Appendix A, with their inputs."""
    grid = engine.scene.exit_grid
    through_lens = engine.cost().peak_bytes_in_single + 2 * COMPLEX64 * grid.size
    raised = movable(FLOAT32 * len(recorded) * grid.size)
    working = max(through_lens, retrieval_bytes(grid.shape, len(recorded)))
    return _inputs(engine, recorded) + raised + in_memory(working)


def _inputs(engine: Engine, recorded: Sequence[Measurement]) -> MemoryNeed:
    """Return the memory of illumination and measured arrays."""
    arrays = [array for plane in recorded for array in (plane.amplitude, plane.sigma, plane.background)]
    measured = sum(array.nbytes for array in arrays if array is not None)
    return movable(COMPLEX64 * engine.scene.object_grid.size + measured)


def _step_bytes(on_object: int, kind: Kind) -> int:
    """Return the size of an iterate of the object."""
    return on_object * (FLOAT32 if kind == "amplitude" else COMPLEX64)
