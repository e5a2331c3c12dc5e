"""Sequential tracing of real rays through a lens, or through many perturbed copies of it at once."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.plane_plate import PlanePlate
from lensdesign.raytrace.status import Status

RAYS_PER_THREAD = 16384
"""With fewer rays a second thread costs more than it saves."""


@dataclass(frozen=True)
class RayTrace:
    """Result of the trace of a bundle of rays.

    With poses or perturbations of many trials, every array has a leading trial axis.

    Attributes
    ----------
    position, direction : ndarray, shape (n, 3)
        Final positions in mm and direction cosines of the rays, in the fixed frame of :func:`trace`. A failed
        ray has the last position that it reached.
    opl : ndarray, shape (n,)
        Optical path length in mm from the origin to `position`.
    status : ndarray of int8, shape (n,)
        :class:`lensdesign.raytrace.status.Status` of each ray; 0 means that it arrived.
    failed_surface : ndarray of int16, shape (n,)
        Index of the surface at which a ray failed; -1 if it did not fail; the number of surfaces if it
        could not reach the final plane.
    hits : ndarray, shape (n, surfaces, 3), or None
        Points on each surface in mm; None unless `record_hits` was set.

    Examples
    --------
    >>> import numpy as np
    >>> from lensdesign import launch, load_design, trace
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> origins, directions = launch(lens, [(0.0, 1.5)], [(0.0, -1.0), (0.0, 0.0), (0.0, 1.0)], 0.532)
    >>> rays = trace(lens, origins, directions, 0.532)
    >>> rays.throughput, np.degrees(np.arccos(rays.direction[:, 2])).round(2).tolist()
    (1.0, [3.16, 4.59, 4.8])
    """

    position: Array
    direction: Array
    opl: Array
    status: NDArray[np.int8]
    failed_surface: NDArray[np.int16]
    hits: Array | None = None

    @property
    def ok(self) -> NDArray[np.bool_]:
        """True if each ray arrived."""
        return self.status == Status.OK

    def selected(self, chosen: slice | NDArray[np.bool_]) -> RayTrace:
        """Return some rays of a single lens."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: v[chosen] for name, v in values.items() if v is not None})

    @property
    def throughput(self) -> float:
        """Fraction of the rays that arrived (0 to 1)."""
        return float(np.mean(self.ok))


def trace(
    lens: Lens,
    origins: ArrayLike,
    directions: ArrayLike,
    wavelength_um: float,
    pose: Pose = Pose(),
    plane_z_mm: float | None = None,
    *,
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
    clip: bool = True,
    record_hits: bool = False,
    threads: int | None = None,
    out: RayTrace | None = None,
) -> RayTrace:
    """Trace rays through the lens to a plane.

    Parameters
    ----------
    lens
        The nominal lens.
    origins, directions
        Origins in mm and direction cosines, shape (n, 3), or (trials, n, 3) for different rays in each
        trial. They are in the fixed frame, whose origin is the nominal front vertex.
    wavelength_um
        Vacuum wavelength.
    pose
        Pose of the whole lens (default: nominal). The rays and the final plane do not move with it.
    plane_z_mm
        z of the plane on which the rays end, in the fixed frame (default: the rays end on the last surface).
        Rays to a plane pass the cover glass of the sensor, if there is one, as if it stood in front of this
        plane.
    surface_perturbations
        Perturbations of single surfaces by index from 0 (default: none).
    clip
        Whether clear semi-diameters stop rays.
    record_hits
        Whether to return the points on each surface.
    threads
        Number of threads (default: the number of processors, if there are enough rays).
    out
        An earlier result of the same shape, which is overwritten and returned (default: new arrays). With
        many rays, the allocation of new memory takes longer than the trace.

    Returns
    -------
    RayTrace
        Final positions and directions, optical path lengths and status of the rays.

    Raises
    ------
    InputError
        If shapes do not match, `out` is not contiguous, or a direction is not a finite unit vector.

    Examples
    --------
    >>> from lensdesign import Pose, load_design, trace
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> axial_ray = [(0.0, 0.0, -13.5)], [(0.0, 0.0, 1.0)]
    >>> rays = trace(lens, *axial_ray, 0.532, Pose(decenter_y_mm=0.1), plane_z_mm=lens.sensor_z_mm[0])
    >>> rays.position[:, 1].round(4).tolist()
    [0.0183]
    """
    system = compile_system(lens, wavelength_um, pose, surface_perturbations)
    return trace_compiled(
        system, origins, directions, plane_z_mm, clip=clip, record_hits=record_hits, threads=threads, out=out
    )


def trace_compiled(
    system: CompiledSystem,
    origins: ArrayLike,
    directions: ArrayLike,
    plane_z_mm: float | None = None,
    *,
    clip: bool = True,
    record_hits: bool = False,
    threads: int | None = None,
    out: RayTrace | None = None,
) -> RayTrace:
    """Trace rays through a compiled system to a plane; see :func:`trace`."""
    start, heading = _rays(origins, "origins"), _rays(directions, "directions")
    if start.shape[1] == 1 < heading.shape[1]:
        start = np.ascontiguousarray(np.broadcast_to(start, (start.shape[0], heading.shape[1], 3)))
    if start.shape[1] != heading.shape[1]:
        raise InputError(
            f"{start.shape[1]} origins and {heading.shape[1]} directions: their numbers must be equal"
        )
    counts = {c for c in (system.trials, len(start), len(heading)) if c not in (None, 1)}
    if len(counts) > 1:
        raise InputError(f"origins, directions and poses have different numbers of trials: {sorted(counts)}")
    trials: tuple[int, ...] = (next(iter(counts), 1),)
    if system.trials is None and np.ndim(origins) < 3 and np.ndim(directions) < 3:
        trials = ()
    result = _results((*trials, start.shape[1]), system.surfaces, record_hits, out)
    _run(system, start, heading, plane_z_mm, clip, result, threads)
    if plane_z_mm is not None and system.cover_glass is not None:
        _pass_plate(system.cover_glass, result)
    return result


