"""The runner of the verdicts' benchmark, on two wrong inputs and two perfect benches."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.verdicts import cases
from benchmarks.verdicts.__main__ import main
from benchmarks.verdicts.benches import Bench
from benchmarks.verdicts.cases import Case, at_planes, clipped
from benchmarks.verdicts.judging import Judge, Result, rule_kept
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials

SMALL = Bench(
    1 / 48,
    "star",
    patch_mm=0.03,
    pixels=140,
    imaged=cases.QUICK,
    reconstructed=(*cases.QUICK, ("iterations", 12)),
)


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    return Judge(tmp_path_factory.mktemp("frames"))


@pytest.mark.parametrize("seed", [0, 3])
def test_perfect_benches_end_with_0(judge: Judge, seed: int) -> None:
    result = judge.result(Case(f"perfect, {seed}", "perfect", SMALL, cases.imaged(seed=seed)))
    assert (result.status, result.kept, result.named) == (0, True, None)
    assert result.correlation == result.right
    assert result.correlation is not None
    assert result.correlation > 0.98
    assert result.over_noise is not None
    assert result.over_noise < 1.3


def test_a_wrong_input_is_compared_with_the_right_one(judge: Judge) -> None:
    case = Case(
        "planes swapped",
        "wrong",
        SMALL,
        lambda bench: at_planes(bench.frames(), *bench.planes_mm[::-1]),
        ("planes swapped",),
    )
    result = judge.result(case)
    assert (result.status, result.kept) == (1, True)
    assert result.correlation is not None
    assert result.right is not None
    assert result.correlation < result.right - 0.05


def test_a_refusal_is_status_2(judge: Judge) -> None:
    case = Case("saturated", "wrong", SMALL, cases.imaged(exposures=(3000.0,)), cases.CLIPPED)
    result = judge.result(case)
    assert (result.status, result.kept, result.named) == (2, True, True)
    assert result.correlation is None
    assert "saturated" in result.message


def test_what_ends_with_0_must_be_right() -> None:
    """A wrong input that passes for right, with an object that is far from the right one, breaks the rule."""
    assert not rule_kept(Case("a", "wrong", SMALL), 0, 0.9, 0.95)
    assert rule_kept(Case("a", "wrong", SMALL), 0, 0.945, 0.95)
    assert rule_kept(Case("a", "wrong", SMALL), 2, None, 0.95)
    assert not rule_kept(Case("a", "wrong", SMALL), 3, None, 0.95)
    assert not rule_kept(Case("a", "perfect", SMALL), 1, 0.998, 0.998)


def test_cases_are_chosen_by_name_and_kept_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "benchmarks.verdicts.__main__.CASES",
        (
            Case("one bench", "perfect", SMALL),
            Case("another", "wrong", SMALL, lambda b: clipped(b.frames(), 0.3)),
        ),
    )
    results: list[Result] = main(["one b", "--json", str(tmp_path / "results.json")])
    assert [one.name for one in results] == ["one bench"]
    assert json.loads((tmp_path / "results.json").read_text())[0]["status"] == results[0].status
    assert "perfect: 0 of 1 do not end with 0" in capsys.readouterr().out


def test_no_two_cases_have_the_same_name_and_there_are_enough() -> None:
    names = [case.name for case in cases.CASES]
    assert len(set(names)) == len(names)
    assert sum(case.group == "wrong" for case in cases.CASES) >= 24
    assert sum(case.group == "perfect" for case in cases.CASES) >= 20


def test_frames_of_lenses_that_differ_in_the_sensor_alone_are_not_the_same(
    judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CauseTrials, "trials", lambda _: [])  # no cause is asked for
    result = judge.result(Case("pixels larger by 15 %", "cause", SMALL, cases.pitch(1.15)))
    assert result.correlation is not None
    assert result.right is not None
    assert result.correlation < result.right - 0.01
