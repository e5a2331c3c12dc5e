"""The whole 3 mm field of the paper's lens, tiles in two levels: seconds, memory, errors, growth."""

from __future__ import annotations

import math
import resource
import time
from collections.abc import Sequence

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import Lens, load_design
from wavesim import Field, Grid, Scene, engine_for
from wavesim.scene.patches import OBJECT_FINENESS

SECONDS, GIGABYTES, MISMATCH = 60.0, 4.0, 1e-6
DIAMETERS_MM = (0.375, 0.75, 1.5, 3.0)
MOST_EXPONENT, RATIO = 1.1, 500.0
CHECKED_MM = 0.3


def main() -> None:
    """Measure and print."""
    lens = load_design(DESIGNS / "paper_singlet.toml")
    times = []
    for diameter in DIAMETERS_MM:
        rows, seconds = whole_field(lens, diameter)
        times.append(seconds)
        print_table(f"Field of {diameter:g} mm, first sensor plane, pixels of 3.2 µm, error 0.01", rows)
    rows = growth(DIAMETERS_MM, times, MOST_EXPONENT)
    exponents = [row.value for row in rows]
    largest = [
        t * (10.0 / DIAMETERS_MM[-1]) ** (2.0 * max(e, 1.0))
        for t, e in zip(times[-1], exponents, strict=True)
    ]
    rows += [Row("a 10 mm field on this machine, forward", largest[0] / 60.0, "min")]
    slices = engine_for(field_scene(lens, DIAMETERS_MM[-1]), "slices", slices=200, compensation="vertical")
    rows.append(
        Row("200 slices, predicted, over forward", slices.cost().seconds / times[-1][0], at_least=RATIO)
    )
    print_table("Growth", rows + against_one_level(lens))


def growth(diameters_mm: Sequence[float], times: Sequence[tuple[float, float]], at_most: float) -> list[Row]:
    """With which powers of the field's area seconds forward and back grow."""
    areas = np.log(np.square(diameters_mm))
    return [
        Row(f"exponent of {way} over field area", float(np.polyfit(areas, np.log(t), 1)[0]), at_most=at_most)
        for way, t in zip(("forward", "adjoint"), np.transpose(times), strict=True)
    ]


def noisy_fields(scene: Scene) -> tuple[Field, Field]:
    """Noise that fills the object, and the plane."""
    rng = np.random.default_rng(1)
    before, behind = (
        Field(grid, noise(rng, grid), scene.wavelength_um) for grid in (scene.object_grid, scene.exit_grid)
    )
    return before, behind


def whole_field(lens: Lens, diameter_mm: float) -> tuple[list[Row], tuple[float, float]]:
    """Forward, adjoint and their dot-product test on noise that fills the field."""
    scene, paper = field_scene(lens, diameter_mm), diameter_mm == DIAMETERS_MM[-1]
    count = scene.object_grid.shape[0]
    engine, (field, other) = engine_for(scene, "hierarchical"), noisy_fields(scene)
    started = time.perf_counter()
    predicted = engine.cost()
    setup = time.perf_counter() - started
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds, results = [], []
    for carry, start in ((engine.forward, field), (engine.adjoint, other)):
        started = time.perf_counter()
        results.append(carry(start).values)
        seconds.append(time.perf_counter() - started)
    there, back = results
    peak = 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    rows = [
        Row(
            f"forward, object of {count}^2, plane of 7000^2",
            seconds[0],
            "s",
            at_most=SECONDS if paper else None,
        ),
        Row("adjoint", seconds[1], "s", at_most=SECONDS if paper else None),
        Row("set-up, once", setup, "s"),
        Row("  predicted for either", predicted.seconds, "s"),
        Row("most memory of the process so far", peak, "GB", at_most=GIGABYTES),
        Row("  before", 1e-6 * held, "GB"),
        Row(
            "dot-product test, of the sizes",
            dot_product_mismatch(field, there, other, back),
            at_most=MISMATCH,
        ),
    ]
    return rows, (seconds[0], seconds[1])


def dot_product_mismatch(field: Field, there: np.ndarray, other: Field, back: np.ndarray) -> float:
    """Between forward of one field and adjoint of another, in units of their sizes."""
    left = np.vdot(other.values, there) * other.grid.cell
    right = np.vdot(back, field.values) * field.grid.cell
    return float(abs(left - right) / (np.linalg.norm(there) * np.linalg.norm(other.values) * other.grid.cell))


def field_scene(lens: Lens, diameter_mm: float, side: int = 7000) -> Scene:
    """Samples for light of the design's numerical aperture, and a square of pixels."""
    part = lens.replaced(object=lens.object.replaced(field_diameter_mm=diameter_mm))
    wavelength = lens.wavelengths_um[0]
    pitch = OBJECT_FINENESS * 0.5e-3 * wavelength / lens.object.numerical_aperture
    count = 2 * math.ceil(0.51 * diameter_mm / pitch)
    grid = Grid((count, count), pitch, lens.object_z_mm)
    return Scene(part, grid, Grid((side, side), 3.2e-3, lens.sensor_z_mm[0]), wavelength)


def against_one_level(lens: Lens) -> list[Row]:
    """Difference from tiles in one level over a patch near the field's edge."""
    wavelength = lens.wavelengths_um[0]
    scene = Scene(
        lens,
        Grid((600, 600), 1e-3 * CHECKED_MM / 0.6, lens.object_z_mm, (0.0, 1.3)),
        Grid((900, 900), 0.02, lens.sensor_z_mm[0]),
        wavelength,
    )
    values = noise(np.random.default_rng(2), scene.object_grid)
    one = engine_for(scene, "eikonal", error=1e-4, tile_width_mm=0.075)
    exact = one.forward(Field(scene.object_grid, values.astype(complex), wavelength)).values
    # The outermost strip is drawn soft by one and sharp by the other.
    bright = np.argwhere(np.abs(exact) > 0.0)
    middle = bright.mean(axis=0)
    rows, columns = np.indices(exact.shape)
    inside = 0.02 * np.hypot(rows - middle[0], columns - middle[1]) < 8.3
    found = []
    for error in (1e-2, 1e-3):
        engine = engine_for(scene, "hierarchical", error=error)
        mine = engine.forward(Field(scene.object_grid, values, wavelength)).values
        off = float(np.linalg.norm(mine[inside] - exact[inside]) / np.linalg.norm(exact[inside]))
        found.append(Row(f"difference from one level, error {error:g} asked", off, at_most=error))
    return found


def noise(rng: np.random.Generator, grid: Grid) -> np.ndarray:
    """Complex normal numbers in single precision."""
    parts = [rng.standard_normal(grid.shape, np.float32) for _ in range(2)]
    return parts[0] + np.complex64(1j) * parts[1]


if __name__ == "__main__":
    main()
