"""The stated uncertainty of a reconstruction, against independent frames and the truth.

1/32 twin of the paper's lens, 10^5 electrons in the brightest pixel.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import Engine, Field, Grid, Measurement, Scene, engine_for
from wavesim.fields.plane_waves import fft_frequencies, transfer
from wavesim.reconstruction import UndeterminedError, reconstruct, uncertainty
from wavesim.sensor.measurement import recorded_intensity

WAVELENGTH_UM, SAMPLES, PITCH_MM, PIXELS, PIXEL_MM = 0.532, 96, 4.2e-4, 240, 3.2e-3
STOP_MM, ELECTRONS, FRAMES = 0.036, 1e5, 12


def scene() -> tuple[Engine, Field]:
    """The engine, and even light within the field stop."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1 / 32)
    grid = Grid((SAMPLES, SAMPLES), PITCH_MM, lens.object_z_mm)
    behind = Grid((PIXELS, PIXELS), PIXEL_MM, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, grid, behind, WAVELENGTH_UM), "eikonal", error=0.3)
    lit = np.sqrt(grid.radius_squared_mm2()) < 0.5 * STOP_MM
    return engine, Field(grid, lit.astype(np.complex64), WAVELENGTH_UM)


def objects(grid: Grid) -> dict[str, np.ndarray]:
    """Bars that take light away, the same that delay it, and a diffuser."""
    rng = np.random.default_rng(7)
    x, y = grid.x_mm, grid.y_mm[:, None]
    bars = np.zeros(grid.shape)
    for _ in range(10):
        width, cy, cx = rng.uniform(0.9e-3, 3e-3), *rng.uniform(-0.014, 0.014, 2)
        for bar in range(3):
            bars[(np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)] = 1.0
    real, imaginary = (gaussian_filter(rng.standard_normal(grid.shape), 3.0) for _ in range(2))
    diffuse = (real + 1j * imaginary) / np.sqrt(np.mean(real**2 + imaginary**2))
    return {"amplitude": 1.0 - 0.8 * bars, "complex": np.exp(1.5j * bars), "diffuser": diffuse}


def record(
    engine: Engine,
    light: Field,
    values: np.ndarray,
    distances_mm: tuple[float, ...],
    seed: int,
    electrons: float = ELECTRONS,
) -> list[Measurement]:
    """Amplitudes with shot noise, of so many electrons in the brightest pixel."""
    field = engine.forward(light.with_values((values * light.values).astype(np.complex64)))
    random, planes = np.random.default_rng(seed), []
    for distance in distances_mm:
        way = transfer(fft_frequencies(field.grid.shape, PIXEL_MM), WAVELENGTH_UM, 1.0, distance)
        intensity = np.abs(np.fft.ifft2(np.fft.fft2(field.values) * way)) ** 2
        gain = electrons / intensity.max()
        counts = random.poisson(gain * intensity)
        one = recorded_intensity(distance, counts / gain, np.maximum(counts, 1.0) / gain**2)
        amplitude, sigma = (np.asarray(v, np.float32) for v in (one.amplitude, one.sigma))
        planes.append(replace(one, amplitude=amplitude, sigma=sigma))
    return planes


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def main() -> None:
    """Measure and print."""
    engine, light = scene()
    inside = np.abs(light.values) > 0.0
    rows, reasons = [], []
    for name, planes_mm, iterations in (
        ("amplitude", (0.0, 0.6), 30),
        ("complex", (0.0, 0.6), 30),
        ("complex", (0.0, 0.3, 0.6, 0.9), 60),
        ("diffuser", (0.0, 0.6), 30),
    ):
        true = objects(light.grid)[name]
        kind = "amplitude" if name == "amplitude" else "complex"
        frames = [record(engine, light, true, planes_mm, seed) for seed in range(FRAMES)]
        found = [
            reconstruct(engine, light, planes, kind=kind, tv_weight="auto", iterations=iterations, scale=1.0)
            for planes in frames
        ]
        values = np.array([one.transmission.values[inside] for one in found])
        turned = np.array([one * np.exp(1j * np.angle(np.vdot(one, true[inside]))) for one in values])
        what = f"{name}, {len(planes_mm)} planes, {iterations} iterations: "
        rows.append(Row(f"{what}true error", rms(turned[0] - true[inside])))
        rows.append(Row("  scatter of independent frames", rms(np.std(turned, axis=0, ddof=1))))
        try:
            told = uncertainty(engine, light, frames[0], found[0], kind=kind, tv_weight="auto")
        except UndeterminedError as error:
            reasons.append(f"{what}{error}")
            rows.append(Row("  not stated, see below", float("nan")))
            continue
        rows.append(Row("  stated", rms(told.values[inside])))
        rows.append(Row("    of it noise", told.of_noise))
        rows.append(Row("    of it between starts", told.of_starts))
    print_table("Uncertainty of a reconstruction, root mean square within the field stop", rows)
    print("\n".join(reasons))


if __name__ == "__main__":
    main()
