"""A verdict from residuals: explained or not, where, and what most likely differs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from wavesim.metrics.goodness_of_fit import (
    HELD_LIMIT,
    LIMIT,
    Finding,
    Trial,
    verdict,
    with_finding,
)
from wavesim.metrics.next_steps import STOP_CAUSE
from wavesim.metrics.plane_residuals import PlaneResidual

SHAPE = (64, 80)


def plane(times: float = 1.0, held_times: float = 1.0, bump: float = 0.0, seed: int = 0) -> PlaneResidual:
    """Residuals of so many times the noise, with a bump in the last block, and 100 pixels held out."""
    random = np.random.default_rng(seed)
    amplitude, sigma = np.ones(SHAPE), np.full(SHAPE, 0.05)
    error = times * 0.05 * random.standard_normal(SHAPE)
    held = np.arange(0, 5000, 50)
    error.ravel()[held] *= held_times / times
    error[56:, 70:] += bump
    sigma.ravel()[held] = np.inf
    return PlaneResidual(1.5, amplitude, sigma, error, held, np.full(len(held), 0.05))


def test_noise_is_explained() -> None:
    found = verdict([plane(), plane(seed=1)])
    assert found.explained
    assert found.over_noise == pytest.approx(1.0, abs=0.05)
    assert found.held_out_over_noise == pytest.approx(1.0, abs=0.2)
    assert found.words.startswith("explained within the noise")
    assert (found.cause, found.next_step) == ("", "")


@pytest.mark.parametrize(
    "planes",
    [
        [plane(1.2 * LIMIT), plane()],
        [plane(), plane(held_times=1.3 * HELD_LIMIT**2)],
        [plane(), plane(bump=0.8)],
    ],
)
def test_more_than_noise_is_not_explained(planes: list[PlaneResidual]) -> None:
    found = verdict(planes)
    assert not found.explained
    assert found.cause == "lens or light"
    assert "not explained" in found.words


def test_the_plane_and_the_place_are_told() -> None:
    found = verdict([plane(), plane(bump=0.8)])
    assert found.worst_plane == 1
    assert found.planes[1].region_px == (70, 56, 10, 8)
    assert found.planes[1].region_over_noise > 10.0
    assert "in the 10 x 8 pixels from 70, 56 on" in found.words


def test_the_best_trial_names_the_cause_and_what_to_do() -> None:
    trials = [Trial("light", "light tilted", 0.8), Trial("planes swapped", "planes 1 and 2 exchanged", 0.3)]
    found = verdict([plane(3.0)], trials)
    assert found.cause == "planes swapped"
    assert "planes 1 and 2 exchanged" in found.evidence
    assert "in the other order" in found.next_step


@pytest.mark.parametrize(("shift", "cause"), [(0.29, "light"), (0.2, "shift")])
def test_what_changes_more_must_be_better(shift: float, cause: str) -> None:
    trials = [Trial("shift", "frames shifted", shift), Trial("light", "light tilted", 0.3)]
    assert verdict([plane(3.0)], trials).cause == cause


def test_trials_that_gain_little_name_nothing() -> None:
    found = verdict([plane(3.0)], [Trial("light", "light tilted", 0.95)])
    assert found.cause == "lens or light"


def test_the_finding_or_trial_that_explains_most_is_named() -> None:
    """A trial explains as much of the chi-square as its misfit is below that of the result."""
    wrong, size = plane(3.0), np.prod(SHAPE)
    mirrored = Finding("orientation", "the picture of plane 1 fits better mirrored", 0.6 * 8.0 * size)
    distance = "planes farther from each other"
    slow, sure = Trial("distance", distance, 0.5, 0.4), Trial("distance", distance, 0.5, 0.1)
    named = [verdict([wrong], [one], [1.0, 0.3], findings=[mirrored]) for one in (slow, sure)]
    assert [one.cause for one in named] == ["orientation", "distance"]
    for one in named:
        assert mirrored.explanation in one.words
    shifted = Finding("shift", "the picture of plane 1 fits better shifted", 500.0)
    assert verdict([wrong], [Trial("light", "light tilted", 0.95)], findings=[shifted]).cause == "shift"


def test_a_misfit_that_still_falls_asks_for_iterations() -> None:
    assert verdict([plane(3.0)], curve=[1.0, 0.8, 0.6, 0.5, 0.45]).cause == "iterations"
    assert verdict([plane(3.0)], curve=[0.5, 0.41, 0.41, 0.4, 0.4]).cause == "lens or light"


def test_starts_that_end_elsewhere_are_no_result() -> None:
    found = verdict([plane()], agreement=0.5)
    assert (found.explained, found.cause) == (False, "several objects")
    assert verdict([plane()], agreement=0.99).explained


def test_engine_and_pixels_may_err_where_there_is_no_noise() -> None:
    quiet = plane()._replace(sigma=np.full(SHAPE, 1e-6), held_sigma=np.full(100, 1e-6))
    assert verdict([quiet._replace(error=np.full(SHAPE, 0.004))]).explained
    assert not verdict([quiet._replace(error=np.full(SHAPE, 0.02))]).explained


def test_residuals_without_held_out_pixels_state_no_ratio_on_them() -> None:
    none_held = plane()._replace(held=np.zeros(0, np.intp), held_sigma=np.zeros(0))
    found = verdict([none_held, none_held])
    assert found.held_out_over_noise is None
    assert found.as_dict()["held_out_over_noise"] is None
    assert "0 times" not in found.words
    assert verdict([none_held, plane()]).held_out_over_noise == pytest.approx(1.0, abs=0.2)


def test_a_plane_that_was_held_out_altogether_is_judged_by_its_pixels() -> None:
    one = plane()
    every = np.arange(one.error.size)
    held = one._replace(sigma=np.full(SHAPE, np.inf), held=every, held_sigma=np.full(every.size, 0.05))
    found = verdict([plane(seed=2), held])
    assert found.explained
    assert found.planes[1].over_noise is None
    assert found.planes[1].held_out_over_noise == pytest.approx(1.0, abs=0.05)


def test_it_goes_into_json() -> None:
    result: dict[str, Any] = json.loads(
        json.dumps(verdict([plane(3.0)], [Trial("light", "x", 0.5)]).as_dict())
    )
    assert result["explained"] is False
    assert result["trials"] == [{"cause": "light", "told": "x", "misfit_ratio": 0.5}]


def test_overfitting_is_not_taken_for_a_wrong_bench() -> None:
    """A fit of many unknowns leaves less than the noise where it was fitted, and as much more elsewhere."""
    assert verdict([plane(0.8, 1.5), plane()]).explained
    assert not verdict([plane(1.1, 1.9), plane()]).explained


def test_a_finding_makes_a_result_untrusted_and_the_surest_names_the_cause() -> None:
    against = [Finding("shift", "it fits better shifted", 200.0), Finding("mounting", "decentered", 900.0)]
    found = verdict([plane()], findings=against)
    assert (found.explained, found.within, found.cause) == (False, True, "mounting")
    assert found.words.startswith("not to be trusted")
    assert found.as_dict()["findings"][0]["chi_square"] == 900.0


def test_residuals_far_below_the_noise_are_a_finding() -> None:
    found = verdict([plane(0.15, 0.15), plane(0.15, 0.15)])
    assert (found.explained, found.cause) == (False, "noise parameters")
    json.dumps(found.as_dict(), allow_nan=False)


def test_calibration_is_no_advice_after_a_calibration() -> None:
    assert "run `wavesim calibrate`" in verdict([plane(3.0)]).next_step
    assert "run `wavesim calibrate`" not in verdict([plane(3.0)], calibrated=True).next_step


def test_the_error_of_the_engine_counts_as_noise() -> None:
    wrong = plane()._replace(error=np.full(SHAPE, 0.2))
    assert not verdict([wrong]).explained
    assert verdict([wrong._replace(engine_error=np.full(SHAPE, 0.2))]).explained


def test_contributions_add_up_and_noise_contributes_little() -> None:
    noisy = plane()._replace(sigma=np.full(SHAPE, 3.0), held=np.arange(0))
    noisy = noisy._replace(held_sigma=np.zeros(0))
    first, second = verdict([plane(), noisy]).planes
    assert first.contribution + second.contribution == pytest.approx(1.0)
    assert second.contribution < 0.15
    assert second.signal_to_noise < 1.0


def test_a_finding_takes_trust_from_an_explained_result_and_leaves_another_cause() -> None:
    finding = Finding(STOP_CAUSE, "stop and object may be displaced together")
    doubted = with_finding(verdict([plane(), plane(seed=1)]), finding)
    assert (doubted.explained, doubted.cause) == (False, STOP_CAUSE)
    assert doubted.words.startswith("not to be trusted")
    assert "--field-stop-at-mm" in doubted.next_step
    other = with_finding(verdict([plane(1.2 * LIMIT)]), finding)
    assert (other.explained, other.cause, other.findings) == (False, "lens or light", (finding,))


def test_a_bandwidth_that_explains_frames_is_named_with_its_remedy() -> None:
    trials = [Trial("source", "source 0.2° wide", 0.7), Trial("bandwidth", "bandwidth of 9 nm", 0.3)]
    found = verdict([plane(1.2 * LIMIT)], trials)
    assert found.cause == "bandwidth"
    assert "also helps: source 0.2° wide" in found.words
    assert "--bandwidth-nm" in found.next_step
