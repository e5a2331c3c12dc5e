"""Amplitude objects whose search stagnates are found with a growing aperture."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Lens, scaled
from wavesim import image, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.reconstruction.growing_aperture import STAGES, aperture_stages
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import Patch, object_patch

PATCH_MM = 0.03


def bright_bars(patch: Patch, seed: int) -> Field:
    """Eight bright bars at random places on a dark ground."""
    rng = np.random.default_rng(seed)
    side = patch.grid.shape[0]
    values = np.zeros(patch.grid.shape, np.complex64)
    for _ in range(8):
        row, column = rng.integers(side // 5, 4 * side // 5, 2)
        width = rng.integers(2, 5)
        across = slice(-(width // 2), width - width // 2)
        if rng.random() < 0.5:
            values[row + across.start : row + across.stop, column - 6 : column + 6] = 1.0
        else:
            values[row - 6 : row + 6, column + across.start : column + across.stop] = 1.0
    return Field(patch.grid, values, patch.wavelength_um)


@pytest.mark.usefixtures("quick_verdicts")
def test_bright_bars_on_a_dark_ground_are_found(paper_lens: Lens) -> None:
    """A search from a transmission of 1 ends at an object that has nothing to do with the bars."""
    lens = scaled(paper_lens, 1 / 48)
    bars = bright_bars(object_patch(lens, PATCH_MM), seed=0)
    engine = {"engine": "eikonal", "error": 0.3}
    imaged = image(
        lens, bars, pixels=108, field_stop_mm=PATCH_MM, exposures=(1.0, 30.0, 1000.0), seed=1, **engine
    )
    found = reconstruct_frames(lens, imaged.frames, kind="amplitude", patch_mm=PATCH_MM, truth=bars, **engine)
    assert found.verdict.explained
    correlation = found.truth["object_correlation"]
    assert correlation is not None
    assert correlation > 0.99


@given(
    shape=st.tuples(st.integers(8, 60), st.integers(8, 60)),
    centre=st.tuples(st.floats(0.2, 0.8), st.floats(0.2, 0.8)),
)
def test_stages_add_pixels_around_the_light(shape: tuple[int, int], centre: tuple[float, float]) -> None:
    rows, columns = (np.arange(count) - part * count for count, part in zip(shape, centre, strict=True))
    amplitude = np.exp(-0.2 * (rows[:, None] ** 2 + columns**2))
    sigma = np.full(shape, 0.1, np.float32)
    sigma[0, 0] = np.inf
    stages = [planes[0] for planes in aperture_stages([Measurement(0.0, amplitude, sigma)])]
    assert len(stages) == STAGES
    known = np.array([np.isfinite(stage.sigma) for stage in stages if stage.sigma is not None])
    assert not known[:, 0, 0].any()
    assert np.all(known[1:] >= known[:-1])
    brightest = np.unravel_index(np.argmax(amplitude), shape)
    assert known[-1][brightest]
    assert known[-1].sum() > 2 * known[0].sum()
    assert all(stage.amplitude is amplitude for stage in stages)
