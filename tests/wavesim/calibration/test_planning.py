"""Which frames to take, as simulations tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.calibration.planning import (
    EXAMPLE,
    MOST_PIXELS,
    Plan,
    Plans,
    Twin,
    _middle,
    _of_strength,
    _strength,
    _twin,
    plan_frames,
    random_objects,
)
from wavesim.fields.field import Field
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import ITERATIONS, Kind, PlanSettings
from wavesim.sensor.imaging import image
from wavesim.sensor.windows import diversity, footprint_mm
from wavesim.targets.patch import object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)


def test_more_planes_tell_more_of_a_complex_object(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ITERATIONS, "object", 15)
    calls: list[tuple[str, int, int]] = []
    found = plan_frames(
        LENS,
        patch_mm=0.02,
        kind="complex",
        most_planes=3,
        exposures=(1.0,),
        progress=lambda *what: calls.append(what),
    )
    near, far = LENS.sensor.plane_distances_mm
    assert [plan.planes_mm for plan in found.plans] == [(near,), (near, far), (near, (near + far) / 2, far)]
    assert found.plans[1].error < 0.5 < found.plans[0].error
    assert {plan.iterations for plan in found.plans} == {15}
    assert [done for _, done, _ in calls] == [0, 0, 1, 2, 3]
    assert found.twin.scale == 1.0
    assert repr(found).startswith("Plans(plans 3, for an object of kind complex, planes ")


@pytest.mark.parametrize("kind", ["complex", "amplitude"])
def test_the_prediction_is_a_range_over_objects_that_change_much_and_little(kind: Kind) -> None:
    patch = object_patch(LENS, 0.03)
    objects = random_objects(patch, PlanSettings(kind=kind))
    strengths = {name: _strength(one.values[patch.inside]) for name, one in objects.items()}
    assert min(strengths.values()) < 0.25 < 0.35 < max(strengths.values())
    if kind == "amplitude":
        assert all(np.isreal(one.values).all() for one in objects.values())


def test_phase_objects_are_a_part_of_the_complex_ones() -> None:
    patch = object_patch(LENS, 0.03)
    phase, complex_ = (random_objects(patch, PlanSettings(kind=kind)) for kind in ("phase", "complex"))
    assert set(phase) < set(complex_)
    for one in phase.values():
        np.testing.assert_allclose(np.abs(one.values), 1.0, atol=1e-6)
        assert 0.1 < _strength(one.values[patch.inside]) < 0.9


@pytest.mark.usefixtures("quick_verdicts")
def test_a_phase_object_comes_out_within_the_predicted_range() -> None:
    """A phase object is not promised what a dense one reaches: smooth phase ends where noise does."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    exposures = (1.0, 30.0)
    found = plan_frames(lens, patch_mm=0.03, kind="complex", most_planes=2, exposures=exposures)
    plan = next(one for one in found.plans if one.frames == 4)
    taken = image(lens, "phase", patch_mm=0.03, exposures=exposures, seed=5)
    outcome = reconstruct_frames(
        lens, taken.frames, patch_mm=0.03, kind="complex", truth=taken.target.transmission
    ).truth["object_correlation"]
    assert outcome is not None
    assert plan.by_object["dense"] > outcome + 0.003
    assert plan.correlation - 0.005 < outcome < plan.highest_correlation + 0.001
    assert plan.highest_correlation == max(plan.by_object.values())
    assert plan.correlation == min(plan.by_object.values())
    assert 0.0 < plan.smooth_fraction < 1.0


