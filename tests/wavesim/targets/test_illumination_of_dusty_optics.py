"""Light through dusty optics: frames without an object tell it, and objects are found in it.

The light is made here, by angular spectra over samples of its own, and not by the propagators under test.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.fft
from numpy.typing import NDArray
from quick_verdicts import judge_quickly

from lensdesign import load_design, scaled
from lensdesign.lens.lens import Lens
from wavesim import image
from wavesim.fields.files import write_field
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import ReconstructionSettings
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import Imaged

WAVELENGTH_UM, PITCH_UM, SAMPLES = 0.532, 0.1, 640
DUST = ((150.0, -6.0, 5.0, 3.0, 1.2), (60.0, 7.0, -8.0, 2.2, 0.9), (0.0, 3.0, 8.0, 4.0, 0.6))
"""Distance in front of the object, x, y and width in um, and phase in rad of each bump."""


def dusty_light() -> NDArray[np.complex128]:
    at = PITCH_UM * (np.arange(SAMPLES) - SAMPLES // 2)
    x, y = np.meshgrid(at, at)
    cycles = scipy.fft.fftfreq(SAMPLES, PITCH_UM)
    along = np.sqrt(np.maximum(WAVELENGTH_UM**-2 - cycles**2 - cycles[:, None] ** 2, 0.0)) - 1 / WAVELENGTH_UM
    light, place = np.ones((SAMPLES, SAMPLES), complex), DUST[0][0]
    for distance, x0, y0, width, phase in DUST:
        light = scipy.fft.ifft2(scipy.fft.fft2(light) * np.exp(2j * np.pi * along * (place - distance)))
        light *= np.exp(1j * phase * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / width**2))
        place = distance
    return light


@pytest.fixture(scope="module")
def lens() -> Lens:
    return scaled(load_design("designs/paper_singlet.toml"), 1 / 48)


@pytest.fixture(scope="module")
def light_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("light") / "dusty.npz"
    np.savez(path, values=dusty_light(), pitch_um=PITCH_UM, wavelength_um=WAVELENGTH_UM)
    return path


def imaged(lens: Lens, thing: str, light_file: Path) -> Imaged:
    return image(
        lens, thing, patch_mm=0.04, exposures=(1.0, 30.0), engine="eikonal", error=0.1,
        illumination=str(light_file),
    )  # fmt: skip


def found(lens: Lens, frames: tuple[Frame, ...], **changes: Any) -> FoundObject:
    settings = ReconstructionSettings(patch_mm=0.04, error=0.1, **changes)
    with pytest.warns(UserWarning, match="little diversity"):
        return reconstruct_frames(lens, frames, settings)


def test_frames_without_an_object_tell_the_light_of_dusty_optics(
    lens: Lens, light_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge_quickly(monkeypatch)
    star = imaged(lens, "star", light_file)
    empty = found(lens, imaged(lens, "empty", light_file).frames, kind="complex")
    assert empty.verdict.explained
    write_field(empty.transmission, tmp_path / "light.npz")

    def outcome(**changes: Any) -> tuple[float, float]:
        result = found(lens, star.frames, kind="amplitude", **changes)
        true = np.asarray(star.target.transmission.values)[result.inside]
        values = np.asarray(result.transmission.values)[result.inside]
        together = abs(np.vdot(true, values)) / np.linalg.norm(true) / np.linalg.norm(values)
        return float(together), result.verdict.over_noise or np.inf

    uniform, in_dust = outcome(), outcome(illumination=str(tmp_path / "light.npz"))
    assert uniform[0] < 0.995
    assert uniform[1] > 2.0
    assert in_dust[0] > 0.998
    assert in_dust[1] < 1.2
