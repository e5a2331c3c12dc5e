"""A second start where planes have little diversity, and the bound of the correlation with the object."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.ndimage

from benchmarks.verdicts.objects import make_object
from lensdesign import Lens, load_design, scaled
from wavesim.fields.field import Field
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import PatchSettings
from wavesim.sensor.imaging import image
from wavesim.targets.patch import lit_patch, object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)


@pytest.mark.filterwarnings("ignore:little diversity")
def test_a_grating_that_another_start_finds_elsewhere_is_not_trusted() -> None:
    patch, _ = lit_patch(LENS, PatchSettings(patch_mm=0.05), LENS.wavelengths_um[0])
    y, x = patch.grid.y_mm[:, None] / 0.025, patch.grid.x_mm / 0.025
    grating = 0.5 + 0.5 * np.sign(np.sin(2.0 * np.pi * 9.0 * (x + 0.3 * y)))
    thing = Field(patch.grid, grating.astype(np.complex64), patch.wavelength_um)
    frames = image(LENS, thing, field_stop_mm=patch.field_stop_mm, seed=0).frames
    found = reconstruct_frames(LENS, frames, kind="amplitude", patch_mm=0.05, truth=thing)
    assert found.truth["object_correlation"] < 0.9
    assert found.verdict.within
    assert (found.verdict.explained, found.verdict.cause) == (False, "several objects"), found.verdict.words
    assert found.verdict.least_correlation is None  # planes with little diversity do not bound it


@pytest.mark.usefixtures("quick_verdicts")
def test_the_bound_contains_errors_that_no_pixel_shows(paper_lens: Lens) -> None:
    """Held-out pixels show no error of this object. Their bound alone would be 1."""
    lens = scaled(paper_lens, 1 / 48)
    letters = make_object("letters", object_patch(lens, 0.03), lens.object.numerical_aperture, 0)
    engine = {"engine": "eikonal", "error": 0.3}
    imaged = image(lens, letters, planes_mm=(0.04, 1.1), pixels=146, field_stop_mm=0.03, seed=0, **engine)
    found = reconstruct_frames(lens, imaged.frames, kind="amplitude", patch_mm=0.03, truth=letters, **engine)
    assert found.verdict.noise_correlation is not None
    assert 0.9 < found.verdict.noise_correlation < found.truth["object_correlation"] < 1.0


@pytest.mark.usefixtures("quick_verdicts")
@pytest.mark.parametrize(("blur_samples", "contrast", "has_bound"), [(1.0, 0.25, True), (0.8, 0.4, False)])
def test_the_bound_of_a_texture_holds(
    paper_lens: Lens, blur_samples: float, contrast: float, has_bound: bool
) -> None:
    """The total variation removes more of a texture than a linear estimate does, which would state 0.99."""
    lens = scaled(paper_lens, 1 / 48)
    patch = object_patch(lens, 0.03)
    random = np.random.default_rng(1 if has_bound else 2).standard_normal(patch.grid.shape)
    texture = scipy.ndimage.gaussian_filter(random, blur_samples)
    values = np.clip(0.5 + contrast * texture / texture.std(), 0.0, 1.0)
    thing = Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)
    engine = {"engine": "eikonal", "error": 0.3}
    imaged = image(lens, thing, planes_mm=(0.04, 1.1), pixels=146, field_stop_mm=0.03, seed=0, **engine)
    found = reconstruct_frames(lens, imaged.frames, kind="amplitude", patch_mm=0.03, truth=thing, **engine)
    assert found.verdict.explained
    bound = found.verdict.noise_correlation
    if has_bound:
        assert bound is not None
        assert 0.9 < bound < found.truth["object_correlation"]
    else:  # held-out pixels show that more is missing than the noise explains
        assert bound is None
