"""Merits of rays: the nominal score is the number that the check of the design states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensdesign import (
    InputError,
    Pose,
    SurfacePerturbation,
    SurfaceRoughness,
    launch,
    load_design,
    save_design,
    trace_polarized,
)
from lensdesign.analysis.coatings import coating_report
from lensdesign.analysis.exit_beam import footprint, largest_spread_angle
from lensdesign.analysis.roughness import roughness_report
from lensdesign.errors import DesignError
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing import load_study, run_study
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, Price, Process, load_costs
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.rays import (
    FootprintRadius,
    LargestSpread,
    ScatteredFraction,
    Throughput,
    Transmittance,
)
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.store.store import open_store
from tolerancing.study.scaling import scaling_of

ROOT = Path(__file__).parents[3]
DESIGNS = [
    *sorted((ROOT / "tests" / "golden" / "designer_b").glob("[bt]*.toml")),
    *(
        ROOT / "designs" / f"{name}.toml"
        for name in ("paper_singlet", "phone_lens", "moulded_pair", "wide_field")
    ),
]


@pytest.mark.parametrize("design", DESIGNS, ids=lambda path: path.stem)
def test_nominal_spread_and_footprint_are_those_of_the_check(design):
    lens = load_design(design)
    # Few rays on purpose: the extreme rays themselves are added to them.
    context = Context(lens, Sampling(rings=3, arms=8))
    nominal = context.perturbed((), np.zeros((1, 0)))
    spread = LargestSpread(kind="largest_spread_deg", at_most=90.0).scores(context, nominal)
    assert spread == pytest.approx(largest_spread_angle(lens).spread_deg, abs=2e-6)
    for distance in (*lens.sensor.plane_distances_mm, 4.0):
        merit = FootprintRadius(kind="footprint_radius_mm", at_most=90.0, plane_distance_mm=distance)
        found = footprint(lens, plane_distance_mm=distance).radius_mm
        assert merit.scores(context, nominal) == pytest.approx(found, abs=2e-7)


def test_extreme_rays_have_no_weight_in_the_throughput(paper_lens):
    narrow = paper_lens.with_surface(1, semi_diameter_mm=6.0)
    merit = Throughput(kind="throughput", at_least=0.5)
    shares = []
    for arms in (24, 96):
        context = Context(narrow, Sampling(rings=24, arms=arms))
        shares.append(float(merit.scores(context, context.perturbed((), np.zeros((1, 0))))[0]))
    assert 0.1 < shares[0] < 0.99
    assert shares[0] == pytest.approx(shares[1], abs=5e-3)


ROUGHER = PerturbedParameter(target="surface 1", parameter="roughness_rms_nm")
LESS_ROUGH = PerturbedParameter(target="surface 2", parameter="roughness_rms_nm")
DECENTER = PerturbedParameter(target="object", parameter="decenter_y_mm")


@pytest.fixture(scope="module")
def rough_lens(paper_lens):
    roughness = SurfaceRoughness(rms_nm=5.0, correlation_length_um=2.0)
    return paper_lens.with_surface(0, roughness=roughness).with_surface(1, roughness=roughness)


def scattered(**keys):
    return ScatteredFraction(kind="scattered_fraction", at_most=0.01, **keys)


def test_the_scattered_fraction_is_that_of_the_check(rough_lens):
    context = Context(rough_lens, Sampling())
    nominal = context.perturbed((), np.zeros((2, 0)))
    report = roughness_report(rough_lens)
    for point, expected in zip(report.field_points_mm, report.mean_fractions, strict=True):
        scores = scattered(field_points_mm=(point,)).scores(context, nominal)
        assert scores == pytest.approx([expected, expected], rel=1e-9)
    assert scattered().scores(context, nominal) == pytest.approx(max(report.mean_fractions), rel=1e-4)


def test_perturbed_roughness_scatters_with_its_square(rough_lens):
    context = Context(rough_lens, Sampling())
    values = np.array(
        [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [-5.0, -5.0, 0.0], [-10.0, 0.0, 0.0], [0.0, 0.0, 0.2]]
    )
    batch = context.perturbed((ROUGHER, LESS_ROUGH, DECENTER), values)
    nominal, one, none, opposite, moved = scattered().scores(context, batch)
    assert one == pytest.approx(2.5 * nominal, rel=0.01)
    assert none == 0.0
    assert opposite == pytest.approx(nominal)
    assert moved == pytest.approx(nominal, rel=0.01)
    assert moved != nominal
    spread = LargestSpread(kind="largest_spread_deg", at_most=90.0).scores(context, batch)
    assert spread[:4] == pytest.approx(spread[0])


def test_smooth_surfaces_have_no_roughness_to_perturb(paper_lens, rough_lens):
    with pytest.raises(ValueError, match="surface 1: the design states no roughness of this surface"):
        ROUGHER.check(paper_lens)
    ROUGHER.check(rough_lens)
    with pytest.raises(ValueError, match="no surface of the design has a roughness"):
        scattered().check(paper_lens)


def test_roughness_has_a_unit_does_not_scale_and_has_a_price_if_the_table_has_one(tmp_path, rough_lens):
    assert ROUGHER.column == "surface_1_roughness_rms_nm"
    assert ROUGHER.unit == "nm"
    assert scaling_of(ROUGHER) == 0
    loaded = load_study(study_file(tmp_path, rough_lens))
    with pytest.raises(InputError, match="no roughness_rms_nm, for surface_1_roughness_rms_nm"):
        cost_of(loaded.study, loaded.lens, load_costs())
    prices = {"roughness_rms_nm": Price(reference=2.0, share=0.2)}
    processes = {"polish": Process(source="a test", prices=prices)}
    table = CostTable(default="polish", mount="polish", processes=processes)
    assert cost_of(loaded.study, loaded.lens, table).total == pytest.approx(1.0 + 0.2 * 2.0 / 3.0)


def study_file(folder, lens, surface=1):
    save_design(lens, folder / "lens.toml")
    path = folder / "study.toml"
    path.write_text(
        f"""
