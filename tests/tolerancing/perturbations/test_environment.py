"""A temperature as a perturbation is the lens at that temperature, traced by itself."""

import numpy as np
import pytest

from lensdesign.errors import DesignError, InputError
from lensdesign.lens.temperature import lens_at_temperature
from tolerancing.merits.sensor_rays import arriving_rays
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.evaluate import context_of, score_trials
from tolerancing.study.files import load_study

HEAT = """
[[perturbation]]
target = "environment"
parameter = "temperature_c"
distribution = "uniform"
half_width = 30.0
"""


@pytest.fixture
def glass(write_study, ray_study):
    """The study of rays with a lens of glass in place of a constant index, and a temperature alone."""
    from tests_studies import DESIGN, HEAD, SPREAD

    return load_study(write_study(HEAD + HEAT + SPREAD, DESIGN.replace("1.5194726", '"N-BK7"')))


FORMS = [
    {},
    {"asphere": (1e-6, -2e-9)},
    {"shape": "Qcon", "normalization_radius_mm": 6.0, "q_mm": (0.05, -0.01)},
]


@pytest.mark.parametrize("form", FORMS)
def test_rays_are_those_of_the_lens_at_that_temperature(glass, form):
    lens = glass.lens.with_surface(0, **form)
    heat = PerturbedParameter(target="environment", parameter="temperature_c")
    change = np.array([[-20.0], [0.0], [30.0]])
    batch = PerturbationBatch((heat,), change)
    points = np.array([[0.0, 0.0], [0.0, 0.7], [0.5, -0.5]])
    found = arriving_rays(lens, batch, ((0.0, 0.0), (0.0, 1.2)), points, 0.532)
    nothing = PerturbationBatch((), np.zeros((1, 0)))
    for k, shift in enumerate(change[:, 0]):
        hot = lens_at_temperature(lens, 20.0 + shift)
        # Rays are launched through the nominal aperture.
        hot = hot.with_surface(0, semi_diameter_mm=lens.surfaces[0].semi_diameter_mm)
        alone = arriving_rays(hot, nothing, ((0.0, 0.0), (0.0, 1.2)), points, 0.532)
        # A plane stands where the mean of both does: 2 mm and 22 mm grow by shares of their own.
        planes = np.array(hot.sensor.plane_distances_mm) - lens.sensor.plane_distances_mm
        slope = alone.direction[0, :, :2] / alone.direction[0, :, 2:]
        expected = alone.position_mm[0] + slope * (planes.mean() - planes[0])
        assert found.position_mm[k] == pytest.approx(expected, abs=2e-9)
        assert found.direction[k] == pytest.approx(alone.direction[0], abs=1e-10)


def test_a_shape_whose_departure_moves_is_refused(glass):
    lens = glass.lens.with_surface(0, shape="Qbfs", normalization_radius_mm=6.0, q_mm=(0.05,))
    heat = PerturbedParameter(target="environment", parameter="temperature_c")
    with pytest.raises(InputError, match=r"surface 1: a study cannot change its temperature.*Qcon"):
        PerturbationBatch((heat,), np.array([[30.0]])).states(lens, 0.532)


def test_a_study_scatters_over_temperatures(glass):
    results = score_trials(context_of(glass.lens, glass.study), glass.study, range(8))
    (perturbation,) = glass.study.perturbations
    assert perturbation.column == "environment_temperature_c"
    assert results.messages == ("",) * 8
    assert len(np.unique(results.scores)) == 8


def test_a_material_that_says_nothing_of_heat_is_refused_with_the_study(write_study, ray_study):
    with pytest.raises(DesignError, match=r"environment.*surface 1, 1.5194726.*thermal expansion"):
        load_study(write_study(ray_study + HEAT))


def test_only_the_environment_has_a_mount(write_study, ray_study):
    text = ray_study.replace("[[perturbation]]", "[[perturbation]]\nmount_expansion_per_k = 1e-5", 1)
    with pytest.raises(DesignError, match="mount_expansion_per_k = 1e-05: only target"):
        load_study(write_study(text))
