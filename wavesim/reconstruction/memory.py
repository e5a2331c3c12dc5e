"""What memory a reconstruction takes, told before it runs: the iterations alone, and a whole run."""

from __future__ import annotations

from collections.abc import Sequence

from wavesim.objects.patch import LIGHT_BYTES
from wavesim.reconstruction.from_field import retrieval_bytes
from wavesim.reconstruction.from_object import Kind
from wavesim.reconstruction.refocusing import MOST_JUDGED
from wavesim.runtime.memory import BASE_BYTES, COMPLEX64, FLOAT32, Need, fixed, in_files, movable
from wavesim.scene.engine import Engine

LIT_BYTES = 1
"""For each sample of the object: whether there is light."""

READ_BYTES = 24
"""For each sample of the object, while a true object is read. Measured."""

REFOCUSED_BYTES, CARRIED_BYTES, JUDGED_BYTES, DRAWN_BYTES = 330, 85, 30, 30
"""For each sample whose sharpness is asked for, that is carried along the axis with these, compared with the
truth, and drawn. Measured."""

PLANE_BYTES = 20
"""For each pixel, while residuals of a plane are drawn. Measured."""


def reconstruction_bytes(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    kind: Kind = "complex",
    active_width: float = 0.0,
    with_sigma: bool = True,
) -> Need:
    """Memory that :func:`wavesim.reconstruct` takes in complex64, beside Python and libraries (some 0.3 GB).

    Parameters
    ----------
    engine
        As of :func:`wavesim.reconstruct`.
    distances_mm
        Of the recorded planes, from the engine's exit grid.
    kind, active_width
        As of :func:`wavesim.reconstruct`.
    with_sigma
        Whether recorded amplitudes come with standard deviations.

    Returns
    -------
    Need
        Illumination, recorded arrays and last steps are those that can lie in files.
    """
    scene, planes = engine.scene, len(distances_mm)
    source, behind = COMPLEX64 * scene.object_grid.size, COMPLEX64 * scene.exit_grid.size
    step = source // 2 if kind == "amplitude" else source
    far = sum(distance != 0.0 for distance in distances_mm)
    kept = movable(source) + movable(2 * step) + movable(planes * behind * (1.0 if with_sigma else 0.5))
    kept += fixed(LIT_BYTES * scene.object_grid.size) + fixed(0.25 * far * behind)
    carrying = fixed(engine.cost().peak_bytes + source + behind)
    replacing = fixed(behind * _fields_of_a_plane(planes, far, active_width))
    smoothing = fixed(4.0 * step)
    return kept + (carrying | replacing | smoothing)


def _fields_of_a_plane(planes: int, far: int, active_width: float) -> float:
    """Fields of the exit grid's size at one time while they take the amplitudes recorded.

    Pixels that integrate: the spectrum, twice as many rows of the field and their intensity, and what planes
    before have changed. At points: the field, its spectrum, what is changed of each, and the field on a plane
    with its intensity.
    """
    if active_width > 0.0:
        return 4.5 + (planes > 1)
    if far == 0:
        return 3.5
    return 4.5 + (planes > 2)


def run_need(
    engine: Engine,
    distances_mm: Sequence[float],
    *,
    method: str,
    kind: Kind,
    active_width: float,
    frames_bytes: int,
    shown: int,
    carried: int,
    truth: bool,
) -> Need:
    """Memory that the command `wavesim reconstruct` takes, from reading its frames to writing its results.

    Parameters
    ----------
    engine, distances_mm, kind, active_width
        As of :func:`reconstruction_bytes`; amplitudes are of float32 and come with standard deviations.
    method
        "object" or "paper".
    frames_bytes
        Of all frames as they are read.
    shown
        Samples of the object that are judged and written.
    carried
        Samples that are carried along the axis for refocusing; 0 without it.
    truth
        Whether a true object is compared.
    """
    planes, source, behind = len(distances_mm), engine.scene.object_grid.size, engine.scene.exit_grid.size
    true = movable(COMPLEX64 * source if truth else 0)
    given = movable(COMPLEX64 * source) + movable(planes * COMPLEX64 * behind) + true
    frames = fixed(frames_bytes)
    lit, read = fixed(LIGHT_BYTES * source), fixed((COMPLEX64 + READ_BYTES) * source if truth else 0)
    reading = frames + (lit | read)
    if method == "object":
        iterating = reconstruction_bytes(engine, distances_mm, kind=kind, active_width=active_width)
        kept, found = COMPLEX64 * source * (1 if kind == "amplitude" else 2), COMPLEX64 * source
    else:
        iterating = _retrieving(engine, distances_mm)
        kept, found = 2 * COMPLEX64 * behind, COMPLEX64 * behind
    results = fixed(planes * FLOAT32 * behind) + fixed(found) + fixed(COMPLEX64 * shown)
    results += (
        fixed(engine.cost().peak_bytes + COMPLEX64 * (2 * shown + behind))
        | fixed(max(JUDGED_BYTES, DRAWN_BYTES) * shown)
        | fixed(REFOCUSED_BYTES * min(carried, MOST_JUDGED**2))
        | fixed(CARRIED_BYTES * carried)
        | fixed(PLANE_BYTES * behind)
    )
    passed = movable(3 * COMPLEX64 * shown if truth else 0)
    run = reading | frames + fixed(given.most_bytes) | iterating + true | results + given + passed
    # A new checkpoint is written before the earlier one goes.
    return fixed(BASE_BYTES) + run + in_files(2 * kept)


def _retrieving(engine: Engine, distances_mm: Sequence[float]) -> Need:
    """What Appendix A takes."""
    source, behind = engine.scene.object_grid.size, engine.scene.exit_grid.size
    starting = fixed(engine.cost().peak_bytes + 2 * COMPLEX64 * behind)
    passing = fixed(retrieval_bytes(engine.scene.exit_grid.shape, distances_mm))
    # Recorded amplitudes are there twice, as they were recorded and as Appendix A takes them.
    recorded = movable(len(distances_mm) * (COMPLEX64 + FLOAT32) * behind)
    return (starting | passing) + movable(COMPLEX64 * source) + recorded