def _pass_plate(plate: PlanePlate, rays: RayTrace) -> None:
    """Change the positions and paths of rays in air to those behind a plate, in place."""
    cosines, arrived = rays.direction[..., :2], rays.ok
    cosines = np.where(arrived[..., None], cosines, 0.0)
    rays.position[..., :2] += np.where(arrived[..., None], plate.lateral_shift_mm(cosines), 0.0)
    rays.opl[...] += np.where(arrived, plate.added_path_mm(cosines), 0.0)


def _rays(values: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(values, dtype=float)
    if array.ndim not in (2, 3) or array.shape[-1] != 3:
        raise InputError(f"{name} has shape {array.shape}: must be (rays, 3) or (trials, rays, 3)")
    return array if array.ndim == 3 else array[None]


def _results(shape: tuple[int, ...], surfaces: int, record_hits: bool, out: RayTrace | None) -> RayTrace:
    """Return the arrays to fill: those of an earlier result, or new ones."""
    if out is None:
        return RayTrace(
            np.empty((*shape, 3)),
            np.empty((*shape, 3)),
            np.empty(shape),
            np.empty(shape, np.int8),
            np.empty(shape, np.int16),
            np.empty((*shape, surfaces, 3)) if record_hits else None,
        )
    if out.status.shape != shape:
        raise InputError(f"out has rays of shape {out.status.shape}: must be {shape}")
    if record_hits != (out.hits is not None) or (out.hits is not None and out.hits.shape[-2] != surfaces):
        raise InputError(
            "out was made with another record_hits or number of surfaces; use the result of a trace without "
            "out, then reuse it"
        )
    if not all(a.flags.c_contiguous for a in vars(out).values() if a is not None):
        raise InputError(
            "out has arrays that are not contiguous; use the result of a trace without out, then reuse it"
        )
    return out


def _run(
    system: CompiledSystem,
    origins: Array,
    directions: Array,
    plane_z_mm: float | None,
    clip: bool,
    result: RayTrace,
    threads: int | None,
) -> None:
    from lensdesign.raytrace.kernel import trace_kernel

    trials, rays = result.status.shape if result.status.ndim == 2 else (1, len(result.status))
    vectors, scalars = (trials, 3 * rays), (trials, rays)
    filled = [
        result.position.reshape(vectors),
        result.direction.reshape(vectors),
        result.opl.reshape(scalars),
        result.status.reshape(scalars),
        result.failed_surface.reshape(scalars),
        np.empty((trials, 0, system.surfaces, 3))
        if result.hits is None
        else result.hits.reshape(trials, rays, system.surfaces, 3),
    ]
    launched, heading = (a.reshape(len(a), 3 * rays) for a in (origins, directions))
    codes, formulas, starts, terms, figures = system.for_kernel

    def trace_block(block: tuple[slice, slice]) -> int:
        t, r = block

        def own(array: Array) -> Array:
            return array[t] if len(array) > 1 else array

        return trace_kernel(
            own(launched),
            own(heading),
            own(system.rotation),
            own(system.vertex),
            codes,
            formulas,
            own(starts),
            own(terms),
            figures,
            t.start or 0,
            own(system.index),
            system.semi_diameter,
            system.tilted,
            0.0 if plane_z_mm is None else float(plane_z_mm),
            plane_z_mm is not None,
            clip,
            *(a[t] for a in filled),
            r.start,
            r.stop,
        )

    blocks = _blocks(trials, rays, threads)
    if len(blocks) == 1:
        invalid = trace_block(blocks[0])
    else:
        with ThreadPoolExecutor(len(blocks)) as pool:
            invalid = sum(pool.map(trace_block, blocks))
    if invalid:
        raise InputError(
            f"{invalid} rays have an origin that is not finite or a direction that is not a finite unit "
            "vector"
        )


def _blocks(trials: int, rays: int, threads: int | None) -> list[tuple[slice, slice]]:
    """Return slices of trials and rays, one for each thread, cut along the longer axis."""
    if threads is None:
        threads = max(1, trials * rays // RAYS_PER_THREAD)
        threads = min(threads, len(os.sched_getaffinity(0))) if threads > 1 else 1
    if threads < 1:
        raise InputError(f"threads = {threads}: must be at least 1")
    if threads == 1:
        return [(slice(None), slice(0, rays))]
    length = max(trials, rays)
    cuts = np.linspace(0, length, min(threads, max(1, length)) + 1).astype(int)
    slices = [slice(int(a), int(b)) for a, b in pairwise(cuts)]
    if trials >= rays:
        return [(s, slice(0, rays)) for s in slices]
    return [(slice(None), s) for s in slices]
