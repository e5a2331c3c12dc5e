"""A field of 5 mm at NA 0.5: the paper's lens at five thirds of its size, here and on two Dask workers.

    python -m benchmarks.large_field

Rays and angles are those of the paper's lens; the sensor is as wide as the light, 11,700 pixels of 3.2 um.
Smaller fields of the same lens tell how time grows with the field's area.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from benchmarks.full_field import dot_product_mismatch, field_scene, growth, noisy_fields
from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import Field, engine_for
from wavesim.engines.eikonal.engine import HierarchicalTiles
from wavesim.engines.eikonal.on_cluster import tiles_in
from wavesim.scene.engine import Engine

FIELD_MM, PAPER_MM, SIDE = 5.0, 3.0, 11_700
SMALLER_MM, COMPILED_MM = (1.25, 2.5), 0.3
"""Fields of the same lens; one that compiles the loops, if they are not kept."""

WORKERS = 2
MEMORY = {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}
"""Has workers keep memory for their next task, which Dask has them give back after every array."""

MOST_GB, MISMATCH, MOST_EXPONENT = 12.0, 1e-6, 1.0


def main() -> None:
    """Measure and print."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), FIELD_MM / PAPER_MM)
    scenes = [field_scene(lens, mm, SIDE) for mm in (COMPILED_MM, *SMALLER_MM)]
    times = [both_ways(engine_for(one, "hierarchical"), *noisy_fields(one))[1] for one in scenes][1:]
    scene = field_scene(lens, FIELD_MM, SIDE)
    field, other = noisy_fields(scene)
    (there, back), seconds = both_ways(engine_for(scene, "hierarchical"), field, other)
    times.append(seconds)
    peak_gb = 1.024e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    mismatch = dot_product_mismatch(field, there, other, back)
    del back
    fields_mm = (*SMALLER_MM, FIELD_MM)
    rows = [
        *(
            Row(f"{way}, field of {mm:g} mm", taken, "s")
            for mm, both in zip(fields_mm, times, strict=True)
            for way, taken in zip(("forward", "adjoint"), both, strict=True)
        ),
        *growth(fields_mm, times, MOST_EXPONENT),
        Row("most memory of the process", peak_gb, "GB", at_most=MOST_GB),
        Row("dot-product test, of the sizes", mismatch, at_most=MISMATCH),
    ]
    with workers() as address, tiles_in(address) as take:
        engine = take(engine_for(scene, "hierarchical"))
        assert isinstance(engine, HierarchicalTiles)
        engine.cost()
        started = time.perf_counter()
        engine.adjoint_on(other, range(WORKERS))
        ready = time.perf_counter() - started
        again, seconds = both_ways(engine, field, other)
    off = float(np.linalg.norm(again[0] - there) / np.linalg.norm(there))
    rows += [
        Row(f"{WORKERS} Dask workers of one thread: ready, with one super-tile each", ready, "s"),
        Row("forward", seconds[0], "s"),
        Row("adjoint", seconds[1], "s"),
        Row("difference from the field made here", off, at_most=1e-5),
    ]
    print_table(f"A field of {FIELD_MM:g} mm, first sensor plane, {SIDE}^2 pixels, error 0.01", rows)


def both_ways(
    engine: Engine, field: Field, other: Field
) -> tuple[tuple[np.ndarray, np.ndarray], tuple[float, float]]:
    """Forward of one field and adjoint of another, and what they take; set-up is made before."""
    engine.cost()
    results, seconds = [], []
    for carry, start in ((engine.forward, field), (engine.adjoint, other)):
        started = time.perf_counter()
        results.append(carry(start).values)
        seconds.append(time.perf_counter() - started)
    return (results[0], results[1]), (seconds[0], seconds[1])


@contextmanager
def workers() -> Iterator[str]:
    """A Dask scheduler on this machine, with processes of one thread each."""
    from distributed import LocalCluster

    os.environ.update(MEMORY)
    with LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        host="127.0.0.1",
        memory_limit=0,
    ) as cluster:
        yield cluster.scheduler_address


if __name__ == "__main__":
    main()
