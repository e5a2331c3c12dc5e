"""Light, lens, mounting and camera from frames of an object that nobody knows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_twins import bars_under_stop, unknowns

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.calibration.calibration_result import correlated_parameters, read_calibration
from wavesim.calibration.joint.pixels import DensePixels, RayDerivatives
from wavesim.calibration.joint.search import FitResult, JointSearch, SearchState
from wavesim.calibration.parameters import Unknowns, bench_parameters, chosen_parameters
from wavesim.engines.choosing import engine_for
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement, noise_misfit, placed_planes

TRUE = {
    "light_tilt_x_deg": 0.25,
    "light_tilt_y_deg": -0.15,
    "light_phase_20_waves": 0.04,
    "plane_2_shift_x_um": 1.5,
    "plane_distance_2_mm": 4e-3,
    "surface_1_index": 1e-3,
    "vibration_variance_um2": 0.5,
}
BACKGROUND, VIBRATION = 0.01, "vibration_variance_um2"


def tiles(scene: Scene) -> Engine:
    return engine_for(scene, "eikonal", error=0.3)


@pytest.fixture(scope="module")
def lens() -> Lens:
    return scaled(load_design("designs/paper_singlet.toml"), 1 / 32)


@pytest.fixture(scope="module")
def search(lens: Lens) -> JointSearch:
    """Bars on a small twin's bench, with noise; its light, lens and camera differ from the design."""
    scene, light, bars, rng = bars_under_stop()
    bench = unknowns(TRUE, lens).state
    blank = [Measurement(d, np.ones(scene.exit_grid.shape, np.float32)) for d in (0.0, 0.6)]
    model = ChannelModel.of_source(
        tiles(placed_scene(scene, bench)), placed_light(light, bench), placed_planes(blank, bench), 1.0, 1.0
    )
    recorded = []
    for plane, seen in zip(blank, model.amplitudes(bars), strict=True):
        if plane is blank[1]:
            seen = np.sqrt(seen**2 + BACKGROUND * np.mean(seen**2))
        # Half of the mean intensity's root: amplitudes of shot noise.
        sigma = np.full(seen.shape, 0.02 * float(np.sqrt(np.mean(seen**2))), np.float32)
        noisy = np.maximum(seen + sigma * rng.standard_normal(seen.shape), 0.0).astype(np.float32)
        recorded.append(Measurement(plane.distance_mm, noisy, sigma))
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    return JointSearch(
        DensePixels(scene, light, recorded, None, 1.0, tiles),
        "amplitude",
        chosen_parameters(",".join([*TRUE, "plane_2_background"]), allowed),
        8,
        40,
        noise_misfit(recorded),
    )


@pytest.fixture(scope="module")
def result(search: JointSearch, lens: Lens) -> FitResult:
    return search.run(SearchState(Unknowns()))


def test_what_differs_is_found_with_its_uncertainty(search: JointSearch, result: FitResult) -> None:
    assert result.misfit < 0.3 * result.trail[0][1]
    assert search.noise_misfit is not None
    assert result.misfit < 1.5 * search.noise_misfit
    for parameter, deviation in zip(search.parameters, result.deviations, strict=True):
        found, true = result.unknowns.values[parameter], TRUE.get(parameter.name, BACKGROUND)
        assert abs(found - true) < 3.0 * deviation, (parameter.name, found, deviation)
    assert all(0.0 < d <= p.typical for d, p in zip(result.deviations, search.parameters, strict=True))


