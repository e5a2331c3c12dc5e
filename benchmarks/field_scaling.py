"""How time and memory of the whole field grow with field, aperture and sensor, and what 10 mm would take.

    python -m benchmarks.field_scaling [-o CHART.png]

Every point is a process of its own, so that its memory is its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.full_field import field_scene, noise
from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design
from wavesim import Field, engine_for
from wavesim.engines.eikonal import executors
from wavesim.engines.eikonal.engine import HierarchicalTiles
from wavesim.engines.eikonal.super_tiles import propagate_tiles
from wavesim.fields.field import Grid
from wavesim.runtime.threads import THREADS

FIELDS_MM = (0.25, 0.5, 1.0, 2.0, 3.0)
APERTURES = (0.2, 0.3, 0.4, 0.5)
SIDES = (1750, 3500, 5250, 7000)
STANDARD = {"field_mm": 1.0, "aperture": 0.5, "side": 7000}
"""What the other two keep to where one varies."""

LARGE_MM = 10.0
WORKERS = (1, 4, 16, 64)
LINK_GB_PER_S = 1.0
"""Of a network of 10 Gbit/s."""

COLOURS = {"forward": "#2166ac", "adjoint": "#b2182b", "memory": "#4d4d4d"}


def main() -> None:
    """Measure, fit, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="chart (PNG)")
    parser.add_argument("--point", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.point:
        print(json.dumps(measured(**json.loads(given.point))))
        return
    sweeps = {
        "field_mm": [own_process(STANDARD | {"field_mm": value}) for value in FIELDS_MM],
        "aperture": [own_process(STANDARD | {"aperture": value}) for value in APERTURES],
        "side": [own_process(STANDARD | {"side": value}) for value in SIDES],
    }
    rows = []
    for name, points in sweeps.items():
        for figure in ("forward", "adjoint", "bytes"):
            said = f"exponent of {figure} over {name}"
            rows.append(Row(said, exponent([p[name] for p in points], [p[figure] for p in points])))
    print_table("Exponents", rows)
    print_table(f"A field of {LARGE_MM:g} mm, forward", large_field(sweeps["field_mm"]))
    if given.output:
        chart(sweeps, given.output)


def own_process(point: dict[str, float]) -> dict[str, Any]:
    """What `measured` returns, from a new process."""
    command = [sys.executable, "-m", "benchmarks.field_scaling", "--point", json.dumps(point)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = point | json.loads(done.stdout)
    print(
        f"field {found['field_mm']:g} mm, NA {found['aperture']:g}, {found['side']}^2 pixels: "
        f"forward {found['forward']:.3g} s ({found['carrying']:.3g} s for super-tiles, "
        f"{found['adding']:.3g} s for adding them), "
        f"adjoint {found['adjoint']:.3g} s, {1e-9 * found['bytes']:.3g} GB",
        flush=True,
    )
    return found


def timed(work: Callable[..., Any], seconds: list[float]) -> Callable[..., Any]:
    """Return the function, which also appends its duration to `seconds`."""

    def run(*arguments: Any) -> Any:
        started = time.perf_counter()
        result = work(*arguments)
        seconds.append(time.perf_counter() - started)
        return result

    return run


def measured(field_mm: float, aperture: float, side: int) -> dict[str, float]:
    """Seconds forward and back, of it what super-tiles and adding them take, and the process's memory."""
    lens = load_design(DESIGNS / "paper_singlet.toml")
    lens = lens.replaced(object=lens.object.replaced(numerical_aperture=aperture))
    scene = field_scene(lens, field_mm, side)
    rng = np.random.default_rng(1)
    engine = engine_for(scene, "hierarchical")
    assert isinstance(engine, HierarchicalTiles)
    started = time.perf_counter()
    groups = len(engine.groups)
    setup = time.perf_counter() - started
    seconds, carrying = [], list[float]()
    executors.propagate_tiles = timed(propagate_tiles, carrying)
    ways = (engine.forward, scene.object_grid), (engine.adjoint, scene.exit_grid)
    for carried, grid in ways:
        warm_up(engine, grid)
        values = Field(grid, noise(rng, grid), scene.wavelength_um)
        started = time.perf_counter()
        carried(values)
        seconds.append(time.perf_counter() - started)
    return {
        "forward": seconds[0],
        "adjoint": seconds[1],
        "carrying": sum(carrying[:groups]),
        "adding": seconds[0] - sum(carrying[:groups]),
        "setup": setup,
        "groups": groups,
        "sums_bytes": engine.sums_bytes,
        "bytes": 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }


def warm_up(engine: HierarchicalTiles, grid: Grid) -> None:
    """Have loops compiled, or loaded."""
    group = engine.groups[0]
    if grid == engine.scene.object_grid:
        propagate_tiles("forward", group, np.ones(group.shape_of("adjoint"), np.complex64), THREADS)
    else:
        propagate_tiles("adjoint", group, np.ones(group.shape, np.complex64), THREADS)


def exponent(sizes: Sequence[float], figures: Sequence[float]) -> float:
    """Of the power law that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(figures), 1)[0])


def large_field(points: Sequence[dict[str, Any]]) -> list[Row]:
    """Seconds and memory of a larger field at the same aperture and sensor, from the last points on."""
    last, grow = points[-1], LARGE_MM / points[-1]["field_mm"]

    def then(figures: Sequence[float]) -> float:
        power = exponent([p["field_mm"] for p in points[-3:]], figures[-3:])
        return float(figures[-1] * grow**power)

    carrying, adding = (then([p[name] for p in points]) for name in ("carrying", "adding"))
    rest = then([p["forward"] - p["carrying"] - p["adding"] for p in points])
    sums_bytes = last["sums_bytes"] * grow**2
    object_bytes, plane_bytes = (8.0 * side**2 for side in (LARGE_MM / last["field_mm"] * 7056, last["side"]))
    rows = [
        Row("here", (carrying + adding + rest + last["setup"]) / 60.0, "min"),
        Row("  of it super-tiles' own work", carrying / 60.0, "min"),
        Row("  adding them up", adding / 60.0, "min"),
        Row("  fields of super-tiles", 1e-9 * sums_bytes, "GB"),
        Row("  the object itself", 1e-9 * object_bytes, "GB"),
    ]
    for workers in WORKERS:
        link = max(sums_bytes / workers, object_bytes + plane_bytes) / (1e9 * LINK_GB_PER_S)
        seconds = last["setup"] + rest + max((carrying + adding) / workers, link)
        rows.append(Row(f"with {workers} workers like this machine, 10 Gbit/s", seconds / 60.0, "min"))
    return rows


def chart(sweeps: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Seconds above, gigabytes below, over each of the three."""
    from matplotlib.figure import Figure

    labels = {
        "field_mm": "field diameter (mm)",
        "aperture": "numerical aperture",
        "side": "pixels along a side",
    }
    figure = Figure(figsize=(12.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 3, sharey="row", sharex="col", height_ratios=(3, 2))
    for column, (name, points) in enumerate(sweeps.items()):
        x = [p[name] for p in points]
        above, below = axes[:, column]
        for figure_name in ("forward", "adjoint"):
            y = [p[figure_name] for p in points]
            said = f"{figure_name}, exponent {exponent(x, y):.2f}"
            above.plot(x, y, "o-", color=COLOURS[figure_name], lw=1.8, ms=5, label=said)
        below.plot(x, [1e-9 * p["bytes"] for p in points], "s-", color=COLOURS["memory"], lw=1.8, ms=5)
        below.set(xlabel=labels[name], xscale="log", ylim=(0.0, None), xticks=x)
        below.set_xticks(x, [f"{value:g}" for value in x])
        below.minorticks_off()
        above.set(yscale="log")
        above.legend(frameon=False, fontsize=9)
        for place in (above, below):
            place.grid(alpha=0.3)
            place.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set(ylabel="seconds, two cores")
    axes[1, 0].set(ylabel="most memory (GB)")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
