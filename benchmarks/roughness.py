"""Loss of correlation of reconstructions through lenses with rough surfaces.

1/32 twin of the paper's lens; a chart; a camera with noise. Two models of the roughness record the frames:
the smooth background of `wavesim image`, and a random phase screen behind the lens that scatters the same
fraction of the light and interferes with the direct light, as in one lens. Reconstructions either know the
roughness of the design or assume smooth surfaces. The phase screen is drawn with NumPy alone.
"""

from __future__ import annotations

import argparse
import math
import warnings
from typing import Any

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import Lens, SurfaceRoughness, load_design, scaled
from lensdesign.analysis.roughness import RoughnessWarning
from wavesim import Field, Frame, image, reconstruct_frames
from wavesim.fields.field import Grid
from wavesim.fields.propagator import propagate
from wavesim.scene.scene import placed_light
from wavesim.sensor import Camera, light_on_pixels, plane_seeds, sensor_grid
from wavesim.sensor.imaging import Imaged
from wavesim.sensor.windows import footprint_mm, light_window
from wavesim.targets.patch import lit

SCALE, OVERSAMPLING = 1 / 32, 8
PATCH: dict[str, Any] = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.05}
CAMERA: dict[str, Any] = {"full_well_electrons": 1e6, "bits": 16}  # so little noise that losses show
RMS_NM, LENGTHS_UM = (0.0, 2.0, 5.0, 10.0), (1.0, 10.0)


def rough_lens(lens: Lens, rms_nm: float, length_um: float) -> Lens:
    """The lens with the same roughness on both surfaces; smooth for 0."""
    if not rms_nm:
        return lens
    roughness = SurfaceRoughness(rms_nm=rms_nm, correlation_length_um=length_um)
    return lens.replaced(surfaces=tuple(one.replaced(roughness=roughness) for one in lens.surfaces))


def screen(grid: Grid, phase_rad: float, length_um: float, seed: int) -> np.ndarray:
    """A random phase with a Gaussian autocorrelation, as a factor of the field."""
    f = [np.fft.fftfreq(count, 1e3 * grid.pitch_mm) for count in grid.shape]
    spectrum = np.exp(-((math.pi * length_um) ** 2) * (f[0][:, None] ** 2 + f[1] ** 2))
    spectrum *= spectrum.size / spectrum.sum()
    noise = np.fft.fft2(np.random.default_rng(seed).standard_normal(grid.shape))
    return np.exp(1j * phase_rad * np.fft.ifft2(np.sqrt(spectrum) * noise).real)


def with_screen(smooth: Imaged, fraction: float, length_um: float, seed: int) -> tuple[Frame, ...]:
    """Frames of the same object with a phase screen behind the last surface that scatters a fraction."""
    lens, recording, engine = smooth.engine.scene.lens, smooth.recording, smooth.engine
    light = placed_light(lit(smooth.patch, smooth.settings), recording.state)
    first = engine.forward(light.with_values(light.values * smooth.target.transmission.values))
    seeds, frames = plane_seeds(recording.seed, len(recording.plane_distances_mm)), list[Frame]()
    window = light_window(smooth.sensor, footprint_mm(lens, smooth.patch, max(recording.plane_distances_mm)))
    camera = Camera(smooth.sensor, recording.camera.electronics)

    def fine(z_mm: float) -> Grid:
        return sensor_grid(window, lens.exit_vertex_z_mm + z_mm, OVERSAMPLING)

    behind: Field = propagate(first, fine(0.0))
    phase_rad = math.sqrt(-math.log1p(-fraction))
    behind = behind.with_values(behind.values * screen(behind.grid, phase_rad, length_um, seed))
    for plane_mm, noise in zip(recording.plane_distances_mm, seeds, strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # scattered light outside the sensor
            intensity = light_on_pixels(
                propagate(behind, fine(plane_mm)), smooth.sensor, oversampling=OVERSAMPLING
            )
        frames += camera.frames(intensity, plane_mm, light.wavelength_um, noise)
    return tuple(frames)


def correlation(lens: Lens, frames: tuple[Frame, ...], truth: Field) -> tuple[float, float]:
    """Correlation of the object found with the true one, and the misfit of the worst plane over the noise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reconstruct_frames(lens, frames, kind="amplitude", truth=truth, **PATCH)
    value = found.truth["object_correlation"]
    assert value is not None
    return value, found.verdict.over_noise


def main() -> None:
    """Print the correlations for each roughness and correlation length."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="phase screens for each roughness")
    seeds = range(parser.parse_args().seeds)
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    print("correlation (misfit over the noise) with frames of:")
    print("length  rms    scattered  background, unknown  background, known   phase screen, unknown")
    for length_um in LENGTHS_UM:
        for rms_nm in RMS_NM:
            rough = rough_lens(lens, rms_nm, length_um)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RoughnessWarning)
                smooth, taken = (image(one, "usaf", **PATCH, **CAMERA) for one in (lens, rough))
            truth = taken.target.transmission
            fraction = 0.0 if taken.scattered is None else taken.scattered.mean_fraction
            found = [correlation(one, taken.frames, truth) for one in (lens, rough)]
            screened = [
                correlation(lens, with_screen(smooth, fraction, length_um, seed), truth)
                for seed in (seeds if rms_nm else range(1))
            ]
            found.append((float(np.mean([c for c, _ in screened])), float(np.mean([m for _, m in screened]))))
            texts = "  ".join(f"{value:.5f} ({misfit:6.2f})  " for value, misfit in found)
            print(f"{length_um:4g} um {rms_nm:3g} nm  {100.0 * fraction:6.3f} %  {texts}", flush=True)


if __name__ == "__main__":
    main()
