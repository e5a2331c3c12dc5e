"""The merit of the whole chain: one run for all its figures, slices that vary, models, refusals."""

from contextlib import nullcontext

import numpy as np
import pytest
from pydantic import ValidationError

from lensdesign import scaled
from lensdesign.errors import InputError
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.reconstruction.line_imaging_chain import LineImagingChain
from tolerancing.merits.reconstruction.merit import Reconstruction
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter

DECENTER = PerturbedParameter(target="lens", parameter="decenter_y_mm")
TILT = PerturbedParameter(target="lens", parameter="tilt_x_deg")
SLICES = PerturbedParameter(target="reconstruction", parameter="slices")


def merit(**keys):
    given = {"line_widths_um": (0.775, 1.55), "region_mm": 0.05, "at_least": 0.5} | keys
    return Reconstruction(kind="reconstruction", **given)


@pytest.fixture(scope="module")
def twin(paper_lens):
    return scaled(paper_lens, 1 / 16)


@pytest.fixture(scope="module")
def context(twin):
    return Context(twin, Sampling(pupil_samples=64), noise_seed=3)


def batch(*columns, numbers=()):
    parameters, values = zip(*columns, strict=True)
    return PerturbationBatch(parameters, np.array(values, float).T, trial_numbers=numbers)


def test_slices_decenter_and_tilt_vary_together(context):
    together = batch((DECENTER, [0.0, 0.0, 0.001]), (TILT, [0.0, 0.0, 0.05]), (SLICES, [0, 2, 8]))
    own = merit(reconstruction_engine="slices", slices=8)
    scores = own.scores(context, together)
    assert scores[0] > 0.95
    assert scores[1] < scores[0]
    assert scores[2] != scores[0]
    assert scores[0] == own.scores(context, batch((SLICES, [8])))[0]
    singly = [own.scores(context, one)[0] for one in together.single_trials()]
    assert scores.tolist() == singly


def test_one_run_of_the_chain_gives_all_figures(context, monkeypatch):
    counts = {"record": 0, "reconstruct": 0}
    for name in counts:
        plain = getattr(LineImagingChain, name)

        def counted(self, *args, name=name, plain=plain, **keys):
            counts[name] += 1
            return plain(self, *args, **keys)

        monkeypatch.setattr(LineImagingChain, name, counted)
    merit().chain(context, 0.0)
    counts.update(record=0, reconstruct=0)
    trial = batch((DECENTER, [0.002]))
    figures = [merit(), merit(figure="contrast", name="other"), merit(figure="lost_correlation", name="lost")]
    correlation, contrast, lost = (one.scores(context, trial)[0] for one in figures)
    assert counts == {"record": 1, "reconstruct": 1}
    assert lost == pytest.approx(1.0 - correlation)
    assert contrast != correlation
    merit(reconstruction_engine="slices", slices=8).scores(context, trial)
    assert counts == {"record": 1, "reconstruct": 2}


def test_the_worst_field_point_counts(context, twin):
    points = [[0.0, 0.0], [0.0, 0.06]]
    trial = batch((DECENTER, [0.002]))
    alone = [merit(field_mm=point).scores(context, trial)[0] for point in points]
    assert merit(field_points_mm=points).scores(context, trial)[0] == min(alone)


def test_a_calibrated_model_finds_what_the_nominal_one_loses(twin):
    adapted = Context(
        twin,
        Sampling(pupil_samples=64),
        (Compensator(target="lens", parameter="decenter_y_mm", limit=0.02),),
        (((0.0, 0.0), None), ((0.0, 0.06), None)),
    )
    trial = batch((DECENTER, [0.004]))
    nominal, calibrated, true = (
        merit(model=model).scores(adapted, trial)[0] for model in ("nominal", "calibrated", "true")
    )
    assert nominal < 0.7
    assert min(calibrated, true) > 0.95


def test_a_calibrated_model_needs_compensators(context):
    with pytest.raises(InputError, match=r"model = 'calibrated'.*\[\[compensator\]\]"):
        merit(model="calibrated").scores(context, batch((DECENTER, [0.0])))


def test_noise_belongs_to_the_trial(context):
    noisy = merit(electrons=3000.0)
    trials = batch((DECENTER, [0.0, 0.0]), numbers=(3, 7))
    scores = noisy.scores(context, trials)
    assert scores[0] != scores[1]
    assert noisy.scores(context, trials.trial(1))[0] == scores[1]


def test_refuses_an_object_that_the_unperturbed_chain_does_not_find(context):
    with pytest.raises(InputError, match=r"region_mm = 0\.05 .*correlation of 0\.\d+.*0\.97"):
        merit(object="complex").scores(context, batch((DECENTER, [0.0])))


@pytest.mark.parametrize(
    ("target", "parameter", "leaves"),
    [
        ("lens", "decenter_x_mm", True),
        ("lens", "tilt_y_deg", True),
        ("surface 1", "tir_x_mm", True),
        ("sensor", "tilt_x_deg", True),
        ("lens", "tilt_x_deg", False),
        ("surface 2", "radius_mm", False),
        ("sensor", "distance_mm", False),
    ],
)
def test_refuses_what_leaves_the_meridional_plane_alone(target, parameter, leaves):
    one = PerturbedParameter(target=target, parameter=parameter)
    with pytest.raises(ValueError, match="meridional line") if leaves else nullcontext():
        merit().check_perturbation(one)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"region_mm": 0.02}, r"line_widths_um.* 0.0"),
        ({"line_width_um": 2.0, "figure": "contrast"}, "line_width_um = 2: allowed: .*0.775, 1.55"),
        ({"line_width_um": 1.55}, "figure = 'correlation' is evaluated on the whole object"),
        ({"field_mm": (0.1, 0.0)}, "x = 0"),
        ({"slices": 20}, "slices: has no effect with reconstruction_engine = 'eikonal'"),
        ({"imaging_slices": 20}, "imaging_slices: has no effect"),
        ({"planes_mm": (2.0,)}, "must be two or more, increasing"),
        ({"line": False}, "line"),
        ({"level": "pupil"}, "allowed: auto, wave"),
    ],
)
def test_refuses_bad_keys(keys, message):
    with pytest.raises(ValidationError, match=message):
        merit(**keys)


def test_refuses_a_region_wider_than_the_field(twin):
    with pytest.raises(ValueError, match=r"region_mm = 0\.5.*up to 0\.1875 mm"):
        merit(region_mm=0.5).check(twin)
