"""A calibrated bench: the object that its calibration has judged, and what is not tested again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Pose, load_design, scaled
from wavesim.metrics.goodness_of_fit import (
    BenchUncertainty,
    Finding,
    GoodnessOfFit,
    PlaneFit,
    Trial,
    Undetected,
)
from wavesim.metrics.noise_parameters import NoiseCheck
from wavesim.reconstruction.calibrated_bench import CalibratedBench, JudgedObject, read_judged_object
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.reconstruction.problem import evidence_key, patch_of_frames, reconstruction_problem
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image

NUMBERS = st.floats(0.0, 1e3)

VERDICT = GoodnessOfFit(True, 1.0, None, 0, (), "", "", "", ())


@st.composite
def verdicts(draw: st.DrawFn) -> GoodnessOfFit:
    number = draw(NUMBERS)
    plane = PlaneFit(0.125, number, draw(st.none() | NUMBERS), 0.5, number, (0, 8, 16, 16), number)
    chi_square = draw(st.just(math.inf) | NUMBERS)
    return GoodnessOfFit(
        explained=draw(st.booleans()),
        over_noise=number,
        held_out_over_noise=draw(st.none() | NUMBERS),
        worst_plane=0,
        planes=(plane,) * draw(st.integers(1, 3)),
        cause=draw(st.sampled_from(["", "mounting"])),
        evidence="frames prefer another bench",
        next_step="",
        trials=(Trial("shift", "plane 2 shifted", 0.5, number),),
        agreement=draw(st.none() | NUMBERS),
        findings=(Finding("mounting", "decentered", chi_square),),
        noise=draw(
            st.none() | st.builds(NoiseCheck, NUMBERS, st.none() | NUMBERS, NUMBERS, st.booleans(), st.text())
        ),
        undetected=(Undetected("source_deg", number, 0.99),),
        noise_correlation=draw(st.none() | NUMBERS),
        bench=draw(
            st.none() | st.builds(BenchUncertainty, NUMBERS, NUMBERS, st.just({"x": 0.1}), st.just({}))
        ),
    )


@given(verdicts())
def test_a_judged_object_comes_back_from_its_file(
    tmp_path_factory: pytest.TempPathFactory, verdict: GoodnessOfFit
) -> None:
    values = np.array([[1.0 + 2.0j, 0.5], [0.0, -1j]], np.complex64)
    maps = tuple(np.full((3, 4), index, np.float32) for index in range(12))
    judged = JudgedObject("key", values, maps, (0.5, 0.25), {"scale": 1.02, "misfit": 0.25}, verdict)
    path = tmp_path_factory.mktemp("judged") / "object.npz"
    judged.write(path)
    assert read_judged_object(path, "of other inputs") is None
    found = read_judged_object(path, "key")
    assert found is not None
    assert (found.key, found.curve, found.of_method, found.verdict) == (
        judged.key,
        judged.curve,
        judged.of_method,
        verdict,
    )
    assert np.array_equal(found.transmission, values)
    assert [one.tolist() for one in found.residual_maps] == [one.tolist() for one in maps]


def test_an_object_of_somebody_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    judged, path = JudgedObject("key", np.ones((2, 2), complex), (), (0.5,), {}, VERDICT), tmp_path / "o.npz"
    judged.write(path)
    assert read_judged_object(path, "key") is not None
    with np.load(path) as stored:
        changed = dict(stored)
    for other in (2.0 * changed["transmission"], changed["transmission"].reshape(4, 1)):
        np.savez(path, **changed | {"transmission": other})
        assert read_judged_object(path, "key") is None
    judged.write(path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "of another user"))
    assert read_judged_object(path, "key") is None


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04", b"not an archive"])
def test_a_missing_or_damaged_file_holds_no_object(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "object.npz"
    if content is not None:
        path.write_bytes(content)
    assert read_judged_object(path, "key") is None


LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
SETTINGS = ReconstructionSettings(kind="amplitude", iterations=40, patch_mm=0.05, engine="eikonal", error=0.1)
SOUGHT = frozenset(("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "plane_distance_2_mm"))


@pytest.fixture(scope="module")
def frames() -> tuple[Frame, ...]:
    patch = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.1}
    return image(LENS, "star", exposures=(1.0,), seed=3, **patch).frames


@pytest.fixture(scope="module")
def bench(frames: tuple[Frame, ...]) -> CalibratedBench:
    key = evidence_key(LENS, patch_of_frames(LENS, frames[::-1], SETTINGS), SETTINGS)
    return CalibratedBench(SystemState(), SOUGHT, key)


def test_what_a_calibration_has_sought_with_the_same_frames_is_not_tested_again(
    frames: tuple[Frame, ...], bench: CalibratedBench
) -> None:
    """In other frames through the same lens, the verdict tests the mounting, too."""

    def tested(bench: CalibratedBench) -> list[str]:
        verdict = reconstruct_frames(LENS, frames, SETTINGS, calibration=bench).verdict
        assert verdict.explained, verdict.words
        return [one.parameter for one in verdict.undetected]

    assert tested(bench) == ["working_distance_mm", "source_deg", "bandwidth_nm"]
    assert len(tested(replace(bench, evidence_key="of other frames"))) == 7


@pytest.mark.parametrize(
    "changes", [{"kind": "complex"}, {"scale": 1.0}, {"illumination": "tilted", "light_tilt_deg": (0.1, 0.0)}]
)
def test_other_assumptions_are_other_evidence(
    frames: tuple[Frame, ...], bench: CalibratedBench, changes: dict[str, Any]
) -> None:
    def sought(settings: ReconstructionSettings) -> frozenset[str]:
        return reconstruction_problem(LENS, frames, settings, None, bench, None).sought

    assert sought(SETTINGS) == SOUGHT
    assert sought(SETTINGS.replaced(**changes)) == frozenset()


@pytest.mark.parametrize(
    "change",
    [
        {"vibration_um": 0.3},
        {"nonlinearity": 0.01},
        {"plane_exposure_errors": (0.0, 0.02)},
        {"pose": Pose(decenter_x_mm=1e-5)},
    ],
)
def test_a_result_has_a_key_of_the_whole_state(
    frames: tuple[Frame, ...], bench: CalibratedBench, change: dict[str, Any]
) -> None:
    other = replace(bench, state=replace(bench.state, **change))
    keys = [
        reconstruction_problem(LENS, frames, SETTINGS, None, one, None).key for one in (bench, bench, other)
    ]
    assert keys[0] == keys[1] != keys[2]


def test_a_judged_complex_object_is_compared_as_one_that_is_found(frames: tuple[Frame, ...]) -> None:
    settings = SETTINGS.replaced(kind="complex", iterations=2)
    truth = image(LENS, "star", exposures=(1.0,), seed=3, patch_mm=0.05, engine="eikonal", error=0.1).target
    given = {"truth": truth.transmission, "calibration": CalibratedBench(SystemState())}
    found = reconstruct_frames(LENS, frames, settings, **given)
    judged = JudgedObject.of(found)
    given["calibration"] = CalibratedBench(
        SystemState(), judged_with=lambda key: judged if key == judged.key else None
    )
    again = reconstruct_frames(LENS, frames, settings, **given)
    assert again.of_method.pop("found_by") == "calibration"
    summaries = [one.as_dict() for one in (again, found)]
    for summary in summaries:
        summary["memory"].pop("limit_bytes")  # it depends on what is free at the moment
    assert summaries[0] == summaries[1]
    assert "correlation_without_low_orders" in again.truth
