"""Both ways of reconstruction on the one-eighth twin of the paper's lens: bars, two planes, shot noise."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.fft

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import Engine, Field, Grid, SamplingWarning, Scene, make_engine, reconstruct, retrieve
from wavesim.coverage import rectangle, rectangle_coverage
from wavesim.fields import correlation
from wavesim.free_space import transfer_function
from wavesim.retrieval import Recorded

SIDE_MM, PITCH_MM, PIXELS, PIXEL_MM = 0.38, 0.4256e-3, 864, 3.2e-3
PLANES_MM = (0.625, 3.125)
BRIGHTEST_ELECTRONS = 10_000.0
RETRIEVAL_ITERATIONS = 500


@dataclass(frozen=True, eq=False)
class Case:
    """The object under its field stop, and amplitudes on both planes."""

    engine: Engine
    illumination: Field
    transmission: np.ndarray
    recorded: list[Recorded]


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    rows: list[Row] = []
    for ground in ("bright", "dark"):
        for electrons in (None, BRIGHTEST_ELECTRONS):
            made = case(ground, electrons)
            name = ground if electrons is None else f"{ground}, {electrons:g} e-"
            rows += object_domain(name, made)
            if electrons is None:
                rows += dual_plane(name, made)
    print_table("Correlation with the band-limited object, the illumination taken out of both", rows)


def case(ground: str, electrons: float | None) -> Case:
    """Random bars of 0.87 to 6 um, through the twin, with shot noise where electrons are given."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 0.125)
    count = round(SIDE_MM / PITCH_MM)
    grid = Grid((count, count), PITCH_MM, lens.object_z_mm)
    exit_grid = Grid((PIXELS, PIXELS), PIXEL_MM, lens.exit_vertex_z_mm + PLANES_MM[0])
    engine = make_engine("eikonal", Scene(lens, grid, exit_grid, 0.532), error=0.1)
    rng = np.random.default_rng(60)
    bars = np.zeros(grid.shape)
    for _ in range(60):
        width = rng.uniform(0.87e-3, 6e-3)
        x, y = rng.uniform(-0.17, 0.17, 2)
        for bar in (-1, 0, 1):
            part = rectangle((x + 2 * bar * width, y), width, 5 * width)
            bars = np.maximum(bars, rectangle_coverage(grid, [part]))
    stop = (np.sqrt(grid.radius_squared_mm2()) < 0.49 * SIDE_MM).astype(np.complex64)
    lit = Field(grid, stop, 0.532)
    transmission = 1.0 - bars if ground == "bright" else bars
    at_exit = engine.forward(lit.with_values((transmission * stop).astype(np.complex64)))
    noise = np.random.default_rng(1)
    recorded = []
    for plane in PLANES_MM:
        amplitude = np.abs(carried(at_exit.values, plane - PLANES_MM[0]))
        if electrons is not None:
            gain = electrons / float(amplitude.max()) ** 2
            amplitude = np.sqrt(noise.poisson(gain * amplitude.astype(float) ** 2) / gain).astype(np.float32)
        recorded.append(Recorded(plane - PLANES_MM[0], amplitude))
    return Case(engine, lit, transmission, recorded)


def carried(values: np.ndarray, distance_mm: float) -> np.ndarray:
    """To another plane behind the lens."""
    way = transfer_function(values.shape, PIXEL_MM, 0.532, 1.0, distance_mm, band_limit=False)
    return np.asarray(scipy.fft.ifftn(scipy.fft.fftn(values) * way), np.complex64)


def object_domain(name: str, made: Case) -> list[Row]:
    """For amplitude and for complex objects."""
    rows = []
    for kind, iterations in (("amplitude", 30), ("complex", 30)):
        started = time.perf_counter()
        found = reconstruct(
            made.engine,
            made.illumination,
            made.recorded,
            kind=kind,
            tv_weight=0.02,
            iterations=iterations,
            scale=1.0,
        )
        seconds = time.perf_counter() - started
        result = through(made, made.illumination.values * found.transmission.values)
        rows.append(
            Row(f"{name}: object-domain, {kind}, {len(found.misfit)} iterations", score(made, result))
        )
        rows.append(Row("  seconds", seconds, "s"))
    return rows


def dual_plane(name: str, made: Case) -> list[Row]:
    """Appendix A, from the forward model's field."""
    exit_grid = made.engine.scene.exit_grid
    model = made.engine.forward(made.illumination)
    first = made.recorded[0].amplitude
    scale = np.float32(64.0 / np.median(first[first > 1e-4 * first.max()]))
    planes = [Recorded(p.distance_mm, scale * p.amplitude) for p in made.recorded]
    start = Field(exit_grid, scale * model.values, 0.532)
    started = time.perf_counter()
    retrieved = retrieve(exit_grid, 0.532, planes, start, iterations=RETRIEVAL_ITERATIONS)
    seconds = time.perf_counter() - started
    back = made.engine.adjoint(Field(exit_grid, retrieved.field.values, 0.532)).values
    return [
        Row(f"{name}: Appendix A, {RETRIEVAL_ITERATIONS} iterations", score(made, back)),
        Row("  its CC (A6)", retrieved.correlation[-1]),
        Row("  seconds", seconds, "s"),
    ]


def through(made: Case, values: np.ndarray) -> np.ndarray:
    """What the lens passes of an object field: there and back."""
    field = made.illumination.with_values(values.astype(np.complex64))
    return np.asarray(made.engine.adjoint(made.engine.forward(field)).values)


def score(made: Case, result: np.ndarray) -> float:
    """Correlation inside the field stop, after the projection on the illumination is taken out."""
    inside = np.abs(made.illumination.values) > 0.0
    known = through(made, made.illumination.values)[inside]

    def cleaned(values: np.ndarray) -> np.ndarray:
        part = values[inside]
        return part - known * (np.vdot(known, part) / np.vdot(known, known))

    truth = through(made, made.illumination.values * made.transmission)
    return correlation(cleaned(result), cleaned(truth))


if __name__ == "__main__":
    main()
