"""What the tests of every engine measure: the adjoint and memory."""

import tracemalloc
from collections.abc import Callable

import numpy as np

from wavesim.fields.field import Field
from wavesim.scene.engine import Engine


def dot_product_mismatch(engine: Engine, seed: int = 5) -> float:
    """Relative difference of <v, A u> and <A* v, u>, for random fields u and v."""
    rng, scene = np.random.default_rng(seed), engine.scene
    start, end = scene.object_grid, scene.exit_grid
    u, v = (
        Field(g, rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape), scene.wavelength_um)
        for g in (start, end)
    )
    there = end.cell * np.vdot(v.values, engine.forward(u).values)
    back = start.cell * np.vdot(engine.adjoint(v).values, u.values)
    return float(abs(there - back) / abs(there))


def engine_peak_bytes(engine: Engine, field: Field, way: str = "forward") -> int:
    """Most memory at one time in the first use of an engine.

    Another engine runs before, because loops that have to be compiled take memory too.
    """
    getattr(type(engine)(engine.scene, **engine.settings()), way)(field)
    return peak_bytes(lambda: getattr(engine, way)(field))


def peak_bytes(run: Callable[[], object]) -> int:
    """Most memory at one time, as NumPy and Python tell it."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
