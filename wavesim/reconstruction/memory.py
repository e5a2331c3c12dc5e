"""Memory of a reconstruction: every array, and the phases in which it exists.

Each array is listed once, in the inventory of the step that creates it. The memory estimate follows from
these lists. A new array needs one more line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

import numpy as np

from wavesim.forward.bands import bytes_of_bands
from wavesim.reconstruction.appendix_a import bytes_at_work
from wavesim.reconstruction.refocusing import MOST_JUDGED
from wavesim.runtime import threads
from wavesim.runtime.inventory import ArrayGroup, Inventory, named, need_of, work
from wavesim.runtime.memory import BASE_BYTES, COMPLEX64, MemoryNeed
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.targets.patch import LIGHT_BYTES

TILTED_PLANES, TILTED_FIELDS = 6, 3
"""Usual largest number of parallel planes for the field on a tilted sensor, and of fields in that
computation.
"""

REFOCUSED_BYTES, CARRIED_BYTES, PSNR_BYTES, PRODUCT_BYTES, SIMILARITY_BYTES = 330, 85, 12, 64, 160
"""Measured bytes per sample for refocusing: of the measure of sharpness, and of a propagated field. Measured
bytes per sample for comparisons: of the PSNR and, in a block of rows, of the transmitted band and of the
structural similarity.
"""

PICTURE_BYTES, SCREEN_BYTES, SCREEN, DRAWN_BYTES, PLANE_BYTES = 60_000_000, 100, 4_000_000, 12, 9
"""Measured bytes for pictures: in total; per sample drawn by itself (at most `SCREEN` samples); per sample
of the object; per pixel of a plane.
"""


class Phase(Flag):
    """Phases of a run.

    An iteration propagates to the exit grid (LENS), computes intensities and the change of the field on each
    plane, takes the change back to the object (ADJOINT), smooths it, and makes an accelerated step. The
    first iteration computes the intensities twice to fit the scale. An iteration of Appendix A is one phase
    (RETRIEVING).
    """

    LIGHTING, READING, STORING = auto(), auto(), auto()
    DRAWING_NOISE = auto()
    STARTING = auto()
    MEASURING_NOISE = auto()
    LENS = auto()
    COMPUTING_INTENSITIES = auto()
    CHANGING_FIELD = auto()
    ADJOINT = auto()
    SMOOTHING = auto()
    STEPPING = auto()
    ACCELERATING = auto()
    RETRIEVING = auto()
    ENDING = auto()
    JUDGING = auto()
    COMPARING = auto()
    REFOCUSING = auto()
    PROPAGATING = auto()
    DRAWING = auto()


PREPARING = Phase.LIGHTING | Phase.READING | Phase.STORING
ON_PLANES = Phase.COMPUTING_INTENSITIES | Phase.CHANGING_FIELD
MODELLING = ON_PLANES | Phase.ENDING
STEPPING = Phase.STEPPING | Phase.ACCELERATING
ITERATING = Phase.LENS | ON_PLANES | Phase.ADJOINT | Phase.SMOOTHING | STEPPING
STARTING = Phase.STARTING | Phase.MEASURING_NOISE
DESCENDING = Phase.DRAWING_NOISE | STARTING | ITERATING | Phase.ENDING
RESULTS = Phase.JUDGING | Phase.COMPARING | Phase.REFOCUSING | Phase.PROPAGATING | Phase.DRAWING
AFTER_LOADING = DESCENDING | Phase.RETRIEVING | RESULTS


@dataclass(frozen=True)
class Sizes:
    """Shapes and numbers from which the sizes of all arrays follow.

    Attributes
    ----------
    object_shape, exit_shape : tuple of int
        Samples of the object grid, and of the exit grid.
    distances_mm : tuple of float
        Distances of the planes from the exit grid, in mm.
    engine_bytes : int
        Memory of the engine.
    dtype : numpy dtype
        Data type of fields.
    """

    object_shape: tuple[int, ...]
    exit_shape: tuple[int, ...]
    distances_mm: tuple[float, ...]
    engine_bytes: int = 0
    dtype: Any = np.complex64

    @classmethod
    def of(cls, engine: Engine, distances_mm: Sequence[float]) -> Sizes:
        """Return the sizes for an engine, in complex64."""
        scene, engine_bytes = engine.scene, engine.cost().peak_bytes_in_single
        return cls(scene.object_grid.shape, scene.exit_grid.shape, tuple(distances_mm), engine_bytes)

    @property
    def real(self) -> np.dtype[Any]:
        """Data type of amplitudes."""
        return np.zeros(0, self.dtype).real.dtype

    @property
    def plane_count(self) -> int:
        """Number of planes."""
        return len(self.distances_mm)

    @property
    def remote_planes(self) -> int:
        """Number of planes that are not on the exit grid itself."""
        return sum(distance != 0.0 for distance in self.distances_mm)

    @property
    def quadrant_shape(self) -> tuple[int, ...]:
        """Shape of a transfer function, which is stored for frequencies of the exit grid that are not
        negative.
        """
        return tuple(n // 2 + 1 for n in (1, *self.exit_shape)[-2:])


def given_arrays(
    sizes: Sizes, *, with_sigma: bool = True, backgrounds: int = 0, truth: bool = False
) -> Inventory:
    """Return the inputs of a reconstruction.

    `backgrounds` is the number of planes with a background; `truth` states whether there is a true object.
    """
    object_shape, exit_shape, during, with_sigma_count = (
        sizes.object_shape,
        sizes.exit_shape,
        AFTER_LOADING,
        sizes.plane_count * with_sigma,
    )
    return (
        ArrayGroup("the illumination", object_shape, sizes.dtype, during, lies="scratch"),
        ArrayGroup(
            "the recorded amplitudes", exit_shape, sizes.real, during, sizes.plane_count, lies="scratch"
        ),
        ArrayGroup(
            "the standard deviations", exit_shape, sizes.real, during, with_sigma_count, lies="scratch"
        ),
        ArrayGroup("the backgrounds", exit_shape, sizes.real, during, backgrounds, lies="scratch"),
        ArrayGroup("the true object", object_shape, sizes.dtype, during, int(truth), lies="scratch"),
    )


def step_array(
    sizes: Sizes, kind: Kind, during: Phase = ITERATING & ~Phase.COMPUTING_INTENSITIES, count: int = 2
) -> ArrayGroup:
    """Return the iterates of the solver for a kind of object: the last step and the extrapolated point."""
    dtype = sizes.real if kind == "amplitude" else sizes.dtype
    return ArrayGroup("a step", sizes.object_shape, dtype, during, count, lies="scratch")


def descent_arrays(
    sizes: Sizes, kind: Kind, fill_factor: float, modes: int = 1, tilted: bool = False
) -> Inventory:
    """Return the arrays of :func:`wavesim.reconstruct` besides its inputs.

    `kind` and `fill_factor` are those of that function, `modes` is the number of modes of an extended
    source, and `tilted` states whether the sensor is tilted.
    """
    object_shape, exit_shape, quadrant_shape, dtype, real = (
        sizes.object_shape,
        sizes.exit_shape,
        sizes.quadrant_shape,
        sizes.dtype,
        sizes.real,
    )
    step = step_array(sizes, kind)
    through_lens = Phase.STARTING | Phase.LENS | Phase.ADJOINT | Phase.ENDING
    common: Inventory = (
        ArrayGroup("the mask of lit samples", object_shape, bool, DESCENDING),
        ArrayGroup("transfer functions to planes", quadrant_shape, dtype, DESCENDING, sizes.remote_planes),
        work("the engine's work", sizes.engine_bytes, through_lens),
        ArrayGroup(
            "noise at the exit", exit_shape, dtype, Phase.DRAWING_NOISE, 1 + int(sizes.plane_count > 1)
        ),
        ArrayGroup(
            "a transfer function", quadrant_shape, dtype, Phase.DRAWING_NOISE, int(sizes.remote_planes > 0)
        ),
        ArrayGroup("the sum of noise at the exit", exit_shape, dtype, Phase.STARTING),
        ArrayGroup("noise in the object", object_shape, dtype, STARTING),
        step,
        step_array(sizes, kind, Phase.COMPUTING_INTENSITIES, 1),
        ArrayGroup("the field in the object", object_shape, dtype, Phase.LENS),
        ArrayGroup("the field at the exit", exit_shape, dtype, Phase.LENS),
        ArrayGroup("the change at the exit", exit_shape, dtype, Phase.ADJOINT),
        ArrayGroup("the change of the object", object_shape, dtype, Phase.ADJOINT),
        ArrayGroup(
            "the object, smoothed, as it was, and its flow", object_shape, step.dtype, Phase.SMOOTHING, 4
        ),
        ArrayGroup("the object, smoothed", object_shape, step.dtype, Phase.STEPPING),
        step_array(sizes, kind, Phase.STEPPING, 1),
        step_array(sizes, kind, Phase.ACCELERATING, 2),
        step_array(sizes, kind, Phase.ENDING, 1),
        ArrayGroup("residual maps", exit_shape, real, Phase.ENDING, sizes.plane_count),
    )
    if tilted:
        common += _tilt_arrays(sizes)
    if modes > 1:
        return common + _mode_arrays(sizes, modes)
    return common + (_pixel_arrays(sizes) if fill_factor > 0.0 else _point_arrays(sizes))


def _tilt_arrays(sizes: Sizes) -> Inventory:
    """Return arrays for a tilted sensor."""
    parallel_planes = TILTED_PLANES * sizes.plane_count
    return (
        ArrayGroup(
            "transfer functions to parallel planes",
            sizes.quadrant_shape,
            sizes.dtype,
            DESCENDING,
            parallel_planes,
        ),
        ArrayGroup("fields on parallel planes", sizes.exit_shape, sizes.dtype, MODELLING, TILTED_FIELDS),
    )


def _mode_arrays(sizes: Sizes, modes: int) -> Inventory:
    """Return arrays for planes in the light of several modes, with pixels that integrate."""
    exit_shape, dtype, real = sizes.exit_shape, sizes.dtype, sizes.real
    all_through = Phase.LENS | MODELLING | Phase.ADJOINT
    # Bytes per object sample while the light of one mode is computed in double precision.
    light_of_mode_bytes = 56
    return (
        ArrayGroup("spectra of modes at the exit", exit_shape, dtype, all_through, modes),
        ArrayGroup(
            "changes of modes by inner iterations", exit_shape, dtype, ON_PLANES | Phase.ADJOINT, modes
        ),
        ArrayGroup("means over pixels", exit_shape, real, all_through, sizes.plane_count),
        work(
            "light of a mode", light_of_mode_bytes * math.prod(sizes.object_shape), Phase.LENS | Phase.ADJOINT
        ),
        ArrayGroup("the change of the object so far", sizes.object_shape, dtype, ON_PLANES | Phase.ADJOINT),
        ArrayGroup("rows through pixels and their edges", exit_shape, dtype, MODELLING, 2),
        ArrayGroup(
            "means along rows, and over pixels",
            exit_shape,
            real,
            Phase.COMPUTING_INTENSITIES | Phase.ENDING,
            3,
        ),
        ArrayGroup("changes of planes", exit_shape, dtype, Phase.CHANGING_FIELD),
    )


def _pixel_arrays(sizes: Sizes) -> Inventory:
    """Return arrays for planes with pixels that integrate."""
    exit_shape, dtype, real = sizes.exit_shape, sizes.dtype, sizes.real
    return (
        ArrayGroup("the spectrum at the exit", exit_shape, dtype, MODELLING),
        ArrayGroup("rows through pixels and their edges", exit_shape, dtype, MODELLING, 2),
        ArrayGroup("means along rows", exit_shape, real, Phase.COMPUTING_INTENSITIES | Phase.ENDING, 2),
        ArrayGroup("means over pixels", exit_shape, real, Phase.COMPUTING_INTENSITIES),
        ArrayGroup("changes of earlier inner iterations", exit_shape, dtype, Phase.CHANGING_FIELD),
        ArrayGroup("changes of planes", exit_shape, dtype, Phase.CHANGING_FIELD),
        work("rows of bands, and beside them", bytes_of_bands(exit_shape, dtype), Phase.CHANGING_FIELD),
    )


def _point_arrays(sizes: Sizes) -> Inventory:
    """Return arrays for planes sampled at points."""
    exit_shape, dtype, real = sizes.exit_shape, sizes.dtype, sizes.real
    remote_planes, near_planes = sizes.remote_planes, sizes.plane_count - sizes.remote_planes
    changed_before = int(near_planes > 0 and sizes.plane_count > 1) + int(remote_planes > 1)
    return (
        ArrayGroup("the field at the exit, on planes", exit_shape, dtype, MODELLING),
        ArrayGroup("the spectrum at the exit", exit_shape, dtype, MODELLING, int(remote_planes > 0)),
        ArrayGroup("the field on a plane", exit_shape, dtype, MODELLING),
        ArrayGroup("squares of its parts", exit_shape, real, Phase.COMPUTING_INTENSITIES, 2),
        ArrayGroup("a square of its parts", exit_shape, real, Phase.ENDING),
        ArrayGroup(
            "a transfer function", sizes.quadrant_shape, dtype, Phase.CHANGING_FIELD, int(remote_planes > 0)
        ),
        ArrayGroup("changes of earlier inner iterations", exit_shape, dtype, Phase.CHANGING_FIELD),
        ArrayGroup("changes of earlier planes", exit_shape, dtype, Phase.CHANGING_FIELD, changed_before),
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
) -> MemoryNeed:
    """Return the memory of :func:`wavesim.reconstruct` in complex64.

    Python and libraries take some 0.3 GB more.

    Parameters
    ----------
    engine
        Engine from the object to the exit grid.
    distances_mm
        Distances of the planes from the engine's exit grid, in mm.
    kind, fill_factor
        See :func:`wavesim.reconstruct`.
    with_sigma
        Whether the measured amplitudes have standard deviations.
    modes
        Number of modes of the light of an extended source.
    tilted
        Whether the sensor is tilted.

    Returns
    -------
    MemoryNeed
        Bytes in memory and in files. Illumination, measured arrays and last steps can be stored in files.
    """
    sizes = Sizes.of(engine, distances_mm)
    working = descent_arrays(sizes, kind, fill_factor, modes, tilted)
    return need_of(given_arrays(sizes, with_sigma=with_sigma) + working)


def retrieval_arrays(sizes: Sizes, masked: bool = True) -> Inventory:
    """Return the arrays of :func:`wavesim.retrieve` besides its arguments; `masked`: some pixels are
    invalid.
    """
    exit_shape, dtype, passing = sizes.exit_shape, sizes.dtype, Phase.RETRIEVING
    plane = math.prod(exit_shape[:-1]), exit_shape[-1]
    return (
        ArrayGroup("the field sought, and the one before", exit_shape, dtype, passing, 2),
        ArrayGroup("the field on a plane", exit_shape, dtype, passing),
        ArrayGroup("transfer functions to planes", sizes.quadrant_shape, dtype, passing, sizes.remote_planes),
        ArrayGroup("pixels that are known", exit_shape, bool, passing, sizes.plane_count * masked),
        work("blocks of rows and columns", bytes_at_work(plane, dtype), passing),
    )


def retrieval_bytes(shape: tuple[int, ...], distances_mm: Sequence[float], masked: bool = True) -> int:
    """Return the largest memory of :func:`wavesim.retrieve` in single precision, besides its arguments, in
    bytes.

    Parameters
    ----------
    shape
        Shape of the grid.
    distances_mm
        Distances of the planes from the plane sought, in mm. A plane at 0 needs no transforms.
    masked
        Whether planes have invalid pixels.

    Examples
    --------
    >>> from wavesim.reconstruction import retrieval_bytes
    >>> retrieval_bytes((256, 256), (0.0, 2.0)) > 2 * 8 * 256**2
    True
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
    """Return the arrays of the command `wavesim reconstruct`, from reading frames to writing results.

    Parameters
    ----------
    engine, distances_mm, kind, fill_factor
        See :func:`reconstruction_bytes`; amplitudes are float32 and have standard deviations.
    method
        "object" or "paper".
    frames_bytes
        Bytes of all frames as they are read.
    shown
        Shape of the part of the object that is judged and written.
    carried
        Number of samples that are propagated for refocusing; 0 without refocusing.
    truth
        Whether the result is compared with a true object.
    backgrounds
        Number of planes with a background.
    modes, tilted
        See :func:`reconstruction_bytes`.
    """
    sizes, of_object = Sizes.of(engine, distances_mm), method == "object"
    working = descent_arrays(sizes, kind, fill_factor, modes, tilted) if of_object else _paper_arrays(sizes)
    given = given_arrays(sizes, truth=truth, backgrounds=backgrounds)
    object_shape = math.prod(sizes.object_shape)
    # Measured bytes per object sample while a true object is read.
    read_bytes = 24
    preparation = (
        work("the process itself", BASE_BYTES, PREPARING | AFTER_LOADING),
        work("the frames", frames_bytes, PREPARING),
        work("light, as it is made", LIGHT_BYTES * object_shape, Phase.LIGHTING),
        work(
            "the true object, as it is read", truth * (COMPLEX64 + read_bytes) * object_shape, Phase.READING
        ),
        work("all inputs, as read", sum(group.bytes_of_all for group in given), Phase.STORING),
    )
    # A new checkpoint is written before the old one is deleted.
    passing = ("the field sought, and the one before", Phase.RETRIEVING)
    state, saving = ("a step", ITERATING) if of_object else passing
    files = (
        ArrayGroup("checkpoints", (named(working, state).bytes_of_all,), np.uint8, saving, 2, lies="file"),
    )
    return preparation + given + working + files + _results(sizes, method, shown, carried, truth)


