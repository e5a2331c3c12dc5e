"""A displaced result: its displacement is found, stated, and kept apart from what is wrong in it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft
from scipy.ndimage import gaussian_filter

from lensdesign import load_design, scaled
from wavesim.fields.field import Field
from wavesim.metrics.displacement import displaced_back, displacement_changes, displacement_samples
from wavesim.metrics.result_quality import truth_metrics
from wavesim.runtime.scratch import Scratch
from wavesim.sensor.windows import exit_scene
from wavesim.targets.patch import PatchSettings, lit, object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
PATCH = object_patch(LENS, 0.03)
LIGHT = lit(PATCH, PatchSettings())


def an_object(kind: str, seed: int = 1) -> np.ndarray:
    random = np.random.default_rng(seed)
    one, other = (gaussian_filter(random.standard_normal(PATCH.grid.shape), 2.0) for _ in range(2))
    if kind == "amplitude":
        return np.where(one > one.std(), 0.1, 1.0).astype(complex)
    return np.exp(1j * (0.3 if kind == "thin" else 1.2) * other / other.std())


def displaced(values: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    moved = values.astype(complex)
    displaced_back(moved, (-shift[0], -shift[1]))
    return moved


def judged(found: np.ndarray, true: np.ndarray) -> dict[str, float | None]:
    sensor = LENS.sensor
    scene = exit_scene(LENS, PATCH, sensor, min(sensor.plane_distances_mm))
    fields = (Field(PATCH.grid, one.astype(np.complex64), PATCH.wavelength_um) for one in (found, true))
    return truth_metrics(*fields, LIGHT, PATCH.inside, scene, Scratch())


@pytest.mark.parametrize("kind", ["amplitude", "thin", "complex"])
@pytest.mark.parametrize("shift", [(0.3, 0.0), (1.0, -1.0), (-2.0, 0.4), (0.0, 5.0)])
def test_a_displacement_is_stated_and_taken_back(kind, shift) -> None:
    true = an_object(kind)
    figures = judged(displaced(true, shift), true)
    pitch_um = 1e3 * PATCH.grid.pitch_mm
    place = (figures["displacement_x_um"], figures["displacement_y_um"])
    assert np.divide(place, pitch_um) == pytest.approx(shift, abs=0.06)
    assert figures["correlation_registered"] > 0.99
    if max(map(abs, shift)) >= 2.0:
        assert figures["object_correlation"] < 0.8


def test_a_result_in_place_is_said_to_be() -> None:
    true = an_object("complex")
    random = np.random.default_rng(5)
    figures = judged(true + 0.2 * random.standard_normal(true.shape), true)
    assert abs(figures["displacement_x_um"]) < 0.03
    assert figures["correlation_registered"] == pytest.approx(figures["object_correlation"], abs=1e-3)


def test_what_has_nothing_in_common_has_no_displacement() -> None:
    figures = judged(an_object("complex", 3), an_object("complex"))
    assert figures["displacement_x_um"] is None
    assert figures["displacement_y_um"] is None
    assert figures["correlation_registered"] is None
    even = np.ones(PATCH.grid.shape)
    assert judged(even, even)["displacement_x_um"] is None


def test_other_figures_do_not_change() -> None:
    """The result is displaced in place to be compared, and lies where it did afterwards."""
    true = an_object("complex")
    found = displaced(true, (1.3, 0.2))
    before = found.copy()
    figures = judged(found, true)
    assert np.array_equal(found, before)
    assert figures["ssim"] < 0.95
    assert figures["psnr_db"] < 30.0


def test_the_middle_of_a_large_field_tells() -> None:
    random = np.random.default_rng(2)
    true = gaussian_filter(random.standard_normal((900, 700)), 2.0) + 0.0j
    spectrum = scipy.fft.fft2(true)
    turns = (scipy.fft.fftfreq(count) * s for count, s in zip(true.shape, (-2.6, 3.2), strict=True))
    down, across = (np.exp(-2j * np.pi * turn) for turn in turns)
    moved = scipy.fft.ifft2(spectrum * down[:, None] * across)
    found = displacement_samples(moved, true, np.ones(true.shape, bool))
    assert found == pytest.approx((3.2, -2.6), abs=0.03)


def test_changes_with_displacement_are_derivatives_and_their_laplacians() -> None:
    """Those of a Gaussian, in closed form, and of a cosine that meets the edge as in a mirror."""
    y, x = np.mgrid[:40, :50]
    width, dy, dx = 3.0, y - 18.0, x - 26.0
    spot = np.exp(-(dx**2 + dy**2) / (2.0 * width**2))
    along_x, along_y, second_x, second_y = displacement_changes(spot, orders=2)
    assert along_x == pytest.approx(dx / width**2 * spot, abs=1e-6)
    assert along_y == pytest.approx(dy / width**2 * spot, abs=1e-6)
    factor = (dx**2 + dy**2 - 4.0 * width**2) / width**4
    assert second_x == pytest.approx(factor * along_x, abs=1e-6)
    assert second_y == pytest.approx(factor * along_y, abs=1e-6)
    angle = np.pi * 3.0 / 50.0
    wave = np.broadcast_to(np.cos(angle * (np.arange(50) + 0.5)), (40, 50)) * (1.0 - 2.0j)
    along_x, along_y = displacement_changes(wave)
    assert along_x[7] == pytest.approx(angle * np.sin(angle * (np.arange(50) + 0.5)) * (1.0 - 2.0j), abs=1e-9)
    assert along_y == pytest.approx(np.zeros((40, 50)), abs=1e-9)
