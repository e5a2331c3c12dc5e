"""Perturbations: what tables and lenses allow."""

import pytest
import tomli_w

from lensdesign import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.assumed import load_tolerances
from tolerancing.perturbations.distributions import Normal
from tolerancing.perturbations.distributions.registry import DISTRIBUTIONS
from tolerancing.perturbations.parameters import PerturbedParameter, perturbation_from_table


@pytest.mark.parametrize(
    ("name", "target", "parameter", "column"),
    [
        ({}, "lens", "tilt_y_deg", "lens_tilt_y_deg"),
        ({}, "surface 2", "conic", "surface_2_conic"),
        ({}, "surface 2", "radius_fringes", "surface_2_radius_fringes"),
        ({}, "surface 2", "radius_x_percent", "surface_2_radius_x_percent"),
        ({}, "surface 2", "conic_x", "surface_2_conic_x"),
        ({}, "surface 1", "irregularity_pv_waves", "surface_1_irregularity_pv_waves"),
        ({}, "sensor", "plane_distance_2_mm", "sensor_plane_distance_2_mm"),
        ({"name": "laser"}, "light", "wavelength_um", "laser_um"),
        ({"name": "wedge"}, "surface 1", "tilt_x_deg", "wedge_deg"),
        ({"name": "sag_mm"}, "surface 1", "despace_mm", "sag_mm"),
    ],
)
def test_columns_carry_their_unit(name, target, parameter, column):
    assert PerturbedParameter(**name, target=target, parameter=parameter).column == column


GOOD = {"target": "lens", "parameter": "tilt_x_deg", "distribution": "normal", "sigma": 0.1}


def test_table_is_read_with_its_distribution():
    read = perturbation_from_table(GOOD | {"mean": 0.5}, "here")
    assert read.distribution == Normal(sigma=0.1, mean=0.5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sgma": 1.0}, "here: sgma: unknown key"),
        ({"distribution": "norml"}, r"distribution = 'norml'.*allowed: normal, .*did you mean normal"),
        ({"distribution": 3}, r"distribution = 3.*allowed: normal"),
        ({"sigma": -0.1}, r"here: sigma = -0.1: must be greater than 0"),
        ({"sigma": float("inf")}, r"here: sigma = inf: must be a finite number"),
        ({"target": "lense"}, r"'lense' is not a target; allowed: lens, surface N"),
        ({"target": "surface 0"}, r"'surface 0' is not a target"),
        ({"parameter": "radius_mm"}, r"lens has no such parameter; allowed: decenter_x_mm"),
        ({"target": "object"}, r"object has no such parameter; allowed: decenter_x_mm.*working_distance_mm"),
        ({"target": "light"}, r"light has no such parameter; allowed: wavelength_um"),
        ({"group": "Barrel 1"}, r"group = 'Barrel 1'"),
        ({"parameter": "pivot_z_mm"}, r"lens has no such parameter"),
        ({"name": "Tilt X"}, r"name = 'Tilt X'"),
    ],
)
def test_faults_name_key_value_and_what_is_allowed(change, message):
    with pytest.raises(DesignError, match=message):
        perturbation_from_table(GOOD | change, "here")


@pytest.mark.parametrize("key", ["target", "parameter", "distribution", "sigma"])
def test_missing_keys_are_named(key):
    with pytest.raises(DesignError, match=f"here: {key}: missing key"):
        perturbation_from_table({k: v for k, v in GOOD.items() if k != key}, "here")


@pytest.mark.parametrize(
    ("target", "parameter", "message"),
    [
        ("surface 3", "conic", r"no such surface.*lens, surface 1, surface 2"),
        ("surface 1", "radius_mm", r"surface 1 is a plane"),
        ("surface 1", "radius_percent", r"surface 1 is a plane"),
        ("surface 2", "radius_x_mm", r"surface 2 \(conic\).*radius_x_mm.*radius_mm, conic"),
        ("surface 2", "conic_x", r"surface 2 \(conic\).*conic_x"),
        ("surface 2", "asphere_4", r"surface 2 \(conic\).*asphere_4"),
        ("surface 2", "radius_fringes", r"surface 2 has no semi_diameter_mm"),
        ("surface 2", "irregularity_rms_waves", r"surface 2 has no semi_diameter_mm"),
        ("sensor", "plane_distance_2_mm", r"the design has 1 sensor plane"),
        ("surface 2", "abbe_percent", r"last surface"),
        ("surface 2", "thickness_mm", r"last surface"),
        ("surface 2", "index", r"last surface"),
    ],
)
def test_parameters_that_a_lens_does_not_have_are_refused(target, parameter, message):
    lens = Lens.model_validate(
        {
            "wavelengths_um": [0.5],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.2, "working_distance_mm": 10.0},
            "sensor": {"pixel_pitch_um": 3.0, "pixels": [100, 100], "plane_distances_mm": [1.0]},
            "surface": [{"thickness_mm": 3.0, "material": 1.5, "semi_diameter_mm": 2.0}, {"radius_mm": -9.0}],
        }
    )
    with pytest.raises(ValueError, match=message):
        PerturbedParameter(target=target, parameter=parameter).check(lens)


@pytest.mark.parametrize("parameter", ["radius_x_mm", "radius_x_percent", "radius_x_fringes", "conic_x"])
def test_a_shape_brings_its_own_parameters(paper_lens, parameter):
    perturbed = PerturbedParameter(target="surface 2", parameter=parameter)
    perturbed.check(paper_lens.with_surface(1, shape_type="biconic", radius_x_mm=-14.0))
    flat = paper_lens.with_surface(1, shape_type="biconic")
    if parameter.startswith("radius"):
        with pytest.raises(ValueError, match=r"surface 2 .*plane.*radius_x_mm"):
            perturbed.check(flat)


WIDTHS = {"sigma": 0.01, "limit": 0.015, "half_width": 0.02}


@pytest.mark.parametrize("kind", [name for name, shape in DISTRIBUTIONS.items() if shape.widths])
def test_a_drawing_states_the_tolerance_that_a_study_assumes(tmp_path, paper_lens, kind):
    """It reads study files by a rule of its own."""
    tables = [
        {"target": "surface 1", "parameter": name, "distribution": kind, "mean": mean}
        | {width: WIDTHS[width] for width in DISTRIBUTIONS[kind].widths}
        for name, mean in (("thickness_mm", 0.0), ("irregularity_pv_waves", 0.02))
    ]
    path = tmp_path / "study.toml"
    path.write_text(tomli_w.dumps({"perturbation": tables}))
    thickness, irregularity = (perturbation_from_table(table, "here").tolerance for table in tables)
    assumed = load_tolerances(path, paper_lens)
    assert assumed.elements[0]["thickness_mm"] == pytest.approx(thickness)
    assert assumed.surfaces[0]["irregularity_fringes"] == pytest.approx(2.0 * irregularity)
