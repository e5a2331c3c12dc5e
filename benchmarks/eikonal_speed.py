"""Eikonal tiles on whole planes, forward and back, in single precision."""

from __future__ import annotations

import resource
import time

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import Lens, load_design, scaled
from wavesim import Field, Grid, Scene, engine_for
from wavesim.scene.patches import OBJECT_FINENESS

RUNS = 7


def main() -> None:
    """Measure and print."""
    paper = load_design(DESIGNS / "paper_singlet.toml")
    rows = patch("0.1 mm patch, 1400 x 1400", paper, 0.1, Grid((1400, 1400), 14e-3, 11.7), 1e-2, 0.2)
    twin = scaled(paper, 0.125)
    exit_grid = Grid((864, 864), 3.2e-3, twin.exit_vertex_z_mm + 0.625)
    for error in (0.2, 0.1, 0.01):
        name = f"0.38 mm patch of the one-eighth twin, 864 x 864, error {error:g}"
        rows += patch(name, twin, 0.38, exit_grid, error, 0.5)
    rows.append(
        Row("most memory of the process", 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, "GB")
    )
    print_table("Eikonal tiles, complex64, once set up, best of several runs", rows)


def patch(name: str, lens: Lens, side_mm: float, exit_grid: Grid, error: float, target: float) -> list[Row]:
    """Seconds of forward and adjoint, together, and of the set-up."""
    wavelength = lens.wavelengths_um[0]
    pitch = OBJECT_FINENESS * 0.5e-3 * wavelength / lens.object.numerical_aperture
    count = round(side_mm / pitch)
    scene = Scene(lens, Grid((count, count), pitch, lens.object_z_mm), exit_grid, wavelength)
    rng = np.random.default_rng(1)
    values = rng.standard_normal((count, count)) + 1j * rng.standard_normal((count, count))
    field = Field(scene.object_grid, values.astype(np.complex64), wavelength)
    engine = engine_for(scene, "eikonal", error=error)
    started = time.perf_counter()
    engine.adjoint(engine.forward(field))
    once = time.perf_counter() - started
    seconds = []
    for _ in range(RUNS):
        started = time.perf_counter()
        engine.adjoint(engine.forward(field))
        seconds.append(time.perf_counter() - started)
    return [
        Row(name, min(seconds), "s", at_most=target),
        Row("  median", float(np.median(seconds)), "s"),
        Row("  set-up", once - min(seconds), "s"),
        Row("  width of a tile", engine.settings()["tile_width_mm"], "mm"),
    ]


if __name__ == "__main__":
    main()
