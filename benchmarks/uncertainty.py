"""The stated uncertainty of a reconstruction against its true error, on twelve perfect benches.

1/32 twin of the paper's lens; a camera with shot noise and a read noise of two electrons. Errors are root
mean squares within the field stop, over several records of each bench.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from wavesim import Engine, Field, Grid, Measurement, Scene, engine_for
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.reconstruction import UndeterminedError, reconstruct, uncertainty
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import recorded_intensity

WAVELENGTH_UM, SAMPLES, PITCH_MM, PIXELS, PIXEL_MM = 0.532, 96, 4.2e-4, 240, 3.2e-3
STOP_MM, READ_NOISE, RECORDS = 0.036, 2.0, 4
ONE, TWO, THREE, FOUR = (0.3,), (0.0, 0.6), (0.0, 0.45, 0.9), (0.0, 0.3, 0.6, 0.9)


class Bench(NamedTuple):
    """An object, its assumed kind, the planes behind the first one, and electrons in the brightest pixel."""

    thing: str
    kind: Kind
    planes_mm: tuple[float, ...]
    electrons: float
    seed: int
    iterations: int = 100


BENCHES = (
    Bench("bars", "amplitude", TWO, 1e5, 7),
    Bench("bars", "amplitude", TWO, 1e4, 3),
    Bench("bars", "amplitude", TWO, 1e6, 3),
    Bench("spots", "amplitude", TWO, 1e5, 3),
    Bench("bars", "amplitude", THREE, 1e5, 9),
    Bench("bars", "amplitude", ONE, 1e5, 11),
    Bench("weak bars", "complex", FOUR, 1e5, 7),
    Bench("weak bars", "complex", FOUR, 1e6, 5),
    Bench("spots", "complex", FOUR, 1e5, 3),
    Bench("spots", "complex", FOUR, 1e6, 4),
    Bench("spots", "complex", THREE, 1e5, 6),
    Bench("weak bars", "complex", THREE, 1e5, 12),
)


def scene() -> tuple[Engine, Field]:
    """The engine, and even light within the field stop."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1 / 32)
    grid = Grid((SAMPLES, SAMPLES), PITCH_MM, lens.object_z_mm)
    behind = Grid((PIXELS, PIXELS), PIXEL_MM, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, grid, behind, WAVELENGTH_UM), "eikonal", error=0.3)
    lit = np.sqrt(grid.radius_squared_mm2()) < 0.5 * STOP_MM
    return engine, Field(grid, lit.astype(np.complex64), WAVELENGTH_UM)


def transmission(bench: Bench, grid: Grid) -> np.ndarray:
    """Bars or smooth spots, which absorb in an amplitude object and delay in a complex one."""
    rng = np.random.default_rng(bench.seed)
    shape = np.zeros(grid.shape)
    if bench.thing == "spots":
        shape = gaussian_filter(rng.standard_normal(grid.shape), 4.0)
        shape /= np.abs(shape).max()
    else:
        x, y = grid.x_mm, grid.y_mm[:, None]
        for _ in range(10):
            width, cy, cx = rng.uniform(0.9e-3, 3e-3), *rng.uniform(-0.014, 0.014, 2)
            for bar in range(3):
                shape[(np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)] = 1.0
    if bench.kind == "amplitude":
        return np.asarray(1.0 - 0.8 * np.abs(shape))
    return np.exp((0.3j if bench.thing == "weak bars" else 1.5j) * shape)


def record(
    engine: Engine,
    light: Field,
    values: np.ndarray,
    distances_mm: tuple[float, ...],
    seed: int,
    electrons: float = 1e5,
) -> list[Measurement]:
    """Amplitudes with shot and read noise, of so many electrons in the brightest pixel."""
    field = engine.forward(light.with_values((values * light.values).astype(np.complex64)))
    random, planes = np.random.default_rng(seed), []
    for distance in distances_mm:
        propagator = PlaneWaves.of(field.grid, WAVELENGTH_UM).transfer_function(distance)
        intensity = np.abs(np.fft.ifft2(np.fft.fft2(field.values) * propagator)) ** 2
        gain = electrons / intensity.max()
        counts = random.poisson(gain * intensity) + READ_NOISE * random.standard_normal(intensity.shape)
        variance = np.maximum(counts, 0.0) + READ_NOISE**2
        one = recorded_intensity(distance, counts / gain, variance / gain**2)
        amplitude, sigma = (np.asarray(v, np.float32) for v in (one.amplitude, one.sigma))
        planes.append(replace(one, amplitude=amplitude, sigma=sigma))
    return planes


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def main() -> None:
    """Print a line for each bench."""
    engine, light = scene()
    inside = np.abs(light.values) > 0.0
    print("| object, kind, planes, electrons | true error | stated | of it between starts | true / stated |")
    print("| --- | --- | --- | --- | --- |")
    for bench in BENCHES:
        true, errors = transmission(bench, light.grid), []
        settings = {"kind": bench.kind, "tv_weight": "auto"}
        records = [
            record(engine, light, true, bench.planes_mm, seed, bench.electrons) for seed in range(RECORDS)
        ]
        found = [
            reconstruct(engine, light, planes, iterations=bench.iterations, scale=1.0, **settings)  # type: ignore[arg-type]
            for planes in records
        ]
        for one in found:
            values = one.transmission.values[inside]
            errors.append(rms(values * np.exp(1j * np.angle(np.vdot(values, true[inside]))) - true[inside]))
        name = f"{bench.thing}, {bench.kind}, {len(bench.planes_mm)}, {bench.electrons:.0e}"
        try:
            stated = uncertainty(engine, light, records[0], found[0], **settings)  # type: ignore[arg-type]
        except UndeterminedError as error:
            print(f"| {name} | {rms(np.array(errors)):.4f} | nothing: {error} | | |", flush=True)
            continue
        ratio = rms(np.array(errors)) / rms(stated.values[inside])
        figures = (rms(np.array(errors)), rms(stated.values[inside]), stated.starts_rms)
        cells = [name, *(f"{one:.4f}" for one in figures), f"{ratio:.2f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
