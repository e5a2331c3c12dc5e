"""Objects from one exposure with the lenses that are designed for it, at their own size.

Each lens of `LENSES` records one frame on one plane with one exposure: 12 bits, a full well of 10,000
electrons, 2 electrons of read noise. A diffuser lights the object, so that the light fills the sensor evenly.
The lens is mounted with errors. The frame is made with a finer engine than that of the reconstruction, and on
pixels of a third of the pitch whose means are taken and to which noise of its own is added. The mounting is
calibrated once, from one frame of a known chart, and the object is then reconstructed from its one exposure.
The exposure alone cannot tell a decentered lens from a phase ramp of a complex object.

    python -m benchmarks.single_exposure_lenses                    all lenses
    python -m benchmarks.single_exposure_lenses phase --scale 0.5  one of them, as a twin of half its size
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent_frames import independent_frames
from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import Lens, load_design, scaled
from lensdesign.analysis.oversampling import ObjectKind, oversampling_of
from wavesim import Frame, calibrate_frames, image, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.metrics import object_correlation
from wavesim.reconstruction.found_object import FoundObject
from wavesim.scene.settings import Kind, PatchSettings
from wavesim.targets.patch import lit_patch, make_target
from wavesim.targets.patterns import band_limit

MOUNTING = {"decenter_x_mm": 0.003, "decenter_y_mm": -0.002, "tilt_x_deg": 0.03, "despace_mm": 0.002}
"""Errors of the mounted lens."""

SUBPIXELS = 3
"""Points of the frame's own model along each side of a pixel."""

SPECTRUM = 0.16
"""Frequency at which the power of an object's details has fallen to 1/e, over that of the aperture.

With this value 83 % of the power lies below a fifth of the highest frequency, as in the dense objects of the
other benchmarks.
"""

FINE_ERROR, ENGINE_ERROR = 0.015, 0.03
"""Largest predicted error of the engine that makes the frame, and of the one that reconstructs."""


@dataclass(frozen=True)
class Case:
    """A lens, the object that it records, and how the object is reconstructed.

    Attributes
    ----------
    design
        Name of the design.
    counted
        Kind of the object in the oversampling ratio.
    kind
        Kind of the object in the reconstruction.
    amplitude_rms, phase_rms_rad
        Variation of the object's amplitude about 0.56, or none, and of its phase.
    speckle_na
        Numerical aperture of the diffuser that lights the object; None for a plane wave.
    """

    design: str
    counted: ObjectKind
    kind: Kind
    amplitude_rms: float
    phase_rms_rad: float
    speckle_na: float | None = None

    @property
    def light(self) -> dict[str, Any]:
        """Settings of the illumination."""
        if self.speckle_na is None:
            return {}
        return {"illumination": "speckle", "speckle_na": self.speckle_na}


LENSES = {
    "complex": Case("single_complex", "complex", "complex", 0.24, 0.8, 0.24),
    "phase": Case("single_phase", "phase", "phase", 0.0, 1.0, 0.24),
}


def dense_object(lens: Lens, case: Case, seed: int) -> Field:
    """Return an object with amplitude and phase everywhere: two random fields with a Gaussian spectrum.

    Its power falls to 1/e at `SPECTRUM` of the highest frequency that the aperture passes.
    """
    patch, _ = lit_patch(lens, PatchSettings(patch_mm=lens.object.field_diameter_mm))
    grid, rng = patch.grid, np.random.default_rng(seed)
    fx, fy = (np.fft.fftfreq(count, grid.pitch_mm) for count in grid.shape[::-1])
    cutoff_per_mm = lens.object.numerical_aperture / (1e-3 * patch.wavelength_um)
    low = np.exp(-0.5 * (fx[None, :] ** 2 + fy[:, None] ** 2) / (SPECTRUM * cutoff_per_mm) ** 2)

    def smooth() -> NDArray[np.float64]:
        values = np.fft.ifft2(np.fft.fft2(rng.standard_normal(grid.shape)) * low).real
        return np.asarray(values / values.std())

    amplitude = np.clip(0.56 + case.amplitude_rms * smooth(), 0.05, 1.0) if case.amplitude_rms else 1.0
    values = amplitude * np.exp(1j * case.phase_rms_rad * smooth())
    return Field(grid, values.astype(complex), patch.wavelength_um)