def _paper_arrays(sizes: Sizes) -> Inventory:
    """Return the arrays of Appendix A, with its initial field."""
    prepared = Phase.LENS | Phase.RETRIEVING
    return (
        work("the engine's work", sizes.engine_bytes, Phase.LENS),
        ArrayGroup("the field at the exit", sizes.exit_shape, sizes.dtype, Phase.LENS, 2),
        ArrayGroup(
            "amplitudes above the noise",
            sizes.exit_shape,
            sizes.real,
            prepared,
            sizes.plane_count,
            lies="scratch",
        ),
        *retrieval_arrays(sizes),
    )


def _results(sizes: Sizes, method: str, shown: tuple[int, ...], carried: int, truth: bool) -> Inventory:
    """Return the arrays after the last iteration; for the arguments see :func:`run_arrays`."""
    dtype, samples, of_object = sizes.dtype, math.prod(shown), method == "object"
    block, exit_shape = samples // shown[0] * min(shown[0], threads.BLOCK), math.prod(sizes.exit_shape)
    judging_bytes = max(2 * COMPLEX64 * samples, COMPLEX64 * samples + PRODUCT_BYTES * block)
    comparing_bytes = COMPLEX64 * samples + max(PSNR_BYTES * samples, SIMILARITY_BYTES * block)
    drawing_bytes = (
        PICTURE_BYTES
        + SCREEN_BYTES * min(samples, SCREEN)
        + max(DRAWN_BYTES * samples, PLANE_BYTES * exit_shape)
    )
    return (
        ArrayGroup("maps of residuals", sizes.exit_shape, sizes.real, RESULTS, sizes.plane_count),
        ArrayGroup("the result", sizes.object_shape if of_object else sizes.exit_shape, dtype, RESULTS),
        ArrayGroup("the part that is shown", shown, dtype, RESULTS, int(carried > 0 or not of_object)),
        ArrayGroup("a field within the lens's band", shown, dtype, Phase.JUDGING, 2 * truth, lies="scratch"),
        work("fields and their parts within the lens's band", truth * judging_bytes, Phase.JUDGING),
        work("a comparison", truth * comparing_bytes, Phase.COMPARING),
        work("sharpness", REFOCUSED_BYTES * min(carried, MOST_JUDGED**2), Phase.REFOCUSING),
        work("fields propagated for refocusing", CARRIED_BYTES * carried, Phase.PROPAGATING),
        work("pictures", drawing_bytes, Phase.DRAWING),
    )