design = "lens.toml"
trials = 12
seed = 3
sensitivity = false

[[perturbation]]
target = "surface {surface}"
parameter = "roughness_rms_nm"
distribution = "uniform"
half_width = 3.0

[[merit]]
kind = "scattered_fraction"
at_most = 0.0025
"""
    )
    return path


def test_a_study_of_roughness_runs(tmp_path, rough_lens):
    loaded = load_study(study_file(tmp_path, rough_lens))
    run_study(loaded, tmp_path / "store", workers=1)
    with open_store(tmp_path / "store") as store:
        results = store.trials()
    rms_nm = 5.0 + results.values[:, 0]
    # Both surfaces scatter about as much; the fraction grows with the squares of their heights.
    nominal = max(roughness_report(rough_lens).mean_fractions)
    expected = 0.5 * nominal * (1.0 + (rms_nm / 5.0) ** 2)
    assert results.scores[:, 0] == pytest.approx(expected, rel=0.01)


def test_a_study_names_the_surface_without_roughness(tmp_path, rough_lens):
    path = study_file(tmp_path, rough_lens.with_surface(0, roughness=None))
    with pytest.raises(DesignError, match=r"perturbation 1: .*surface 1: the design states no roughness"):
        load_study(path)


THICKER = PerturbedParameter(target="surface 1", parameter="coating_thickness_percent")
DECENTERED = PerturbedParameter(target="lens", parameter="decenter_y_mm")


@pytest.fixture(scope="module")
def coated_lens(paper_lens):
    return paper_lens.with_coating("mgf2")


def transmittance(**keys):
    return Transmittance(kind="transmittance", at_least=0.9, **keys)


def test_the_transmittance_is_that_of_the_check(coated_lens):
    context = Context(coated_lens, Sampling())
    nominal = context.perturbed((), np.zeros((2, 0)))
    report = coating_report(coated_lens)
    for point in report.points:
        scores = transmittance(field_points_mm=(point.field_mm,)).scores(context, nominal)
        assert scores == pytest.approx([point.transmittance] * 2, rel=1e-12)
    ring = [(1.5 * np.sin(angle), 1.5 * np.cos(angle)) for angle in np.arange(8) * np.pi / 4.0]
    points = coating_report(coated_lens, 0.65, [(0.0, 0.0), *ring]).points
    expected = np.mean([point.transmittance for point in points])
    scores = transmittance(wavelength_um=0.65).scores(context, nominal)
    assert scores == pytest.approx([expected] * 2, rel=1e-12)


def test_the_transmittance_is_that_of_perturbed_films(coated_lens):
    context = Context(coated_lens, Sampling(rings=8, arms=36))
    values = np.array([[0.0, 0.0], [20.0, 0.0], [-20.0, 0.0], [0.0, 0.3], [20.0, 0.3]])
    batch = context.perturbed((THICKER, DECENTERED), values)
    found = transmittance(field_points_mm=((0.0, 0.0),)).scores(context, batch)
    for (percent, decenter_mm), score in zip(values, found, strict=True):
        changed = {
            "pose": Pose(decenter_y_mm=decenter_mm),
            "surface_perturbations": {0: SurfacePerturbation(coating_thickness_percent=percent)},
        }
        stop = pupil_rings(20, 100)
        bundle = launch(coated_lens, [(0.0, 0.0)], stop.points, 0.532, **changed)
        rays = trace_polarized(coated_lens, *bundle, 0.532, **changed)
        assert score == pytest.approx(np.sum(stop.weights * rays.transmittance), abs=1e-9)
    assert found[1] < found[0] > found[2]
    spread = LargestSpread(kind="largest_spread_deg", at_most=90.0).scores(context, batch)
    assert spread[1] == spread[0]


def test_surfaces_without_films_have_no_thickness_to_perturb(paper_lens, coated_lens):
    THICKER.check(coated_lens)
    for coating in ("ideal", "bare"):
        with pytest.raises(ValueError, match="surface 1: the coating of this surface has no films"):
            THICKER.check(paper_lens.with_surface(0, coating=coating))
    with pytest.raises(ValueError, match="all coatings of the design are ideal"):
        transmittance().check(paper_lens)
    assert (THICKER.column, THICKER.unit) == ("surface_1_coating_thickness_percent", "percent")
    assert scaling_of(THICKER) == 0


COATING_STUDY = """
design = "lens.toml"
trials = 16
seed = 3
sensitivity = false

