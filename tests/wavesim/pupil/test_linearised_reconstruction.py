"""The expected loss of a reconstruction: what costs nothing, and what does."""

import numpy as np
import pytest

from lensdesign import Pose, scaled
from lensdesign.errors import InputError
from wavesim import SystemState
from wavesim.pupil import LinearisedReconstruction, Meridian, expected_loss


@pytest.fixture(scope="module")
def meridians(paper_lens):
    twin = scaled(paper_lens, 1 / 48)
    return [Meridian(twin, (0.0, 0.0), 0.04, azimuth) for azimuth in (0.0, 90.0)]


@pytest.fixture(scope="module", params=["amplitude", "complex"])
def models(request, meridians):
    return [LinearisedReconstruction(meridian, request.param) for meridian in meridians]


def loss(models, state):
    return expected_loss(models, [one.meridian.waves(state) for one in models])


def test_nothing_perturbed_loses_nothing(models):
    assert loss(models, SystemState()) == pytest.approx(0.0, abs=1e-6)


def test_phase_of_the_sensor_point_alone_loses_nothing(models):
    """Whatever multiplies the field on a plane by a phase leaves its intensities."""
    waves = []
    for model in models:
        random = np.random.default_rng(1)
        waves.append(
            [np.tile(random.random((len(p.matrix), 1)), p.matrix.shape[1]) for p in model.meridian.planes]
        )
        assert np.linalg.norm(model.visible(waves[-1])) < 1e-9 * np.linalg.norm(np.concatenate(waves[-1]))
    assert expected_loss(models, waves) == pytest.approx(0.0, abs=1e-9)


def test_both_azimuths_are_alike_on_the_axis(models):
    across = loss(models, SystemState(Pose(decenter_x_mm=2e-3)))
    assert 0.005 < across < 1.0
    assert loss(models, SystemState(Pose(decenter_y_mm=2e-3))) == pytest.approx(across, rel=1e-3)
    assert loss(models, SystemState(Pose(decenter_y_mm=-2e-3))) == pytest.approx(across, rel=0.25)


def test_more_of_it_loses_more(models):
    losses = [loss(models, SystemState(sensor_shift_mm=(size, 0.0, 0.0))) for size in (2e-4, 1e-3, 3e-3)]
    assert losses[0] < 0.02 < losses[1] < losses[2] < 1.0


def test_what_is_found_explains_the_amplitudes_that_an_object_changes(meridians):
    """The linear solution, without noise to speak of, gives back a small change of the object itself."""
    model = LinearisedReconstruction(meridians[0], "amplitude", electrons=1e9)
    x = meridians[0].coordinates_mm
    change = 1e-3 * np.exp(-((x / 2e-3) ** 2))
    matrix = np.concatenate([plane.matrix for plane in meridians[0].planes])
    before = model.objects[:, 0]
    found = model.solutions[0] @ (np.abs(matrix @ (before + change)) - np.abs(matrix @ before))
    off, whole = model.passed @ (found - change), model.passed @ before
    # The scale is free: a share of the whole object may be missing.
    off -= np.vdot(whole, off) / np.vdot(whole, whole) * whole
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(change)


@pytest.mark.parametrize(("keys", "message"), [({"kind": "real"}, "kind"), ({"electrons": 0.0}, "electrons")])
def test_faulty_values_are_refused(meridians, keys, message):
    with pytest.raises(InputError, match=message):
        LinearisedReconstruction(meridians[0], **keys)


def test_no_meridian_is_refused():
    with pytest.raises(InputError, match="one meridian at least"):
        expected_loss([], [])
