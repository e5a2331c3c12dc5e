"""The constraint on the oversampling ratio: its derivatives, and lenses that a search finds with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import load_design
from lensdesign.analysis.oversampling import oversampling_of
from lensdesign.errors import DesignError
from lensdesign.optimization.limits.limited_quantities import FIELD
from lensdesign.optimization.operands.requirements import constraint_operands
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.specification import Specification, load_specification
from lensdesign.optimization.specification_check import check_against

LENS = load_design(DESIGNS / "feasible_singlet.toml")
"""A lens of the specification whose light stays within the sensor on the first plane."""

FIELD_VARIABLE = """
[[variable]]
parameter = "field_diameter_mm"
bounds = [1.0, 4.0]
"""


def recorded(tmp_path: Path, recording: str, variables: str = "", *changes: tuple[str, str]) -> Specification:
    """The specification of the feasible singlet with a recording."""
    text = (DESIGNS / "feasible_singlet_spec.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "spec.toml"
    path.write_text(f"{text}\n[recording]\n{recording}\n{variables}")
    return load_specification(path)


def ratio_operand(problem: DesignProblem, point: np.ndarray, derivatives: bool = True):
    rays = problem.sample_rays(3, 5, 3, (0.8,))
    rows = constraint_operands(problem.specification, problem.state(point, rays, derivatives))
    return next(row for row in rows if row.name == "oversampling ratio")


@pytest.mark.parametrize(
    ("recording", "variables"),
    [
        ('frames = 2\nobject = "complex"\noversampling = 1.5', ""),
        ('frames = 1\nobject = "phase"\noversampling = 1.2', FIELD_VARIABLE),
        ('frames = 2\nobject = "amplitude"\noversampling = 3.0\nsupport_mm = 2.0', ""),
    ],
)
def test_derivatives_agree_with_finite_differences(tmp_path: Path, recording: str, variables: str) -> None:
    specification = recorded(tmp_path, recording, variables)
    problem = DesignProblem(specification, specification.lens)
    point = problem.to_unit(LENS)
    found = ratio_operand(problem, point).by[0] * problem.width
    step = 1e-6
    for variable in range(len(point)):
        ahead, behind = point.copy(), point.copy()
        ahead[variable] += step
        behind[variable] -= step
        values = [ratio_operand(problem, one, derivatives=False).values[0] for one in (ahead, behind)]
        difference = (values[0] - values[1]) / (2.0 * step)
        assert found[variable] == pytest.approx(difference, rel=2e-4, abs=1e-6)
    assert np.abs(found).max() > 1e-3


def test_search_limits_at_most_the_ratio_of_the_check(tmp_path: Path) -> None:
    specification = recorded(tmp_path, 'frames = 1\nobject = "complex"\noversampling = 0.7')
    problem = DesignProblem(specification, specification.lens)
    value = ratio_operand(problem, problem.to_unit(LENS)).values[0]
    true = oversampling_of(LENS, "complex", plane_distances_mm=LENS.sensor.plane_distances_mm[:1]).ratio
    assert 0.98 * true < 0.7 * (1.0 - value) <= true * (1.0 + 1e-9)


def test_largest_field_is_that_of_the_ratio(tmp_path: Path) -> None:
    goal = ('goal = "smallest spread"', 'goal = "largest field"\nstarts = 2\nagreeing = 1')
    recording = 'frames = 2\nobject = "complex"\noversampling = 2.2'
    result = optimize(recorded(tmp_path, recording, FIELD_VARIABLE, goal))
    assert result.feasible
    constraint = next(one for one in result.check.constraints if one.name.startswith("oversampling"))
    assert constraint.limit == 2.2
    assert constraint.value == pytest.approx(2.2, rel=2e-3)
    assert any("oversampling" in one for one in result.binding)
    # Light that fills the sensor on both planes bounds the field.
    pixels = 2.0 * math.pi * 3500.0**2
    bound_mm = math.sqrt(pixels / (2.0 * 2.2)) * 2.0 / (math.pi * 0.5 / 0.532e-3)
    assert 0.9 * bound_mm < result.lens.object.field_diameter_mm <= bound_mm


def test_check_against_lists_ratio_and_limit(tmp_path: Path) -> None:
    specification = recorded(tmp_path, 'frames = 2\nobject = "complex"\noversampling = 1.9')
    report = check_against(LENS, specification)
    (one,) = (c for c in report.constraints if c.name == "oversampling ratio, complex object, 2 frames")
    assert one.value == pytest.approx(oversampling_of(LENS, "complex").ratio, rel=1e-9)
    assert (one.relation, one.limit, one.met) == (">=", 1.9, False)
    assert one.miss in report.violations


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        ('frames = 3\nobject = "complex"\noversampling = 2', "frames = 3: the sensor has 2 planes"),
        (
            'frames = 1\nobject = "complex"\noversampling = 4',
            r"one frame can give 2, with any field, support, NA and pixel pitch; record at least 2 frames",
        ),
        ('frames = 1\nobject = "phase"\noversampling = 5', r"can give 4, .* at least 2 frames"),
        ('frames = 1\nobject = "colour"\noversampling = 2', "recording, object = 'colour'"),
        (
            'frames = 1\nobject = "phase"\noversampling = 2\nsupport_mm = 4',
            "must not exceed the field of 3 mm",
        ),
    ],
)
def test_recordings_that_are_refused(tmp_path: Path, recording: str, message: str) -> None:
    with pytest.raises(DesignError, match=message):
        recorded(tmp_path, recording)


def test_bound_names_each_value_that_could_give_way(tmp_path: Path) -> None:
    with pytest.raises(DesignError) as refused:
        recorded(tmp_path, 'frames = 1\nobject = "complex"\noversampling = 1.5')
    # Pixels in the sensor's circle over 2 SBP, and its scaling with field x NA x pitch.
    largest = math.pi * 3500.0**2 / (2.0 * (math.pi * 1.5 * 0.5 / 0.532e-3) ** 2)
    factor = math.sqrt(largest / 1.5)
    message = str(refused.value)
    assert f"at most {largest:.4g} measurements" in message
    for text, value in (("the field at most ", 3.0), ("NA at most ", 0.5), ("pixel_pitch_um at most ", 3.2)):
        stated = float(message.partition(text)[2].split()[0].rstrip(","))
        assert factor * value * (1.0 - 1e-3) <= stated <= factor * value
    assert f"at least {math.ceil(1.5 / largest)} frames" in message


def test_values_that_the_bound_names_are_possible(tmp_path: Path) -> None:
    recording = 'frames = 1\nobject = "complex"\noversampling = 1.5'
    with pytest.raises(DesignError) as refused:
        recorded(tmp_path, recording)
    field_mm = float(str(refused.value).partition("the field at most ")[2].split()[0])
    change = ("field_diameter_mm = 3.0", f"field_diameter_mm = {field_mm}")
    assert recorded(tmp_path, recording, "", change).recording is not None


def test_bound_has_the_footprint_limit_of_each_recorded_plane(tmp_path: Path) -> None:
    field = ("field_diameter_mm = 3.0", "field_diameter_mm = 1.5")
    limits = ('max_footprint_radius_mm = "sensor"', "max_footprint_radius_mm = [11.0, 6.0]")
    # The wider light has all four measurements that a frame can have.
    narrow = math.pi * (6.0 / 3.2e-3) ** 2 / (math.pi * 0.75 * 0.5 / 0.532e-3) ** 2
    assert narrow < 4.0
    kept = 'frames = 1\nobject = "phase"\noversampling = 3.9'
    assert recorded(tmp_path, kept, "", field, limits).recording is not None
    asked = 4.0 + 1.02 * narrow
    with pytest.raises(DesignError, match=f"at most {4.0 + narrow:.4g} measurements") as refused:
        recorded(tmp_path, f'frames = 2\nobject = "phase"\noversampling = {asked}', "", field, limits)
    pitch_um = float(str(refused.value).partition("pixel_pitch_um at most ")[2].split()[0].rstrip(","))
    assert pitch_um == pytest.approx(3.2 / math.sqrt(1.02), rel=1e-3)


def test_known_support_counts_in_place_of_the_field(tmp_path: Path) -> None:
    recording = 'frames = 1\nobject = "complex"\noversampling = 1.5\nsupport_mm = 1.8'
    specification = recorded(tmp_path, recording)
    smaller = FIELD.changed(specification, 1.5)
    assert smaller.recording is not None
    assert smaller.recording.support_mm == 1.5


def test_pitch_and_aperture_are_not_variables_of_a_search(tmp_path: Path) -> None:
    variable = '\n[[variable]]\nparameter = "pixel_pitch_um"\nbounds = [1.0, 4.0]\n'
    with pytest.raises(DesignError, match=r"pixel_pitch_um.*lensdesign limits"):
        recorded(tmp_path, 'frames = 1\nobject = "phase"\noversampling = 1', variable)
