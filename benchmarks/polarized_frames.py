"""Loss of correlation where frames of polarized light are reconstructed with scalar waves.

1/32 twin of the paper's lens; an amplitude object and a phase object; a camera with noise and one without.
Frames contain the components of the field behind a lens with coatings. Reconstructions use scalar waves and
either ideal coatings or those of the design. Frames of scalar waves and ideal coatings are the reference. The
films of some lenses are 5 % thicker or thinner than the reconstruction assumes.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.scalar_light import coating_of
from benchmarks.timing import DESIGNS
from lensdesign import (
    Lens,
    SurfacePerturbation,
    launch,
    load_design,
    pupil_hexapolar,
    scaled,
    trace_polarized,
)
from wavesim import Frame, SystemState, image, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.sensor import DiversityWarning

SCALE = 1 / 32
PATCH: dict[str, Any] = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.05}
OBJECTS = {"usaf": "amplitude", "phase": "complex"}
EXPOSURES = (1.0, 30.0, 1000.0)
CAMERAS: dict[str, dict[str, Any]] = {
    "10,000 electrons, 12 bits, three exposures": {"exposures": EXPOSURES},
    "no noise, 16 bits, three exposures": {"exposures": EXPOSURES, "noise": False, "bits": 16},
}


@dataclass(frozen=True)
class Light:
    """Light and coatings of some frames, error of the films' thickness, and seed of the noise."""

    coating: str
    polarization: str
    thickness_error_percent: float = 0.0
    seed: int = 0

    @property
    def name(self) -> str:
        """Coating and thickness error, or seed."""
        if self.seed:
            return f"{self.coating}, seed {self.seed}"
        return (
            f"{self.coating} {self.thickness_error_percent:+g} %"
            if self.thickness_error_percent
            else self.coating
        )


LIGHTS = (
    Light("ideal", "scalar"),
    Light("ideal", "scalar", seed=1),
    Light("ideal", "scalar", seed=2),
    Light("ideal", "unpolarized"),
    Light("bare", "unpolarized"),
    Light("bare", "0"),
    Light("mgf2", "unpolarized"),
    Light("mgf2", "0"),
    Light("broadband", "scalar"),
    Light("broadband", "unpolarized"),
    Light("broadband", "0"),
    Light("broadband", "unpolarized", 5.0),
    Light("broadband", "unpolarized", -5.0),
)


def coated(lens: Lens, coating: str) -> Lens:
    """The lens with a coating on all surfaces."""
    return lens.with_coating(coating_of(coating, lens.wavelengths_um[0]))


def phase_rms(lens: Lens) -> float:
    """Standard deviation of the phase (rad) of the coatings over the pupil of the axis."""
    pupil = pupil_hexapolar(24).points
    wavelength = lens.wavelengths_um[0]
    jones = trace_polarized(lens, *launch(lens, [(0.0, 0.0)], pupil, wavelength), wavelength).jones
    phase = np.unwrap(np.angle(np.trace(jones, axis1=-2, axis2=-1)).ravel())
    return float(np.std(phase))


def frames_of(
    lens: Lens, thing: str, light: Light, camera: dict[str, Any]
) -> tuple[tuple[Frame, ...], Field]:
    """Frames of an object, and its transmission."""
    error = SurfacePerturbation(coating_thickness_percent=light.thickness_error_percent)
    state = SystemState(surface_perturbations={0: error, 1: error} if light.thickness_error_percent else {})
    taken = image(
        lens, thing, polarization=light.polarization, state=state, seed=light.seed, **PATCH, **camera
    )
    return taken.frames, taken.target.transmission


def correlation(lens: Lens, frames: tuple[Frame, ...], thing: str, truth: Field) -> tuple[float, float]:
    """Correlation of the object found with the true one, and the misfit of the worst plane over the noise."""
    found = reconstruct_frames(lens, frames, kind=OBJECTS[thing], truth=truth, **PATCH)
    value = found.truth["object_correlation"]
    assert value is not None
    return value, found.verdict.over_noise


def main() -> None:
    """Print the correlations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--objects", default=",".join(OBJECTS), help="objects, separated by commas")
    objects = parser.parse_args().objects.split(",")
    # The reference has the same little diversity.
    warnings.simplefilter("ignore", SamplingWarning)
    warnings.simplefilter("ignore", DiversityWarning)
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    for coating in ("ideal", "bare", "mgf2", "broadband"):
        print(
            f"{coating}: phase of the coatings {phase_rms(coated(lens, coating)):.3f} rad rms over the pupil"
        )
    for thing in objects:
        for words, camera in CAMERAS.items():
            print(f"\n{thing}, {words}: correlation (misfit over the noise)")
            print(f"{'coating':16} {'light':12} {'ideal coatings':>20} {'coatings of the design':>24}")
            for light in LIGHTS:
                if light.seed and not camera.get("noise", True):
                    continue
                began = time.perf_counter()
                design = coated(lens, light.coating)
                frames, truth = frames_of(design, thing, light, camera)
                known = [lens] if light.coating == "ideal" else [lens, design]
                found = [correlation(one, frames, thing, truth) for one in known]
                texts = [f"{value:.6f} ({misfit:6.2f})" for value, misfit in found]
                seconds = time.perf_counter() - began
                print(
                    f"{light.name:16} {light.polarization:12} {'   '.join(texts)}   {seconds:.1f} s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
