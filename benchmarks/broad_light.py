"""Objects in broad light: what a bandwidth costs, how well it is found, and a bench that is calibrated in it.

Frames do not share the model of the reconstruction. Their spectrum has 41 wavelengths instead of the few
nodes of a quadrature, and is rectangular or Gaussian. The field has three samples per pixel, a zero-padded
angular spectrum leads from plane to plane, and pixels are means over boxes of six by six samples. The camera
has 12 bits, 8,000 electrons in the brightest pixel of the first of three exposures (1, 30 and 1000), and 2
electrons of read noise.

Usage: `python -m benchmarks.broad_light [CASE ...]`, with names of `CASES`; default: all.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim import Frame, FrameSettings, calibrate_frames, engine_for, image, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.reconstruction.found_object import FoundObject
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.imaging import Imaged
from wavesim.sensor.sensor import sensor_grid
from wavesim.sensor.windows import footprint_mm, light_window
from wavesim.targets.patch import lit

WAVELENGTHS, SAMPLES_PER_PIXEL, UPSAMPLING = 41, 3, 2
"""Wavelengths of a spectrum, samples per pixel of a field, and further samples between them for means."""

EXPOSURES = 1.0, 30.0, 1000.0
ENGINE_ERROR = 0.05

RECTANGLE_OVER_GAUSSIAN = np.sqrt(12.0 / (8.0 * np.log(2.0)))
"""Full width of a rectangle over that at half maximum of a Gaussian with the same variance, 1.47."""


@dataclass(frozen=True)
class Case:
    """An object in light of some spectrum, on a scaled twin of the paper's lens.

    Attributes
    ----------
    scale
        Size of the lens over that of the twin.
    patch_mm
        Diameter of the field stop.
    target, kind
        Object, and its kind in the reconstruction.
    shape
        "rectangular", whose width is the full width, or "gaussian", whose width is that at half maximum.
    width_nm
        Width of the spectrum.
    pose
        Pose of the lens that the reconstruction does not know; None for a bench as designed.
    """

    scale: float
    patch_mm: float
    target: str
    kind: str
    shape: str
    width_nm: float
    pose: Pose | None = None

    @property
    def rectangle_nm(self) -> float:
        """Full width of the rectangle with the variance of this spectrum."""
        return self.width_nm * (1.0 if self.shape == "rectangular" else RECTANGLE_OVER_GAUSSIAN)


CASES = {
    "0.1-nm": Case(32, 0.08, "usaf", "amplitude", "rectangular", 0.1),
    "1-nm": Case(32, 0.08, "usaf", "amplitude", "rectangular", 1.0),
    "5-nm": Case(32, 0.08, "usaf", "amplitude", "rectangular", 5.0),
    "5-nm-led": Case(32, 0.08, "usaf", "amplitude", "gaussian", 5.0),
    "40-nm": Case(32, 0.08, "usaf", "amplitude", "rectangular", 40.0),
    "20-nm": Case(64, 0.04, "star", "amplitude", "rectangular", 20.0),
    "20-nm-led": Case(64, 0.04, "star", "amplitude", "gaussian", 20.0),
    "20-nm-complex": Case(64, 0.04, "tissue", "complex", "rectangular", 20.0),
    "decentered-60-nm": Case(
        64,
        0.03,
        "star",
        "amplitude",
        "rectangular",
        60.0,
        Pose(decenter_x_mm=0.004, decenter_y_mm=-0.002),
    ),
}


def main() -> None:
    """Measure and print."""
    for name in sys.argv[1:] or CASES:
        case = CASES[name]
        lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / case.scale)
        rows = _calibration_rows(case, lens) if case.pose is not None else _rows(case, lens)
        print_table(f"{name}: {case.kind} object, {case.shape} spectrum, 1/{case.scale:g} twin", rows)


def imaged(case: Case, lens: Lens) -> Imaged:
    """Return patch, object and camera of a case; its own frames are those of coherent light."""
    # Distances of the planes behind a twin of 1/64.
    planes = (0.03, 0.3) if case.kind == "amplitude" else (0.03, 0.12, 0.21, 0.3)
    planes_mm = tuple(64.0 / case.scale * plane for plane in planes)
    return image(lens, case.target, patch_mm=case.patch_mm, planes_mm=planes_mm, engine="eikonal", error=0.1)


def _rows(case: Case, lens: Lens) -> list[Row]:
    taken = imaged(case, lens)
    frames = broad_frames(lens, taken, spectrum(case.shape, case.width_nm, taken.patch.wavelength_um))
    rows = []
    for name, bandwidth in (("ignored", 0.0), ("found", "find")):
        before = time.process_time()
        found = _reconstructed(case, lens, frames, taken, bandwidth_nm=bandwidth)
        seconds = time.process_time() - before
        target = 0.98 if name == "found" else None
        rows += [
            Row(f"correlation, band {name}", _correlation(found), at_least=target),
            Row(f"misfit over noise, band {name}", found.verdict.over_noise or 0.0),
            Row(f"processor time, band {name}", seconds, "s"),
        ]
    width, deviation = (found.of_method[f"bandwidth_nm{end}"] for end in ("", "_deviation"))
    rows += [
        Row("bandwidth found", width, "nm"),
        Row("its standard deviation", deviation, "nm"),
        Row("bandwidth with the true variance", case.rectangle_nm, "nm"),
    ]
    if case.width_nm >= 5.0:
        rows.append(Row("relative error of the bandwidth", abs(width / case.rectangle_nm - 1.0), at_most=0.1))
    return rows


def _calibration_rows(case: Case, lens: Lens) -> list[Row]:
    assert case.pose is not None
    taken = imaged(case, lens)
    bands = spectrum(case.shape, case.width_nm, taken.patch.wavelength_um)
    frames = broad_frames(lens, taken, bands, SystemState(case.pose))
    rows = [
        Row(
            "correlation as designed",
            _correlation(_reconstructed(case, lens, frames, taken, bandwidth_nm=0.0)),
        )
    ]
    for name, bandwidth in (("ignored", 0.0), ("found", "find")):
        before = time.process_time()
        bench = calibrate_frames(
            lens,
            frames,
            patch_mm=case.patch_mm,
            kind=case.kind,
            parameters="decenter_x_mm,decenter_y_mm",
            most_mountings=10,
            bandwidth_nm=bandwidth,
            verdict="none",
        )
        seconds = time.process_time() - before
        found = _reconstructed(case, lens, frames, taken, calibration=bench.state)
        target = 0.97 if name == "found" else None
        rows += [
            Row(f"correlation calibrated, band {name}", _correlation(found), at_least=target),
            Row(f"misfit over noise, band {name}", found.verdict.over_noise or 0.0),
            Row(f"error of the decenter, band {name}", _decenter_error_um(bench.state, case.pose), "um"),
            Row(f"processor time of the calibration, band {name}", seconds, "s"),
        ]
    rows.append(Row("bandwidth found", bench.state.source.bandwidth_nm, "nm"))
    rows.append(Row("its standard deviation", bench.source_deviations["bandwidth_nm"], "nm"))
    return rows


def _decenter_error_um(state: SystemState, true: Pose) -> float:
    x, y = state.pose.decenter_x_mm - true.decenter_x_mm, state.pose.decenter_y_mm - true.decenter_y_mm
    return float(1e3 * np.hypot(x, y))


def _correlation(found: FoundObject) -> float:
    return found.truth["object_correlation"] or 0.0


def _reconstructed(
    case: Case, lens: Lens, frames: Sequence[Frame], taken: Imaged, **settings: Any
) -> FoundObject:
    truth = taken.target.transmission
    return reconstruct_frames(lens, frames, patch_mm=case.patch_mm, kind=case.kind, truth=truth, **settings)


def spectrum(shape: str, width_nm: float, centre_um: float) -> list[tuple[float, float]]:
    """Return weights, whose sum is 1, and wavelengths in um of a spectrum.

    Parameters
    ----------
    shape
        "rectangular" or "gaussian".
    width_nm
        Full width of a rectangle, or full width at half maximum of a Gaussian; 0 is one wavelength.
    centre_um
        Centre of the spectrum.
    """
    if width_nm == 0.0:
        return [(1.0, centre_um)]
    if shape == "rectangular":
        offsets = (np.arange(WAVELENGTHS) + 0.5) / WAVELENGTHS - 0.5
        weights = np.ones(WAVELENGTHS)
    else:
        sigma = 1.0 / np.sqrt(8.0 * np.log(2.0))
        offsets = 3.5 * sigma * np.linspace(-1.0, 1.0, WAVELENGTHS)
        weights = np.exp(-0.5 * (offsets / sigma) ** 2)
    wavelengths_um = centre_um + 1e-3 * width_nm * offsets
    return list(zip((weights / weights.sum()).tolist(), wavelengths_um.tolist(), strict=True))


def broad_frames(
    lens: Lens,
    taken: Imaged,
    bands: Sequence[tuple[float, float]],
    state: SystemState = AS_DESIGNED,
    seed: int = 0,
) -> list[Frame]:
    """Return frames of an object in light of a spectrum.

    Parameters
    ----------
    lens
        The nominal lens.
    taken
        Patch, object, planes and camera, from :func:`wavesim.image`.
    bands
        Weights and wavelengths, from :func:`spectrum`.
    state
        Deviations of the lens from the design.
    seed
        Seed of the noise.
    """
    planes_mm, patch = taken.recording.plane_distances_mm, taken.patch
    wide = light_window(taken.sensor, footprint_mm(lens, patch, planes_mm[-1], state))
    # Pixels are added in pairs, so that those of the sensor stay in place.
    margins = [-(-(n - own) // 2) for n, own in zip(wide.pixels, taken.sensor.pixels, strict=True)]
    window = wide.replaced(
        pixels=tuple(own + 2 * m for own, m in zip(taken.sensor.pixels, margins, strict=True))
    )
    grid = sensor_grid(window, lens.exit_vertex_z_mm + planes_mm[0], SAMPLES_PER_PIXEL)
    behind = lit(patch, taken.settings).values * taken.target.transmission.values
    totals = [np.zeros(window.pixels[::-1]) for _ in planes_mm]
    for weight, wavelength_um in bands:
        scene = Scene(lens, patch.grid, grid, patch.wavelength_um, polarization="scalar")
        scene = replace(placed_scene(scene, state), wavelength_um=wavelength_um)
        engine = engine_for(scene, "eikonal", error=ENGINE_ERROR)
        field = Field(scene.object_grid, behind.astype(np.complex64), wavelength_um)
        values = np.asarray(engine.forward(field).values, complex)
        for plane_mm, total in zip(planes_mm, totals, strict=True):
            total += weight * _box_means(
                _propagated(values, grid.pitch_mm, wavelength_um, plane_mm - planes_mm[0])
            )
    random, (x, y) = np.random.default_rng(seed), margins
    (across, down), frames = taken.sensor.pixels, list[Frame]()
    for plane_mm, total in zip(planes_mm, totals, strict=True):
        frames += _recorded(total[y : y + down, x : x + across], plane_mm, taken, random)
    return frames


def _propagated(
    values: NDArray[np.complex128], pitch_mm: float, wavelength_um: float, distance_mm: float
) -> NDArray[np.complex128]:
    if distance_mm == 0.0:
        return values
    count = scipy.fft.next_fast_len(2 * max(values.shape))
    frequencies = scipy.fft.fftfreq(count, pitch_mm)
    squares = (1e3 / wavelength_um) ** 2 - frequencies[:, None] ** 2 - frequencies**2
    phase = 2.0 * np.pi * distance_mm * np.sqrt(np.maximum(squares, 0.0))
    spectra = scipy.fft.fft2(values, (count, count)) * np.where(squares > 0.0, np.exp(1j * phase), 0.0)
    return np.asarray(scipy.fft.ifft2(spectra)[: values.shape[0], : values.shape[1]])


def _box_means(values: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return the means of |u|^2 over pixels, from samples that a padded spectrum puts between the given."""
    (height, width), factor = values.shape, UPSAMPLING
    padded = np.zeros((factor * height, factor * width), complex)
    y, x = factor * height // 2 - height // 2, factor * width // 2 - width // 2
    padded[y : y + height, x : x + width] = scipy.fft.fftshift(scipy.fft.fft2(values))
    # The new samples lie symmetrically about the given ones, as those of a pixel do.
    waves = (np.arange(factor * n) - factor * n // 2 for n in (height, width))
    down, across = (
        np.exp(-1j * np.pi * (1.0 - 1.0 / factor) * wave / n)
        for wave, n in zip(waves, (height, width), strict=True)
    )
    fine = factor**2 * scipy.fft.ifft2(scipy.fft.ifftshift(padded * down[:, None] * across))
    step, pixel = factor * SAMPLES_PER_PIXEL, SAMPLES_PER_PIXEL
    boxes = (np.abs(fine) ** 2).reshape(height // pixel, step, width // pixel, step)
    return np.asarray(boxes.mean((1, 3)))


def _recorded(
    intensity: NDArray[np.float64], plane_mm: float, taken: Imaged, random: np.random.Generator
) -> list[Frame]:
    camera, frames = taken.recording.camera.electronics, []
    unit = taken.recording.camera.peak_fill * camera.full_well_electrons / float(intensity.max())
    for exposure in EXPOSURES:
        electrons = random.poisson(unit * exposure * intensity).astype(float)
        electrons = np.minimum(electrons, camera.full_well_electrons)
        electrons += camera.read_noise_electrons * random.standard_normal(intensity.shape)
        counts = np.rint(camera.offset_counts + electrons / camera.gain)
        settings = FrameSettings(
            pixel_pitch_um=taken.sensor.pixel_pitch_um,
            plane_distance_mm=plane_mm,
            wavelength_um=taken.patch.wavelength_um,
            exposure=unit * exposure,
            bits=camera.bits,
            offset_counts=camera.offset_counts,
            gain_electrons_per_count=camera.gain,
            read_noise_electrons=camera.read_noise_electrons,
            saturation_counts=camera.saturation_counts,
        )
        frames.append(Frame(np.clip(counts, 0, settings.top_counts).astype(np.uint16), settings))
    return frames


if __name__ == "__main__":
    main()
