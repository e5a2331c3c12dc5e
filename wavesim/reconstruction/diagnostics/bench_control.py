"""Control of the score test: whether a search on the preferred bench lowers the misfit as it predicts.

The score test is linear, and assumes an object that the frames alone determine. The total variation and
iterations that end early hold an object back, and what they leave may resemble the effect of another bench.
Two short searches without total variation therefore continue from the object found: one on the assumed bench,
and one on a bench with a fraction e of the estimated errors. If frames prefer this bench, the squared misfit
of the second search is lower by (2 e - e^2) times the fall that the linear model predicts for the whole
errors. The measured part of it corrects the significance.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from wavesim.engines.registry import engine_on
from wavesim.fields.field import Field
from wavesim.reconstruction.diagnostics.score_test import MOUNTING
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.reconstruction.source_search import modes_on
from wavesim.scene.engine import Engine
from wavesim.scene.settings import Kind
from wavesim.scene.source import POINT, Source
from wavesim.sensor.measurement import Measurement

FRACTION, ITERATIONS = 0.5, 12
"""Fraction of the estimated errors for which a search is made, and iterations of each search."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A bench, as :func:`wavesim.reconstruct` takes it."""

    engine: Engine
    light: Field
    recorded: Sequence[Measurement]
    source: Source = POINT


def displaced_bench(bench: Bench, errors: Mapping[str, float]) -> Bench:
    """Return a bench with errors, by the names of :class:`ScoreTest.estimate`; others are 0.

    Raises
    ------
    TransferLensError
        If rays or samples do not allow it.
    """
    errors = defaultdict(float, errors)
    scene = bench.engine.scene
    grid, pose = scene.object_grid, scene.pose
    *of_lens, working_distance = MOUNTING
    moves = {name: getattr(pose, name) + errors[name] for name in of_lens}
    grid = grid.at(grid.z_mm - errors[working_distance])
    planes = [bench.recorded[0]]
    for number, plane in enumerate(bench.recorded[1:], start=2):
        x_um, y_um = (errors[f"plane_{number}_shift_{axis}_um"] for axis in "xy")
        distance_mm = errors[f"plane_distance_{number}_mm"]
        x_mm, y_mm = plane.shift_mm
        planes.append(
            replace(
                plane,
                shift_mm=(x_mm + 1e-3 * x_um, y_mm + 1e-3 * y_um),
                distance_mm=plane.distance_mm + distance_mm,
            )
        )
    return Bench(
        engine_on(bench.engine, replace(scene, object_grid=grid, pose=replace(pose, **moves))),
        replace(bench.light, grid=grid),
        planes,
        Source(errors["source_deg"], errors["bandwidth_nm"]),
    )


def measured_part(
    bench: Bench,
    transmission: Field,
    errors: Mapping[str, float],
    predicted_fall: float,
    *,
    kind: Kind,
    scale: float,
    fill_factor: float,
) -> float:
    """Return the fall of the squared misfit on another bench over the one that a linear model predicts.

    Parameters
    ----------
    bench
        The assumed bench, with the light of a coherent source.
    transmission
        The object found.
    errors
        Estimated errors of the bench, by name.
    predicted_fall
        Fall of the squared misfit that the linear model predicts for these errors.
    kind, scale, fill_factor
        See :func:`wavesim.reconstruct`.

    Returns
    -------
    float
        About 1 where frames prefer the other bench, and about 0 where other reasons resemble its effect.

    Raises
    ------
    TransferLensError
        If rays or samples do not allow the other bench.
    """
    part = {name: FRACTION * error for name, error in errors.items()}
    # The squared widths of a source change the amplitudes in proportion.
    part |= {name: FRACTION**0.5 * errors[name] for name in ("source_deg", "bandwidth_nm")}
    misfits = []
    for one in (bench, displaced_bench(bench, part)):
        found = reconstruct(
            one.engine,
            one.light,
            one.recorded,
            kind=kind,
            tv_weight=0.0,
            iterations=ITERATIONS,
            scale=scale,
            start=replace(transmission, grid=one.light.grid),
            fill_factor=fill_factor,
            modes=modes_on(one.light, one.source),
            residuals=False,
        )
        misfits.append(found.misfit)
    last = min(map(len, misfits)) - 1
    assumed, other = (misfit[last] for misfit in misfits)
    return (assumed**2 - other**2) / ((2.0 * FRACTION - FRACTION**2) * predicted_fall)
