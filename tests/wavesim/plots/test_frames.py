"""Pictures of frames, and of what a result leaves of them."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.plots.frames import curves_figure, frames_figure, residual_figure
from wavesim.plots.panels import MOST_DRAWN
from wavesim.sensor.frames import Frame, FrameSettings
from wavesim.sensor.measurement import Measurement


def test_exposures_stand_beside_each_other_and_planes_below() -> None:
    settings = FrameSettings(
        pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.5, exposure=4.0, bits=12,
        offset_counts=10.0, gain_electrons_per_count=2.0,
    )  # fmt: skip
    counts = np.full((12, 10), 100, np.uint16)
    frames = [
        Frame(counts, settings.model_copy(update={"plane_distance_mm": z, "exposure": exposure}))
        for z, exposures in ((2.0, (4.0, 120.0)), (22.0, (9.0,)))
        for exposure in exposures
    ]
    shown = [a.get_title() for a in frames_figure(frames).axes if a.get_visible() and a.get_title()]
    assert shown == [
        "2 mm behind the exit vertex, exposure 1 x",
        "2 mm behind the exit vertex, exposure 30 x",
        "22 mm behind the exit vertex, exposure 1 x",
    ]
    alone = [a.get_title() for a in frames_figure(frames[1:]).axes if a.get_title()]
    assert alone == ["2 mm behind the exit vertex", "22 mm behind the exit vertex"]


@pytest.mark.parametrize("samples", [120, 2 * MOST_DRAWN])
def test_residuals_are_shown_in_standard_deviations_of_the_noise(samples: int) -> None:
    random = np.random.default_rng(3)
    sigma = np.linspace(0.5, 2.0, samples, dtype=np.float32)[None].repeat(120, axis=0)
    sigma[0, 0] = np.inf
    amplitude = np.full(sigma.shape, 10.0, np.float32)
    error = random.normal(size=sigma.shape).astype(np.float32) * np.where(np.isfinite(sigma), sigma, 9.0)
    axes, bar = residual_figure([error], [Measurement(0.0, amplitude, sigma)], [2.0], 3.2).axes
    shown = np.ma.filled(axes.images[0].get_array(), np.nan)
    assert np.isnan(shown[0, 0])
    assert np.nanstd(shown) == pytest.approx(1.0, abs=0.05)
    assert axes.images[0].get_clim() == (-4.0, 4.0)
    assert bar.get_ylabel() == "difference / standard deviation of the noise"
    share = 100.0 * np.sqrt(np.mean(sigma[1:] ** 2)) / 10.0
    assert f"noise alone: {share:.2g}" in axes.get_title()


def test_residuals_without_a_stated_noise_are_shares_of_the_light() -> None:
    error = np.full((20, 20), 0.5)
    (axes, bar) = residual_figure([error], [Measurement(0.0, np.full((20, 20), 10.0))], [2.0], 3.2).axes
    assert bar.get_ylabel() == "difference / recorded root mean square"
    assert axes.get_title().endswith("residual 5 %")


def test_a_title_is_no_wider_than_its_figure() -> None:
    title = f"a lens of a name that is as long as {'names ' * 9}are\nsecond line"
    figure = curves_figure({"misfit": ([0, 1], [2.0, 1.0], "iteration")}, title)
    figure.canvas.draw()
    (extent,) = [text.get_window_extent() for text in figure.texts]
    assert 0.0 <= extent.x0 < extent.x1 <= figure.bbox.width
    assert figure.get_suptitle().split("\n")[-1] == "second line"
