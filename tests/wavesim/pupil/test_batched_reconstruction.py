"""Batches of lenses whose path changes are polynomials: the single reconstruction, and derivatives."""

import numpy as np
import pytest

from lensdesign import Pose, scaled
from wavesim import SystemState
from wavesim.pupil import LinearisedReconstruction, Meridian
from wavesim.pupil.batched_reconstruction import TERMS, BatchedReconstruction, polynomial_terms

PATCH_MM = 0.03


@pytest.fixture(scope="module", params=["amplitude", "complex"])
def draws(request, paper_lens):
    meridian = Meridian(scaled(paper_lens, 1 / 48), (0.0, 0.008), PATCH_MM, 90.0)
    return BatchedReconstruction(LinearisedReconstruction(meridian, request.param))


def coefficients(reconstruction, state):
    """Of the polynomials that changes of path are."""
    meridian, found = reconstruction.meridian, []
    x = meridian.coordinates_mm / (0.5 * PATCH_MM)
    for plane, waves in zip(meridian.planes, meridian.waves(state), strict=True):
        row, column = np.nonzero(np.abs(plane.matrix) > 0.0)
        terms = polynomial_terms(x[column], plane.cosines[row, column])
        found.append(np.linalg.lstsq(terms, waves[row, column], rcond=None)[0])
    return np.concatenate(found)


@pytest.fixture(scope="module")
def cases():
    return [
        SystemState(pose) for pose in (Pose(decenter_y_mm=2e-3), Pose(tilt_x_deg=0.5), Pose(despace_mm=1e-3))
    ]


def test_correlations_are_those_of_the_chain(draws, cases):
    reconstruction = draws.reconstruction
    own, _ = draws.correlations(np.array([coefficients(reconstruction, case) for case in cases]))
    expected = [np.mean(reconstruction.correlations(reconstruction.meridian.waves(case))) for case in cases]
    assert 1.0 - np.array(expected) == pytest.approx(1.0 - own, rel=2e-3, abs=2e-6)


def test_derivatives_are_those_of_differences(draws, cases):
    middle = np.array([coefficients(draws.reconstruction, cases[0])])
    step = 1e-3 * np.random.default_rng(3).standard_normal(middle.shape) * np.abs(middle)
    ends = [draws.correlations(middle + sign * step)[0] for sign in (1.0, -1.0)]
    _, by = draws.correlations(middle, derivatives=True)
    assert 0.5 * (ends[0] - ends[1]) == pytest.approx(np.sum(by * step, axis=1), rel=0.03)


def test_what_intensities_see_is_the_chains(draws, cases):
    own = coefficients(draws.reconstruction, cases[1])
    seen = draws.reconstruction.visible(draws.reconstruction.meridian.waves(cases[1]))
    assert own @ draws.visible @ own == pytest.approx(np.sum(seen**2), rel=1e-3)


def test_a_few_fans_make_the_same_elements(paper_lens):
    """Of the lens at its own size, whose path grows by thousands of waves along the line."""
    whole, few = (Meridian(paper_lens, (0.0, 1.0), PATCH_MM, 90.0, fans=fans) for fans in (0, 9))
    for one, other in zip(whole.planes, few.planes, strict=True):
        assert np.linalg.norm(one.matrix - other.matrix) < 0.05 * np.linalg.norm(one.matrix)
        assert np.mean((one.matrix != 0.0) != (other.matrix != 0.0)) < 5e-3


def test_terms_follow_the_order_of_the_meridian():
    assert polynomial_terms(np.array([2.0]), np.array([3.0])).shape == (1, TERMS)
    assert polynomial_terms(np.array([2.0]), np.array([3.0]))[0, :5].tolist() == [1.0, 2.0, 4.0, 8.0, 3.0]