@pytest.mark.parametrize(("noise_misfit", "eliminated"), [(0.01, 6), (0.0349, 0), (None, 0)])
def test_what_explains_errors_of_the_model_by_chance_is_not_needed(
    search: JointSearch,
    lens: Lens,
    monkeypatch: pytest.MonkeyPatch,
    noise_misfit: float | None,
    eliminated: int,
) -> None:
    """Far above the noise, two of eight parameters reduce the misfit by more than 1/60 of its square."""
    count, lowest = len(search.parameters), 0.035
    estimates = np.array([3.0, 2.5, *np.linspace(0.1, 1.0, count - 2)])
    rises = np.array([1.0, 1.0, *np.full(count - 2, 0.9 / 60.0)])

    def fit(_: JointSearch, square: float, unknowns: Unknowns, start: Any) -> Any:
        is_nominal = unknowns.of(search.parameters) == 0.0
        misfit = lowest * np.sqrt(1.0 + np.sum(rises[is_nominal]))
        return SimpleNamespace(misfit=misfit, unknowns=unknowns) if misfit**2 <= square else None

    monkeypatch.setattr(JointSearch, "_fit_within", fit)
    monkeypatch.setattr("wavesim.calibration.joint.search.EQUAL_RATIO", 1.0)
    best = SimpleNamespace(misfit=lowest, unknowns=Unknowns(), transmission=None)
    _, needed = replace(search, noise_misfit=noise_misfit)._with_fewer(best, estimates, np.eye(count))
    assert needed.tolist() == [True, True, *[eliminated == 0] * (count - 2)]


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_a_parameter_ends_at_the_end_of_its_range(lens: Lens, start: float) -> None:
    """Pictures of small pixels are sharper than those of large ones, which no vibration can explain.

    A search that has found a vibration, and tries no further bench, does not keep it.
    """
    scene, light, bars, rng = bars_under_stop()
    blank = [Measurement(d, np.ones(scene.exit_grid.shape, np.float32)) for d in (0.0, 0.6)]
    engine, shift = tiles(scene), SystemState(plane_shifts_um=((0.0, 0.0), (1.0, 0.0)))
    recorded = []
    for amplitude in ChannelModel.of_source(engine, light, placed_planes(blank, shift), 1.0, 0.5).amplitudes(
        bars
    ):
        sigma = np.full(amplitude.shape, 0.01 * float(np.sqrt(np.mean(amplitude**2))), np.float32)
        noisy = np.maximum(amplitude + sigma * rng.standard_normal(amplitude.shape), 0.0).astype(np.float32)
        recorded.append(Measurement(blank[len(recorded)].distance_mm, noisy, sigma))
    parameters = chosen_parameters(f"{VIBRATION},plane_2_shift_x_um", bench_parameters(lens, 2, 0.06, 0.532))
    pixels = DensePixels(scene, light, recorded, None, 1.0, tiles)
    noise = noise_misfit(recorded)
    most = 8 if start == 0.0 else 1
    found = JointSearch(pixels, "amplitude", parameters, 4, most, noise, known=bars).run(
        SearchState(unknowns({VIBRATION: start}, lens), stage=1)
    )
    by_name = dict(zip((p.name for p in parameters), found.estimates.tolist(), strict=True))
    assert by_name[VIBRATION] == 0.0
    assert by_name["plane_2_shift_x_um"] == pytest.approx(1.0, abs=0.1)
    assert found.unknowns.values[parameters[1]] == 0.0


def fit_and_count_rays(
    search: JointSearch, start: Unknowns, monkeypatch: pytest.MonkeyPatch
) -> tuple[int, FitResult]:
    """Count the derivatives of the rays of tiles, and return the result of a search."""
    asked: list[str] = []
    told_of = DensePixels.ray_derivatives

    def counted(self: DensePixels, *given: Any) -> RayDerivatives | None:
        asked.append("rays")
        return told_of(self, *given)

    monkeypatch.setattr(DensePixels, "ray_derivatives", counted)
    found = search.run(SearchState(start))
    return len(asked), found