[[perturbation]]
target = "surface 1"
parameter = "coating_thickness_percent"
distribution = "uniform"
half_width = 20.0

[[merit]]
kind = "transmittance"
at_least = 0.969
"""


def test_a_study_of_coatings_runs_and_has_a_price_if_the_table_has_one(tmp_path, coated_lens):
    save_design(coated_lens, tmp_path / "lens.toml")
    (tmp_path / "study.toml").write_text(COATING_STUDY)
    loaded = load_study(tmp_path / "study.toml")
    run_study(loaded, tmp_path / "store", workers=1)
    with open_store(tmp_path / "store") as store:
        results = store.trials()
    percent, scores = results.values[:, 0], results.scores[:, 0]
    # A quarter wave at normal incidence is best a little thicker at the angles of the rays.
    fit = np.polyfit(percent, scores, 3)
    best = np.roots(np.polyder(fit))
    assert np.any((best > 0.0) & (best < 10.0))
    assert np.abs(np.polyval(fit, percent) - scores).max() < 1e-4
    assert 0.0 < np.mean(scores >= 0.969) < 1.0
    with pytest.raises(InputError, match="no coating_thickness_percent, for surface_1_coating_thickness"):
        cost_of(loaded.study, loaded.lens, load_costs())
    prices = {"coating_thickness_percent": Price(reference=5.0, share=0.2)}
    table = CostTable(
        default="coat", mount="coat", processes={"coat": Process(source="a test", prices=prices)}
    )
    assert cost_of(loaded.study, loaded.lens, table).total == pytest.approx(1.0 + 0.2 * 5.0 / 20.0)
    save_design(coated_lens.with_surface(0, coating="bare"), tmp_path / "lens.toml")
    with pytest.raises(DesignError, match=r"perturbation 1: .*surface 1: the coating of this surface has no"):
        load_study(tmp_path / "study.toml")