@pytest.mark.usefixtures("quick_verdicts")
def test_a_described_object_has_a_prediction_of_its_own() -> None:
    """Frames of another draw of the noise give what is predicted for faint light, within that draw."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    plan = (lens.sensor.plane_distances_mm, (1.0,))
    found = plan_frames(lens, patch_mm=0.03, kind="amplitude", example="star", candidates=[plan])
    (best,) = found.plans
    taken = image(lens, "star", patch_mm=0.03, planes_mm=plan[0], engine="eikonal", error=0.02, seed=5)
    reached = reconstruct_frames(
        lens, taken.frames, patch_mm=0.03, kind="amplitude", truth=taken.target.transmission
    ).truth["object_correlation"]
    assert best.predicted == pytest.approx(reached, abs=0.03)
    assert best.expected == best.predicted
    assert best.misfit_of_example == pytest.approx(1.0, abs=0.2)
    assert set(best.by_object) == {"grains", "fine grains", "few grains"}
    assert best.information is not None
    assert 0.5 < best.information.fraction < 1.0
    assert 0.5 < best.ratio < 2.0
    assert not found.enough
    assert "correlation " + f"{best.predicted:.4f} for star" in repr(found)
    assert "Described object: star, changes" in " ".join(found.assumptions)


def test_the_error_of_a_weaker_object_is_larger_where_it_is_found() -> None:
    plan = Plan((1.0,), (1.0,), 0.9, 1.0, 20, predicted=0.8, misfit_of_example=1.0)
    assert _of_strength(plan, 1.0).predicted == pytest.approx(0.8)
    assert _of_strength(plan, 1.2).predicted == pytest.approx((1.0 - 0.72**2) ** 0.5)
    assert _of_strength(plan, 9.0).predicted == 0.0
    lost = replace(plan, misfit_of_example=5.0)
    assert _of_strength(lost, 1.2) == lost


def test_a_small_twin_images_the_middle_of_an_example() -> None:
    patch = object_patch(LENS, 0.04)
    small = object_patch(LENS, 0.02)
    whole = Field(patch.grid, np.arange(patch.grid.size).reshape(patch.grid.shape), patch.wavelength_um)
    middle = _middle(whole, small)
    offset = (patch.grid.shape[0] - small.grid.shape[0]) // 2
    assert middle.grid == small.grid
    assert middle.values[0, 0] == whole.values[offset, offset]
    assert middle.values[-1, -1] == whole.values[-offset - 1, -offset - 1]


def test_a_described_object_is_tried_on_a_larger_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ITERATIONS, "object", 2)
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    plan = (lens.sensor.plane_distances_mm[1:], (1.0,))
    settings = {"patch_mm": 0.05, "kind": "amplitude", "exposures": (1.0,)}
    found = plan_frames(lens, example="star", candidates=[plan], **settings)
    assert found.example_twin is not None
    assert found.twin.scale < 0.8
    assert found.example_twin.scale == 1.0
    assert found.strengths[EXAMPLE] == pytest.approx(found.example_strength)
    assert "its twin (1 of the lens) images" in " ".join(found.assumptions)
    assert plan_frames(lens, candidates=[plan], **settings).example_twin is None


@pytest.mark.parametrize(
    ("example", "message"),
    [("empty", "changes no light"), ("stars", "did you mean"), ("field", "its grid")],
)
def test_impossible_examples(example: str, message: str) -> None:
    grid = object_patch(LENS, 0.03).grid
    given = Field(grid, np.ones(grid.shape, np.complex64), 0.532) if example == "field" else example
    with pytest.raises(InputError, match=message):
        plan_frames(LENS, patch_mm=0.02, most_planes=1, exposures=(1.0,), example=given)


def test_predictions_state_what_they_assume() -> None:
    found = plan_frames(LENS, patch_mm=0.02, most_planes=1, planes_mm=(0.03, 0.3), exposures=(1.0,))
    assert set(found.strengths) == {"dense", "thin", "steps"}
    said = " ".join(found.assumptions)
    for name in (
        "Objects of kind complex",
        "full well 10000 electrons, read noise 2 electrons, 12 bits",
        "Bench: planes, mounting, light and sensor are exactly as designed",
        f"at most {found.engine_error:.2g}",
        "at most 80 iterations",
        "Smooth phase (less than 4 cycles",
    ):
        assert name in said
    assert "Twin:" not in said
    assert 0.0 < found.engine_error < 0.05
    twin = replace(found, twin=Twin(0.1, 0.02, 20.0, 4.0), diversity=30.0)
    assert "Its planes have a diversity of 4, those of the lens 30: objects that" in " ".join(
        twin.assumptions
    )


def test_a_large_lens_is_tried_on_a_twin() -> None:
    """Where field and samples leave room, of the same diversity: dz w^2 / (lambda f^2)."""
    lens, settings = scaled(load_design("designs/paper_singlet.toml"), 1 / 4), PlanSettings()
    patch = object_patch(lens, 0.12)
    twin = _twin(lens, patch, settings, 5.5)
    assert twin.scale < 0.5
    assert twin.diversity == pytest.approx(diversity(lens, patch, (0.5, 5.5)), rel=0.03)
    assert twin.read_noise_electrons == pytest.approx(2.0 * 0.12 / twin.patch_mm)
    across = footprint_mm(scaled(lens, twin.scale), object_patch(lens, twin.patch_mm), 5.5 * twin.scale)
    assert across / 3.2e-3 < 1.2 * MOST_PIXELS


def test_the_fewest_frames_that_are_enough_are_recommended() -> None:
    plans = tuple(
        Plan(tuple(float(n) for n in range(1, planes + 1)), exposures, correlation, 1.0, 20)
        for planes, exposures, correlation in (
            (1, (1.0,), 0.5),
            (2, (1.0,), 0.97),
            (1, (1.0, 30.0), 0.6),
            (4, (1.0,), 0.992),
            (2, (1.0, 30.0), 0.995),
        )
    )
    found = Plans(PlanSettings(), Twin(1.0, 0.1, 2.0, 30.0), 30.0, plans)
    assert found.recommended is plans[3]
    assert found.recommended.frames == 4
    assert found.enough
    strict = replace(found, settings=PlanSettings(correlation=0.999))
    assert strict.recommended is plans[4]
    assert not strict.enough
    assert strict.at_noise
    assert not replace(found, plans=(replace(plans[0], misfit_over_noise=1.3),)).at_noise
    assert plans[0].error == pytest.approx(0.75**0.5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"planes_mm": (2.0, 1.0)}, r"planes_mm: .*two numbers"),
        ({"most_planes": 0}, "most_planes"),
        ({"correlation": 1.0}, "correlation"),
        ({"exposures": (0.0, 1.0)}, r"exposures.* 0"),
        ({"patch_mm": 9.0}, "patch"),
        ({"patch_mm": 1e-6}, "patch_mm = 1e-06: gives"),
        ({"patch_mm": 0.001}, "patch_mm = 0.001: gives"),
        ({"patch_mm": 0.01, "planes_mm": (1e8, 1e9)}, "or nearer planes"),
        ({"patch_mm": 0.01, "read_noise_electrons": 1e6}, "no light beyond their noise"),
        ({"patch_mm": 0.01, "bits": 1, "exposures": (1.0,)}, "no light beyond their noise"),
    ],
)
def test_refused(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_frames(LENS, **changes)


def test_a_design_of_one_plane_asks_for_two() -> None:
    lens = LENS.replaced(sensor=LENS.sensor.replaced(plane_distances_mm=(0.1,)))
    with pytest.raises(InputError, match=r"one plane, at 0\.1 mm"):
        plan_frames(lens, patch_mm=0.02)
