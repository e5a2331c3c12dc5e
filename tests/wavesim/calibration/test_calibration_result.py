"""A calibration whose field stop was found from the frames."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from lensdesign import load_design
from lensdesign.errors import InputError
from wavesim.calibration.calibration_result import Calibrated, bench_uncertainty_of, field_stop_of
from wavesim.calibration.parameters import parameters_by_name
from wavesim.scene.settings import StopOrigin
from wavesim.scene.system_state import SystemState

PARAMETERS = parameters_by_name(load_design("designs/paper_singlet.toml"))


def calibrated(applied: dict[str, float], origin: StopOrigin = "frames") -> Calibrated:
    sought, values = tuple(PARAMETERS[name] for name in applied), tuple(applied.values())
    found = Calibrated(SystemState(), sought, values, None, None, 0.1, 0.1, (), "converged", None)
    return replace(found, applied=applied, field_stop_mm=0.02, field_stop_from=origin)


@pytest.mark.parametrize("name", ["light_amplitude_10", "decenter_x_mm", "plane_2_shift_x_um"])
def test_a_stop_found_on_the_nominal_bench_is_undetermined_where_the_bench_is_another(
    name: str, tmp_path: Path
) -> None:
    found = calibrated({"light_tilt_x_deg": 0.0, name: 0.1})
    assert name in found.stop_warning
    assert "light_tilt_x_deg" not in found.stop_warning
    assert "field_stop_x_mm" in found.as_dict()["undetermined"]
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(found.as_dict()))
    assert field_stop_of(path) == (0.02, (0.0, 0.0), found.stop_warning)


@pytest.mark.parametrize(
    "found",
    [
        calibrated({"light_amplitude_10": 0.0, "plane_1_background": 0.01}),
        calibrated({"light_amplitude_10": 0.1}, "stated"),
        calibrated({"light_amplitude_10": 0.1}, "patch"),
    ],
)
def test_a_stated_stop_and_a_nominal_bench_leave_no_doubt(found: Calibrated) -> None:
    assert not found.stop_warning
    assert not found.as_dict()["undetermined"]


@pytest.mark.parametrize(("deviation_mm", "warns"), [(2e-4, False), (2e-3, True)])
def test_a_stop_that_was_sought_is_as_certain_as_its_deviation(deviation_mm: float, warns: bool) -> None:
    names = "field_stop_shift_x_mm", "field_stop_shift_y_mm"
    found = replace(
        calibrated({"decenter_x_mm": 0.01, **dict.fromkeys(names, 0.001)}),
        deviations=(0.001, 1e-4, deviation_mm),
    )
    assert ("2 µm" in found.stop_warning) is warns
    assert bool(found.as_dict()["undetermined"]) is warns


def test_what_a_bench_leaves_of_the_object_is_read_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    stated = {"correlation": 0.4, "correlation_without_low_orders": 0.98, "phase_waves": {"ramp x": 0.3}}
    stated |= {"amplitude": {"curvature y": 0.1}, "position_um": {"x": 1.5, "y": 0.25}}
    path.write_text(json.dumps({"object_uncertainty": stated}))
    found = bench_uncertainty_of(path)
    assert found is not None
    assert vars(found) == stated
    assert "phase, which light and mounting change alike (waves): ramp x ±0.3" in found.words
    assert "amplitude, which uneven light changes alike (relative): curvature y ±0.1" in found.words
    assert (
        "position of the object, which decenter and light change alike: x ±1.5 µm, y ±0.25 µm" in found.words
    )
    path.write_text(json.dumps({}))
    assert bench_uncertainty_of(path) is None


@pytest.mark.parametrize("stated", [0.9, {"correlation": "high"}, {"correlation": 0.9}])
def test_an_unreadable_statement_is_refused(tmp_path: Path, stated: object) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"object_uncertainty": stated}))
    with pytest.raises(InputError, match=r"calibration\.json"):
        bench_uncertainty_of(path)
