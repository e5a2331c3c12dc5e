"""Objects on a line, and what is found of them."""

import numpy as np
import pytest

from tolerancing.merits.reconstruction.objects import LineObject, required_length_mm, set_centres_mm
from wavesim.fields.field import Grid

GRID = Grid((140,), 0.05 / 140, -13.5)


def lines(kind="lines", widths=(0.775, 1.55)):
    return LineObject(kind, widths, GRID, 0.5, 0.532)


@pytest.mark.parametrize("kind", ["lines", "amplitude", "complex"])
def test_what_is_found_whole_loses_nothing(kind):
    one = lines(kind)
    scores = one.score(one.transmission)
    assert scores.correlation == pytest.approx(1.0, abs=1e-9)
    assert scores.shift_um == 0.0
    assert one.is_complex == bool(np.any(one.transmission.imag))


def test_sharp_lines_have_nearly_full_contrast():
    assert min(lines().score(lines().transmission).contrasts) > 0.97


def test_bars_cover_what_they_are_wide():
    opaque_mm = GRID.pitch_mm * float(np.sum(1.0 - lines().transmission.real))
    assert opaque_mm == pytest.approx(5e-3 * (0.775 + 1.55), rel=1e-9)


def test_what_lies_beside_its_place_is_registered():
    one = lines()
    scores = one.score(np.roll(one.transmission, 3))
    assert scores.shift_um == pytest.approx(3e3 * GRID.pitch_mm, abs=0.05)
    assert scores.correlation > 0.99
    assert min(scores.contrasts) > 0.97


def test_contrast_is_that_of_intensities_and_turns_negative():
    one = lines()
    grey = one.score(0.5 + 0.5 * one.transmission)
    assert grey.contrasts == pytest.approx([(1 - 0.25) / (1 + 0.25)] * 2, abs=0.06)
    assert max(one.score(1.0 - one.transmission).contrasts) < -0.9
    assert one.score(np.ones(140, complex)).contrasts == pytest.approx([0.0, 0.0], abs=1e-9)
    assert one.score(np.ones(140, complex)).correlation == 0.0


def test_sets_lie_side_by_side_about_the_middle():
    first, second = set_centres_mm((1.0, 2.0))
    assert second - first == pytest.approx(1e-3 * (4.5 + 4 * 2.0 + 9.0))
    assert required_length_mm((1.0, 2.0)) == pytest.approx(1e-3 * (27.0 + 8.0 + 12.0))
