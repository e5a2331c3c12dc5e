"""A calibrated bench: the object that its calibration has judged, and what is not tested again."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from wavesim.metrics.goodness_of_fit import (
    BenchUncertainty,
    Finding,
    GoodnessOfFit,
    PlaneFit,
    Trial,
    Undetected,
)
from wavesim.metrics.noise_parameters import NoiseCheck
from wavesim.reconstruction.calibrated_bench import (
    CalibratedBench,
    JudgedObject,
    key_of_pictures,
    read_judged_object,
)
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.system_state import SystemState
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
    found = read_judged_object(path)
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
    assert read_judged_object(path) is not None
    with np.load(path) as stored:
        changed = dict(stored)
    np.savez(path, **changed | {"transmission": 2.0 * changed["transmission"]})
    assert read_judged_object(path) is None
    judged.write(path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "of another user"))
    assert read_judged_object(path) is None


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04", b"not an archive"])
def test_a_missing_or_damaged_file_holds_no_object(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "object.npz"
    if content is not None:
        path.write_bytes(content)
    assert read_judged_object(path) is None


def test_only_the_frames_of_a_calibration_need_no_test_of_what_it_has_determined() -> None:
    """Of other frames through a decentered lens, the verdict tests the mounting, too."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    settings = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.1}
    taken = image(lens, "star", exposures=(1.0,), seed=3, **settings).frames
    sought = frozenset(("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "plane_distance_2_mm"))
    bench = CalibratedBench(SystemState(), sought, key_of_pictures(taken[::-1]))

    def tested(bench: CalibratedBench) -> list[str]:
        search = {"kind": "amplitude", "iterations": 40, **settings}
        verdict = reconstruct_frames(lens, taken, calibration=bench, **search).verdict
        assert verdict.explained, verdict.words
        return [one.parameter for one in verdict.undetected]

    assert tested(bench) == ["working_distance_mm", "source_deg", "bandwidth_nm"]
    assert len(tested(replace(bench, frames_key="of other frames"))) == 7