def test_tiles_are_made_anew_only_where_turned_ones_mislead(
    search: JointSearch, lens: Lens, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search goes on from tiles of its bench's own, which are tried, too."""
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    search = replace(search, parameters=chosen_parameters("plane_distance_2_mm,surface_1_index", allowed))
    times, perturbed = fit_and_count_rays(search, unknowns(TRUE, lens), monkeypatch)
    assert times == 1
    misled = iter([True, False])
    monkeypatch.setattr(JointSearch, "_is_misled", lambda *_: next(misled))
    times, again = fit_and_count_rays(search, unknowns(TRUE, lens), monkeypatch)
    assert times == 2
    assert len(again.trail) > len(perturbed.trail)


def test_iterations_are_doubled_until_the_object_has_settled(search: JointSearch, lens: Lens) -> None:
    """One iteration leaves more misfit of the object than of the bench; a resumed search makes as many."""
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    parameters = chosen_parameters("plane_2_shift_x_um", allowed)
    stages: list[str] = []
    few = replace(
        search,
        parameters=parameters,
        iterations=1,
        on_stage=lambda stage, done, total: stages.append(stage),
    )
    states: list[SearchState] = []
    start = unknowns(TRUE | {"plane_2_shift_x_um": 0.0}, lens)
    found = replace(few, keep=states.append).run(SearchState(start))
    assert 4 <= max(state.iterations for state in states) <= 40
    assert found.trail[-1][1] < 0.7 * found.trail[0][1]
    assert found.unknowns.of(parameters)[0] == pytest.approx(1.5, abs=0.05)
    assert {"estimates", "standard deviations", "uncertainty of the object"} <= set(stages)
    assert found.object_uncertainty is not None
    again = few.run(states[-1])
    assert again.trail == found.trail


def test_a_search_without_a_limit_is_resumed_without_one(
    search: JointSearch, lens: Lens, monkeypatch: pytest.MonkeyPatch
) -> None:
    parameters = chosen_parameters("plane_2_shift_x_um", bench_parameters(lens, 2, 0.06, 0.532))
    states: list[SearchState] = []
    limited = replace(search, parameters=parameters, iterations=4, keep=states.append)
    scale = 1.2 * limited._fit_bench(Unknowns()).linear.model.scale
    monkeypatch.setattr(
        JointSearch, "_scale_without_limit", lambda self, first: 0.0 if self.scale_without_limit else scale
    )
    start = SearchState(unknowns(TRUE | {"plane_2_shift_x_um": 0.0}, lens))
    found = limited.run(start)
    assert {state.scale_without_limit for state in states} == {scale}
    last = states[-1]
    again = limited.run(last)
    assert again.trail == found.trail
    assert found.unknowns.of(parameters)[0] == pytest.approx(1.5, abs=0.05)
    iterations = max(limited.iterations, last.iterations)
    with_limit, without = (
        replace(one, iterations=iterations)._fit_bench(last.unknowns)
        for one in (limited, replace(limited, scale_without_limit=scale))
    )
    assert with_limit.upper_bound == 1.0
    assert np.isinf(without.upper_bound)
    assert abs(with_limit.misfit - without.misfit) > 1e-4 * without.misfit


def test_what_is_right_already_is_not_sought_first(search: JointSearch, lens: Lens) -> None:
    """Light's unevenness is sought at once where misfits are near the noise, and last where they are not."""
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    names = ",".join([*TRUE, "plane_2_background", "light_amplitude_20"])
    both = replace(search, parameters=chosen_parameters(names, allowed))
    for values, most, is_sought in ((TRUE | {"plane_2_background": BACKGROUND}, 2, True), ({}, 2, False)):
        found = replace(both, most_benches=most).run(SearchState(unknowns(values, lens)))
        assert len(found.trail) == 2
        uneven = [value for p, value in found.trail[1][0].values.items() if p.name == "light_amplitude_20"]
        assert any(uneven) == is_sought


def test_what_turns_together_is_not_told_apart(search: JointSearch, lens: Lens) -> None:
    """Light, lens and sensor turned about the object are an object turned, which a small one hardly shows."""
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    there, found = SearchState(unknowns(TRUE, lens)), []
    for names in ("light_tilt_x_deg", "light_tilt_x_deg,decenter_x_mm,tilt_y_deg,plane_2_shift_x_um"):
        asked = replace(search, parameters=chosen_parameters(names, allowed), most_benches=0)
        found.append(asked.run(there))
    alone, together = (result.deviations[0] for result in found)
    assert alone < 0.1 * together < 0.1 * search.parameters[0].typical
    names = [p.name for p in asked.parameters]
    assert set(correlated_parameters(names, found[1].covariance)["light_tilt_x_deg"]) >= {
        "decenter_x_mm",
        "tilt_y_deg",
    }


def test_a_file_of_values_is_the_bench_again(lens: Lens, result: FitResult, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    values = {parameter.name: value for parameter, value in result.unknowns.values.items()}
    path.write_text(json.dumps({"mounting": {}, "values": values}))
    bench = read_calibration(path, lens)
    assert bench.light == result.unknowns.state.light
    assert bench.plane_shifts_um == result.unknowns.state.plane_shifts_um
    assert bench.surface_perturbations[0].index == values["surface_1_index"]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"surface_9_index": 0.1}, "no such parameter"),
        ({"light_tilt_x_deg": "much"}, "finite number"),
        ([1.0], "table of numbers"),
    ],
)
def test_values_of_another_lens_are_refused(lens: Lens, tmp_path: Path, values: object, message: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps({"mounting": {}, "values": values}))
    with pytest.raises(InputError, match=message):
        read_calibration(path, lens)


def test_parameters_are_asked_for_by_part_or_name(lens: Lens) -> None:
    allowed = bench_parameters(lens, 2, 0.06, 0.532)
    assert chosen_parameters("all", allowed) == allowed
    assert {p.group for p in chosen_parameters("light,camera", allowed)} == {"light", "camera"}
    assert [p.name for p in chosen_parameters("rigid", allowed)][:2] == ["decenter_x_mm", "decenter_y_mm"]
    assert not any(p.group == "light" for p in bench_parameters(lens, 2, 0.06, 0.532, light_order=0))
    with pytest.raises(InputError, match="each once"):
        chosen_parameters("lens,surface_1_index", allowed)
    with pytest.raises(InputError, match="did you mean light_tilt_"):
        chosen_parameters("light_tilt_z_deg", allowed)
