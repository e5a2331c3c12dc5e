"""Frames behind a cover glass: reconstructed with the design of the glass, and with one that lacks it."""

from __future__ import annotations

import warnings

import pytest

from lensdesign import CoverGlass, DesignError, Lens, scaled
from wavesim import Frame, SamplingWarning
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.sensor.imaging import Imaged, image

SETTINGS = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.3}


@pytest.fixture(scope="module")
def bare(paper_lens: Lens) -> Lens:
    lens = scaled(paper_lens, 1 / 32)
    return lens.replaced(sensor=lens.sensor.replaced(plane_distances_mm=(1.2, 2.2)))


@pytest.fixture(scope="module")
def covered(bare: Lens) -> Lens:
    glass = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.3)
    return bare.replaced(sensor=bare.sensor.replaced(cover_glass=glass))


@pytest.fixture(scope="module")
def imaged(covered: Lens) -> Imaged:
    return image(covered, seed=1, exposures=(1.0, 30.0), **SETTINGS)


def correlation_with(lens: Lens, imaged: Imaged) -> tuple[float, float]:
    """Return the correlation with the true object, and the final misfit."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        found = reconstruct_frames(
            lens,
            imaged.frames,
            kind="amplitude",
            iterations=12,
            truth=imaged.target.transmission,
            **SETTINGS,
        )
    correlation = found.truth["object_correlation"]
    assert correlation is not None
    return correlation, found.curve[-1]


@pytest.mark.usefixtures("quick_verdicts")
def test_the_design_must_have_the_glass_of_the_frames(bare: Lens, covered: Lens, imaged: Imaged) -> None:
    correlation, misfit = correlation_with(covered, imaged)
    assert correlation > 0.98
    without, large = correlation_with(bare, imaged)
    assert without < 0.5
    assert large > 2.0 * misfit


def test_planes_in_front_of_which_the_glass_does_not_fit_are_refused(covered: Lens, imaged: Imaged) -> None:
    with pytest.raises(DesignError, match=r"recording plane lies only 0\.9 mm"):
        image(covered, planes_mm=(0.9, 2.2), **SETTINGS)
    frames = [
        Frame(one.counts, one.settings.replaced(plane_distance_mm=one.settings.plane_distance_mm - 0.3))
        for one in imaged.frames
    ]
    with pytest.raises(DesignError, match=r"recording plane lies only 0\.9 mm"):
        reconstruct_frames(covered, frames, kind="amplitude", **SETTINGS)
