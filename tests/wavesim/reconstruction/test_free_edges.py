"""Edges of an object, which the total variation may hold in wrong places."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.verdicts.objects import make_object
from lensdesign import Lens, scaled
from wavesim import image, reconstruct_frames
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.free_edges import RIGHT_MISFIT, with_free_edges
from wavesim.reconstruction.object_solver import Reconstructed
from wavesim.targets.patch import object_patch

NOISE, PATCH_MM = 0.1, 0.03


def found(*misfits: float) -> Reconstructed:
    """Return an object of stated misfits over that of noise."""
    grid = Grid((2, 2), 1e-3, 0.0)
    misfit = tuple(NOISE * one for one in misfits)
    return Reconstructed(Field(grid, np.ones((2, 2), complex), 0.5), misfit, (), 1.0, "converged")


def test_the_better_of_both_objects_has_all_iterations() -> None:
    other = with_free_edges(lambda: found(2.0, 1.05), found(3.0, 1.07), NOISE)
    assert other.misfit == pytest.approx([NOISE * one for one in (3.0, 1.07, 2.0, 1.05)])


def test_an_object_that_fits_better_stays() -> None:
    first = found(3.0, 1.07)
    assert with_free_edges(lambda: found(2.0, 1.08), first, NOISE) is first


@pytest.mark.parametrize(
    ("misfit", "noise"), [(0.999 * RIGHT_MISFIT, NOISE), (1.07, None)], ids=["at the noise", "noise unknown"]
)
def test_nothing_is_searched_where_the_misfit_tells_nothing(misfit: float, noise: float | None) -> None:
    def search() -> Reconstructed:
        raise AssertionError

    first = found(3.0, misfit)
    assert with_free_edges(search, first, noise) is first


@pytest.mark.usefixtures("quick_verdicts")
def test_dense_strokes_come_back(paper_lens: Lens) -> None:
    """With total variation from the first iteration, the search ends at strokes in wrong places (0.59)."""
    lens = scaled(paper_lens, 1 / 48)
    text = make_object("text", object_patch(lens, PATCH_MM), lens.object.numerical_aperture, 0)
    engine = {"engine": "eikonal", "error": 0.3}
    imaged = image(lens, text, pixels=108, field_stop_mm=PATCH_MM, seed=1, **engine)
    back = reconstruct_frames(lens, imaged.frames, kind="amplitude", patch_mm=PATCH_MM, truth=text, **engine)
    assert back.truth["object_correlation"] > 0.8
