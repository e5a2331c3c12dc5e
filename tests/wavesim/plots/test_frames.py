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


def bright_square(rows: slice, columns: slice) -> Frame:
    """A frame that is dark, with noise, but for a square."""
    settings = FrameSettings(
        pixel_pitch_um=3.2, plane_distance_mm=2.0, wavelength_um=0.5, exposure=1.0, bits=12,
        offset_counts=10.0, gain_electrons_per_count=2.0, read_noise_electrons=2.0,
    )  # fmt: skip
    counts = np.random.default_rng(1).normal(10.0, 1.0, (400, 500))
    counts[rows, columns] += 1000.0
    return Frame(np.rint(counts).astype(np.uint16), settings)


def test_frames_show_the_light_and_the_whole_frame_in_a_corner() -> None:
    frames = [
        bright_square(slice(180, 240), slice(200, 290)),
        bright_square(slice(150, 240), slice(220, 260)),
    ]
    figure = frames_figure(frames)
    picture = figure.axes[0]
    rows, columns = picture.images[0].get_array().shape
    # 150 to 240 and 200 to 290, with a twentieth of the frame on each side.
    assert rows == pytest.approx(90 + 40, abs=3)
    assert columns == pytest.approx(90 + 50, abs=3)
    (corner,) = picture.child_axes
    assert corner.images[0].get_array().shape == (400, 500)
    (outline,) = corner.patches
    assert (outline.get_width(), outline.get_height()) == (columns, rows)


@pytest.mark.parametrize(("rows", "columns"), [(slice(10, 390), slice(10, 490)), (slice(0, 0), slice(0, 0))])
def test_frames_full_of_light_or_without_any_are_shown_whole(rows: slice, columns: slice) -> None:
    picture = frames_figure([bright_square(rows, columns)]).axes[0]
    assert picture.images[0].get_array().shape == (400, 500)
    assert not picture.child_axes


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
