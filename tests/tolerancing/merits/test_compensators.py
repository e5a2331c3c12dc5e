"""Compensators: what a model that adapts can take back, and what its bounds leave."""

import numpy as np
import pytest

from lensdesign import DesignError, InputError
from lensdesign.common.toml_files import validate
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter

AXIS, OFF_AXIS = ((0.0, 0.0), None), ((0.0, 1.2), None)
SAMPLING = Sampling(pupil_samples=64)


def compensator(parameter, limit, target="lens"):
    return Compensator(target=target, parameter=parameter, limit=limit)


def lens_batch(**columns):
    parameters = tuple(PerturbedParameter(target="lens", parameter=name) for name in columns)
    return PerturbationBatch(parameters, np.column_stack(list(columns.values())))


def rms(**keys):
    return merit_from_table({"kind": "rms_waves", "at_most": 0.1} | keys, "here")


def test_a_decentered_lens_is_found_and_taken_back(paper_lens):
    both = (compensator("decenter_x_mm", 0.1), compensator("decenter_y_mm", 0.1))
    context = Context(paper_lens, SAMPLING, both, (AXIS, OFF_AXIS))
    batch = lens_batch(decenter_x_mm=[0.0, 0.03, -0.05], decenter_y_mm=[0.0, -0.02, 0.01])
    assert context.compensator_values(batch) == pytest.approx(batch.values, abs=2e-5)
    for point in (AXIS[0], OFF_AXIS[0]):
        merit = rms(field_mm=list(point))
        assert np.all(merit.scores(context, batch) < 1e-3)
        assert np.all(merit.uncompensated(context, batch)[1:] > 0.05)


def test_tilt_and_decenter_are_told_apart_by_field_points(paper_lens):
    both = (compensator("decenter_y_mm", 0.2), compensator("tilt_x_deg", 1.0))
    context = Context(paper_lens, SAMPLING, both, (AXIS, OFF_AXIS))
    batch = lens_batch(decenter_y_mm=[0.04], tilt_x_deg=[0.2])
    assert context.compensator_values(batch)[0] == pytest.approx([0.04, 0.2], abs=2e-3)
    assert rms(field_mm=[0.0, 1.2]).scores(context, batch)[0] < 5e-3


def test_bounds_hold_and_the_rest_is_as_good_as_it_gets(paper_lens):
    context = Context(paper_lens, SAMPLING, (compensator("decenter_y_mm", 0.02),), (AXIS,))
    batch = lens_batch(decenter_y_mm=[0.05, -0.05, 0.01])
    assert context.compensator_values(batch)[:, 0] == pytest.approx([0.02, -0.02, 0.01], abs=1e-5)
    left = rms().scores(context, batch)[0]
    alone = rms().scores(Context(paper_lens, SAMPLING), lens_batch(decenter_y_mm=[0.03]))[0]
    assert left == pytest.approx(alone, rel=0.02)


def test_plane_distances_are_found(paper_lens):
    distance = compensator("distance_mm", 0.5, "sensor")
    context = Context(paper_lens, SAMPLING, (distance,), (AXIS, OFF_AXIS))
    sensor = PerturbedParameter(target="sensor", parameter="distance_mm")
    batch = PerturbationBatch((sensor,), np.array([[0.2], [-0.1]]))
    assert context.compensator_values(batch)[:, 0] == pytest.approx([0.2, -0.1], abs=1e-3)
    assert np.all(rms().scores(context, batch) < 1e-3)


def test_what_refocusing_does_already_is_refused(paper_lens):
    despace = (compensator("despace_mm", 0.05),)
    context = Context(paper_lens, SAMPLING, despace, (AXIS,))
    with pytest.raises(InputError, match=r"lens_despace_mm: .*0\.05 mm"):
        context.compensator_values(lens_batch(despace_mm=[0.01]))


def test_values_do_not_depend_on_the_batch(paper_lens):
    context = Context(paper_lens, SAMPLING, (compensator("decenter_y_mm", 0.1),), (AXIS,))
    batch = lens_batch(decenter_y_mm=[0.01, 0.03, -0.02])
    together = context.compensator_values(batch)
    alone = [context.compensator_values(single)[0] for single in batch.single_trials()]
    assert np.array_equal(together, alone)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"target": "light", "parameter": "wavelength_um"}, "cannot adapt"),
        ({"target": "surface 1", "parameter": "irregularity_pv_waves"}, "cannot adapt"),
        ({"target": "lens", "parameter": "tilt_x_deg", "limit": 0.0}, r"limit = 0.0"),
    ],
)
def test_what_cannot_be_adapted_is_refused(keys, message):
    with pytest.raises(DesignError, match=message):
        validate(Compensator, {"limit": 1.0} | keys, "here")


def test_waves_go_back_through_the_adapted_model_too(paper_lens):
    both = (compensator("decenter_y_mm", 0.1), compensator("tilt_x_deg", 1.0))
    context = Context(paper_lens, SAMPLING, both, (AXIS, OFF_AXIS))
    batch = lens_batch(tilt_x_deg=[0.5], decenter_y_mm=[0.02])
    table = {"kind": "line_pair_contrast", "level": "wave", "line_width_um": 0.775, "at_least": 0.5}
    merit = merit_from_table(table | {"orientation": "y"}, "here")
    nominal = merit.scores(Context(paper_lens, SAMPLING), lens_batch(tilt_x_deg=[0.0]))[0]
    assert merit.uncompensated(context, batch)[0] < 0.8
    assert merit.scores(context, batch)[0] == pytest.approx(nominal, abs=0.02)
