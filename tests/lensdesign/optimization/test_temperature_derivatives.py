"""Temperatures that a search must meet: the lens there, exact gradients, lenses that keep their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS

from lensdesign.analysis.check import check_design
from lensdesign.errors import DesignError, MaterialError
from lensdesign.exploration.glasses import with_glasses
from lensdesign.lens.temperature import lens_at_temperature
from lensdesign.optimization.problem import DesignProblem, finished_lens
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.sections import Constraints, Environment, FieldSpread, Settings
from lensdesign.optimization.specification.specification import Specification, load_specification
from lensdesign.optimization.specification.variables import VariableRange
from lensdesign.optimization.specification_check import check_against

WARM = Environment(temperatures_c=(0.0, 50.0))


@pytest.fixture(scope="module")
def thinnest() -> Specification:
    return load_specification(DESIGNS / "thinnest_singlet_spec.toml").replaced(environment=WARM)


@pytest.fixture(scope="module")
def pair() -> Specification:
    """Aspheres, air between, edges, three wavelengths, and a mount that shrinks."""
    asked = load_specification(DESIGNS / "moulded_pair_spec.toml")
    odd = Environment(temperatures_c=(45.0,), mount_expansion_per_k=-5e-5)
    variables = (*asked.variables, VariableRange(parameter="working_distance_mm", bounds=(3.5, 4.5)))
    return asked.replaced(environment=odd, variables=variables)


def assert_gradients_agree(specification: Specification, point: np.ndarray) -> None:
    """All goals and constraints by all variables, against differences."""
    problem = DesignProblem(specification, specification.lens)
    rays = problem.sample_rays(3, 5, 2, (0.75,))
    exact = problem.evaluate(point, rays)
    for j, axis in enumerate(np.eye(len(point))):
        above, below = (problem.evaluate(point + sign * 1e-6 * axis, rays) for sign in (1.0, -1.0))
        for name in ("goals", "constraints"):
            numeric = (getattr(above, name) - getattr(below, name)) / 2e-6
            mine = getattr(exact, f"{name}_by")[:, j]
            np.testing.assert_allclose(mine, numeric, rtol=1e-6, atol=2e-7 * np.max(np.abs(mine)))


@pytest.mark.parametrize("stop", ["fixed", "numerical aperture"])
def test_gradients_at_temperatures(thinnest: Specification, stop: str) -> None:
    more = (
        VariableRange(parameter="asphere_4", surface=1, bounds=(-1e-4, 1e-4)),
        VariableRange(parameter="working_distance_mm", bounds=(8.0, 16.0)),
    )
    asked = thinnest.replaced(
        optimize=Settings(goal="smallest spread", stop=stop),
        constraints=Constraints(
            min_throughput=0.8, field_spread=(FieldSpread(field_mm=0.75, max_spread_deg=3.0),)
        ),
        variables=(*thinnest.variables, *more),
    ).with_surface(1, semi_diameter_mm=10.0)
    assert_gradients_agree(asked, np.array([0.57, 0.11, 0.7, 0.4, 0.52, 0.6]))


def test_gradients_by_terms_of_forbes_aspheres_at_temperatures(thinnest: Specification) -> None:
    keys = {"normalization_radius_mm": 10.0, "semi_diameter_mm": 10.0}
    asked = thinnest.with_surface(0, shape="Qbfs", q_mm=(0.01, 0.002), **keys).with_surface(
        1, shape="Qcon", q_mm=(0.02, -0.004), **keys
    )
    asked = asked.replaced(
        optimize=Settings(goal="smallest spread", stop="numerical aperture"),
        constraints=Constraints(min_throughput=0.8),
        variables=(
            VariableRange(parameter="radius_mm", surface=1, smallest_radius_mm=10.0),
            VariableRange(parameter="q_0_mm", surface=1, bounds=(-0.1, 0.1)),
            VariableRange(parameter="q_1_mm", surface=2, bounds=(-0.01, 0.01)),
            *thinnest.variables[1:],
        ),
    )
    assert_gradients_agree(asked, DesignProblem(asked, asked.lens).to_unit(asked.lens))


def test_gradients_of_a_variable_field_at_temperatures(thinnest: Specification) -> None:
    field = VariableRange(parameter="field_diameter_mm", bounds=(2.0, 6.0))
    asked = thinnest.replaced(
        optimize=Settings(goal="largest field", stop="numerical aperture"),
        variables=(field, *thinnest.variables),
    )
    assert_gradients_agree(asked, np.array([0.4, 0.57, 0.11, 0.7, 0.4]))


def test_gradients_of_a_pair_whose_mount_shrinks(pair: Specification) -> None:
    problem = DesignProblem(pair, pair.lens)
    asked = pair.replaced(optimize=Settings(goal="smallest spread angle", stop="numerical aperture"))
    assert_gradients_agree(asked, problem.to_unit(pair.lens))


def test_the_searchs_lens_is_the_lens_at_the_temperature(pair: Specification) -> None:
    """But for clear semi-diameters, which the search has before they are rounded."""
    bare = pair.lens.replaced(edges=())
    problem = DesignProblem(pair, bare)
    point = problem.to_unit(bare)
    lens = finished_lens(problem, point, problem.sample_rays(5, 9, 4))
    expected = lens_at_temperature(lens, 45.0, mount_expansion_per_k=-5e-5)
    hot = problem.heated[0].lens_at(point)
    for mine, other, cold in zip(hot.surfaces, expected.surfaces, lens.surfaces, strict=True):
        np.testing.assert_allclose(mine.shape.terms, other.shape.terms, rtol=1e-12)
        assert mine.material == other.material
        if cold.thickness_mm is not None:
            grown = other.thickness_mm - cold.thickness_mm
            assert mine.thickness_mm - cold.thickness_mm == pytest.approx(grown, rel=5e-3)
    for read in (lambda o: o.object.working_distance_mm, lambda o: o.sensor.plane_distances_mm[1]):
        assert read(hot) - read(lens) == pytest.approx(read(expected) - read(lens), rel=5e-3)


def test_a_plastic_lens_keeps_its_limits_where_it_is_asked_to(thinnest: Specification) -> None:
    """Designed at 20 C alone it misses both of them at 50 C; the glass lens has less to give."""
    thickness = {}
    for glass in ("N-BK7", "E48R"):
        asked = thinnest.with_surface(0, material=glass)
        asked = asked.replaced(optimize=asked.optimize.replaced(starts=1))
        cold = optimize(asked.replaced(environment=None)).lens
        found = optimize(asked)
        assert found.feasible
        assert any(name.endswith(" C") for name in found.binding)
        for temperature_c in (0.0, 20.0, 50.0):
            hot = check_design(lens_at_temperature(found.lens, temperature_c))
            assert hot.max_spread_deg <= 4.7683
            assert max(hot.footprint_radius_mm) <= 11.2001
        missed = check_against(cold, asked)
        assert not missed.feasible
        assert "spread angle at 0.532 µm at 50 C: " in " ".join(missed.violations)
        thickness[glass] = found.lens.exit_vertex_z_mm - cold.exit_vertex_z_mm
    assert 0.01 < thickness["N-BK7"] < 0.1 < thickness["E48R"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("N-BK7", "SCHOTT:P-BK7", "P-BK7 .Schott.: .* not known"),
        ('"N-BK7"', "1.52", "surface 1, 1.52 .*: its thermal expansion is not known"),
        ("[0, 50]", "[0, 150]", "less than or equal to 140"),
        ("[0, 50]", "[-101]", "greater than or equal to -100"),
        ("[0, 50]", "[20]", r"20 C .*of the design"),
        ("[0, 50]", "[50, 50]", "given twice"),
        ("[0, 50]", "[]", "at least 1 item"),
    ],
)
def test_what_no_temperature_can_be_asked_of_is_refused(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text(encoding="utf-8")
    text = text.replace("[constraints]", "[environment]\ntemperatures_c = [0, 50]\n\n[constraints]")
    assert old in text
    path = tmp_path / "spec.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises((DesignError, MaterialError), match=said):
        load_specification(path)


def test_glasses_are_choices_only_where_heat_is_known(thinnest: Specification) -> None:
    with pytest.raises(MaterialError, match="not known"):
        with_glasses(thinnest, "N-BK7,SCHOTT:P-BK7")
