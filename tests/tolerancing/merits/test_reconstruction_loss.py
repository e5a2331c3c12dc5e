"""The expected loss as a merit: what it forgives, what compensators take, and the whole chain beside it."""

import warnings

import numpy as np
import pytest

from benchmarks.merits_and_chain.chain import Chain, thing
from lensdesign.errors import DesignError
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter

PATCH_MM = 0.05


def merit(kind="reconstruction_loss", **keys):
    own = {"patch_mm": PATCH_MM} if kind == "reconstruction_loss" else {}
    return merit_from_table({"kind": kind, "at_most": 0.05} | own | keys, "here")


def batch_of(*perturbations):
    """One perturbation a trial."""
    parameters = tuple(PerturbedParameter(target=t, parameter=p) for t, p, _ in perturbations)
    return PerturbationBatch(parameters, np.diag([value for *_, value in perturbations]))


@pytest.fixture(scope="module")
def sampling(twin):
    return Sampling(plane_distance_mm=twin.sensor.plane_distances_mm[0])


@pytest.fixture(scope="module")
def context(twin, sampling):
    return Context(twin, sampling)


TOLD = (
    ("sensor", "tilt_x_deg", 1.0),
    ("surface 2", "radius_percent", 1.0),
    ("sensor", "decenter_x_mm", 2.5e-3),
)


def test_losses_are_those_of_the_whole_chain(twin, context):
    """Of frames with noise, reconstructed as if all were nominal."""
    batch = batch_of(*TOLD)
    losses = merit(patch_mm=0.04).scores(context, batch)
    chain = Chain(twin, (0.0, 0.0), 0.04, "amplitude")
    true, found = thing(chain), []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number, system in enumerate(context.states(batch, None)):
            back, _ = chain.found(chain.recorded(system, true, number))
            found.append(chain.correlation(back, true))
    assert losses[0] < 1e-3 < losses[1] < 0.05 < losses[2]
    assert min(found[:2]) > 0.97 > 0.85 > found[2]


def test_compensators_take_up_what_the_mounting_does(twin, sampling, context):
    """All of a decenter, and next to nothing of a figure that no mounting makes."""
    batch = batch_of(
        ("lens", "decenter_x_mm", 3e-3), ("object", "decenter_x_mm", 2e-3), ("surface 2", "conic", 0.1)
    )
    plain = merit().scores(context, batch)
    names = (("lens", "decenter_x_mm", 0.02), ("object", "decenter_x_mm", 0.02), ("lens", "tilt_y_deg", 5.0))
    compensators = tuple(Compensator(target=t, parameter=p, limit=limit) for t, p, limit in names)
    adapted = Context(twin, sampling, compensators)
    left = merit().scores(adapted, batch)
    assert np.all(plain > 0.01)
    assert np.all(left[:2] < 1e-3)
    assert left[2] > 0.5 * plain[2]
    assert merit().uncompensated(adapted, batch).tolist() == plain.tolist()
    assert merit().is_compensated(compensators=True)
    assert not merit().is_compensated(compensators=False)


def test_the_worst_of_several_field_points_counts(context):
    batch = batch_of(("lens", "decenter_y_mm", 2e-3))
    points = [[0.0, 0.0], [0.0, 0.008]]
    alone = [merit(field_mm=point, patch_mm=0.03).scores(context, batch) for point in points]
    together = merit(field_points_mm=points, patch_mm=0.03).scores(context, batch)
    assert together.tolist() == np.max(alone, axis=0).tolist()


def test_words_tell_what_was_asked_for():
    predicted = merit(object="complex", planes_mm=[0.05, 0.2]).meaning
    assert "A complex object, a field stop of 0.05 mm, planes at 0.05, 0.2 mm" in predicted


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"object": "real"}, "object = 'real'"),
        ({"patch_mm": -1.0}, "patch_mm = -1.0"),
        ({"level": "wave"}, "level = 'wave': allowed: auto, pupil"),
    ],
)
def test_faulty_values_are_refused(keys, message):
    with pytest.raises(DesignError, match=message):
        merit(**keys)


def test_a_patch_wider_than_the_field_is_refused(twin):
    with pytest.raises(ValueError, match=r"patch_mm = 0\.2.*up to 0\.0625 mm"):
        merit(patch_mm=0.2).check(twin)