def known_chart(lens: Lens) -> Field:
    """Return the transmission of the chart by which the mounting is calibrated, a Siemens star."""
    patch, _ = lit_patch(lens, PatchSettings(patch_mm=lens.object.field_diameter_mm))
    return make_target(patch, "star", numerical_aperture=lens.object.numerical_aperture).transmission


def recorded_frame(lens: Lens, transmission: Field, light: dict[str, Any], seed: int) -> Frame:
    """Return the one frame of an object behind the lens as mounted, by a model of its own."""
    sensor = lens.sensor
    fine = lens.replaced(
        sensor=sensor.replaced(
            pixel_pitch_um=sensor.pixel_pitch_um / SUBPIXELS,
            pixels=tuple(SUBPIXELS * count for count in sensor.pixels),
        )
    )
    taken = image(
        fine,
        transmission,
        field_stop_mm=lens.object.field_diameter_mm,
        pixels="all",
        noise=False,
        bits=16,
        engine="eikonal",
        error=FINE_ERROR,
        **MOUNTING,
        **light,
    ).frames[0]
    rows, columns = (count // SUBPIXELS for count in taken.counts.shape)
    bright = (taken.counts - taken.settings.offset_counts).reshape(rows, SUBPIXELS, columns, SUBPIXELS)
    intensity = bright.mean(axis=(1, 3))
    planes_mm = sensor.plane_distances_mm[:1]
    brightest_is_1 = intensity / intensity.max()
    (frame,) = independent_frames(lens, transmission.wavelength_um, planes_mm, [brightest_is_1], seed=seed)
    return frame


def measured(case: Case, scale: float = 1.0, seed: int = 5) -> list[Row]:
    """Calibrate the bench, record one object on it and reconstruct it; return the figures."""
    lens = load_design(DESIGNS / f"{case.design}.toml")
    lens = lens if scale == 1.0 else scaled(lens, scale)
    field_mm = lens.object.field_diameter_mm
    true, chart = dense_object(lens, case, seed), known_chart(lens)
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame, chart_frame = (recorded_frame(lens, one, case.light, seed) for one in (true, chart))
        settings: dict[str, Any] = {"patch_mm": field_mm, "field_stop_mm": field_mm}
        settings |= {"engine": "eikonal", "error": ENGINE_ERROR} | case.light
        state = calibrate_frames(lens, (chart_frame,), known=chart, **settings).state
        settings["kind"] = case.kind
        found = reconstruct_frames(lens, (frame,), truth=true, calibration=state, **settings)
    print(f"verdict: {found.verdict.words}")
    return [
        Row("oversampling ratio of the frame", oversampling_of(lens, case.counted).ratio),
        Row("mean electrons of a pixel", _mean_electrons(frame)),
        Row(
            "correlation in the light of the diffuser",
            found.truth["object_correlation"] or 0.0,
            at_least=0.98,
        ),
        Row("correlation in even light", in_even_light(lens, found, true), at_least=0.98),
        Row("misfit over noise", found.verdict.over_noise, at_most=1.1),
        Row("misfit over noise, held-out pixels", found.verdict.held_out_over_noise, at_most=1.1),
        Row("duration", time.perf_counter() - begun, "s"),
    ]


def in_even_light(lens: Lens, found: FoundObject, true: Field) -> float:
    """Return the correlation of the objects in a plane wave, which favours no part of the object."""
    grid, aperture = true.grid, lens.object.numerical_aperture
    x, y = grid.x_mm[None, :], grid.y_mm[:, None]
    stop = np.hypot(x, y) <= 0.5 * lens.object.field_diameter_mm

    def passed(values: Any) -> Field:
        limited = band_limit(values * stop, grid, true.wavelength_um, aperture)
        return Field(grid, limited.astype(complex), true.wavelength_um)

    return object_correlation(
        passed(found.transmission.values), passed(true.values), passed(np.ones(grid.shape)), stop
    )


def _mean_electrons(frame: Frame) -> float:
    settings = frame.settings
    return float(frame.counts.mean() - settings.offset_counts) * settings.gain_electrons_per_count


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lenses", nargs="*", choices=[[], *LENSES], help="default: all")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the lens over that of its design")
    given = parser.parse_args()
    for name in given.lenses or LENSES:
        case = LENSES[name]
        print_table(
            f"{case.design} at {given.scale:g} of its size: one exposure", measured(case, given.scale)
        )


if __name__ == "__main__":
    main()
