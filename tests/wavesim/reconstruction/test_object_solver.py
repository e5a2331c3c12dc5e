"""Object-domain reconstruction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings, strategies

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid, correlation
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.pixel_means import PixelMeans
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction import object_solver
from wavesim.reconstruction.object_solver import USUAL_STEPS, SolverState, reconstruct
from wavesim.reconstruction.resumable import saved_state
from wavesim.reconstruction.search_rules import COARSE_STEPS
from wavesim.reconstruction.stop_rule import AT_NOISE, STOPPED, TOLERANCE, expected_change
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, noise_misfit, recorded_intensity


@dataclass(frozen=True, eq=False)
class Case:
    engine: Engine
    illumination: Field
    transmission: np.ndarray
    recorded: list[Measurement]


@pytest.fixture(scope="module")
def case() -> Case:
    """Bars of 0.9 to 3 um within a field stop, through a small twin of the paper's lens, onto two planes."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    object_grid = Grid((120, 120), 4.2e-4, lens.object_z_mm)
    exit_grid = Grid((216, 216), 3.2e-3, lens.exit_vertex_z_mm + 0.08)
    engine = engine_for(Scene(lens, object_grid, exit_grid, 0.532), "eikonal", error=0.3)
    y, x = object_grid.y_mm[:, None], object_grid.x_mm
    stop = (np.hypot(y, x) < 0.024).astype(np.complex64)
    rng = np.random.default_rng(7)
    transmission = np.ones(object_grid.shape)
    for _ in range(12):
        width, cy, cx = rng.uniform(0.9e-3, 3e-3), *rng.uniform(-0.02, 0.02, 2)
        for bar in range(3):
            transmission[
                (np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)
            ] = 0.0
    lit = Field(object_grid, stop, 0.532)
    at_exit = engine.forward(lit.with_values((transmission * stop).astype(np.complex64))).values
    planes = []
    for distance in (0.0, 0.6):
        way = PlaneWaves.of(exit_grid, 0.532).transfer_function(distance)
        planes.append(
            Measurement(distance, np.abs(np.fft.ifft2(np.fft.fft2(at_exit) * way)).astype(np.float32))
        )
    return Case(engine, lit, transmission, planes)


@pytest.fixture(scope="module")
def tiny_case() -> Case:
    """A grating of amplitude 0.4 and 1 through a tiny twin onto two planes, with noise."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    grid = Grid((40, 40), 5e-4, lens.object_z_mm)
    exit_grid = Grid((60, 60), 3.2e-3, lens.exit_vertex_z_mm + 0.04)
    engine = engine_for(Scene(lens, grid, exit_grid, 0.532), "eikonal", error=0.3)
    transmission = np.where(np.sin(2.0 * np.pi * grid.x_mm / 4e-3) > 0.0, 1.0, 0.4) * np.ones(grid.shape)
    light = Field(grid, (np.sqrt(grid.radius_squared_mm2()) < 0.009).astype(np.complex64), 0.532)
    planes = [Measurement(d, np.zeros(exit_grid.shape, np.float32)) for d in (0.0, 0.3)]
    modelled = ChannelModel.of_source(engine, light, planes, 3.0, 0.9).amplitudes(
        transmission.astype(np.complex64)
    )
    random = np.random.default_rng(5)
    sigma = np.float32(0.02 * max(amplitude.max() for amplitude in modelled))
    recorded = [
        replace(
            plane,
            amplitude=np.abs(amplitude + sigma * random.standard_normal(amplitude.shape, np.float32)),
            sigma=np.full(amplitude.shape, sigma),
        )
        for plane, amplitude in zip(planes, modelled, strict=True)
    ]
    return Case(engine, light, transmission, recorded)


def score(case: Case, found: Field) -> float:
    """Correlation of what the object adds to its illumination, inside the field stop."""
    inside = np.abs(case.illumination.values) > 0.0
    return correlation((found.values - 1.0)[inside], (case.transmission - 1.0)[inside])


def test_an_amplitude_object_comes_back(case: Case) -> None:
    found = reconstruct(
        case.engine,
        case.illumination,
        case.recorded,
        kind="amplitude",
        tv_weight=0.02,
        iterations=40,
        scale=1.0,
    )
    assert score(case, found.transmission) > 0.97
    assert found.misfit[-1] < 0.1 * found.misfit[0]
    values = found.transmission.values
    assert np.all(values.imag == 0.0)
    assert np.all((values.real >= 0.0) & (values.real <= 1.0))
    assert not np.any(values[np.abs(case.illumination.values) == 0.0])
    size = np.sqrt(sum(np.sum(p.amplitude.astype(float) ** 2) for p in case.recorded))
    left = np.sqrt(sum(np.sum(m.astype(float) ** 2) for m in found.residual_maps)) / size
    assert left == pytest.approx(found.misfit[-1], rel=0.5)
    assert repr(found).startswith("Reconstructed(samples 120 x 120 of 0.42 µm, iterations ")
    assert "data:image/png;base64," in found._repr_html_()


def test_a_complex_object_is_found_to_the_data(case: Case) -> None:
    found = reconstruct(
        case.engine, case.illumination, case.recorded, tv_weight=0.02, iterations=40, scale=1.0
    )
    assert score(case, found.transmission) > 0.8
    assert found.misfit[-1] < 0.25 * found.misfit[0]


def test_one_plane_is_worse_than_two(case: Case) -> None:
    scores = [
        score(
            case,
            reconstruct(
                case.engine,
                case.illumination,
                planes,
                kind="amplitude",
                tv_weight=0.02,
                iterations=15,
                scale=1.0,
            ).transmission,
        )
        for planes in (case.recorded[:1], case.recorded)
    ]
    assert scores[0] < scores[1]


def test_the_scale_is_found(case: Case) -> None:
    louder = [Measurement(p.distance_mm, 7.0 * p.amplitude) for p in case.recorded]
    found = reconstruct(
        case.engine, case.illumination, louder, kind="amplitude", tv_weight=0.02, iterations=30
    )
    assert found.scale == pytest.approx(7.0, rel=0.25)
    assert score(case, found.transmission) > 0.9


@pytest.mark.parametrize("power", [-90, 100])
def test_amplitudes_of_any_unit_give_the_same_object(case: Case, power: int) -> None:
    expected = reconstruct(case.engine, case.illumination, case.recorded, iterations=3, kind="amplitude")
    unit = 2.0**power
    light = case.illumination.with_values(case.illumination.values * np.float32(1.0 / unit))
    planes = [replace(plane, amplitude=plane.amplitude * np.float32(unit)) for plane in case.recorded]
    for lit, factor in ((case.illumination, unit), (light, unit * unit)):
        found = reconstruct(case.engine, lit, planes, iterations=3, kind="amplitude")
        np.testing.assert_array_equal(found.transmission.values, expected.transmission.values)
        assert found.misfit == expected.misfit
        assert found.scale == expected.scale * factor
        for one, other in zip(found.residual_maps, expected.residual_maps, strict=True):
            # Steps between the smallest numbers of float32 do not scale.
            least = 32.0 * float(np.finfo(np.float32).smallest_subnormal)
            np.testing.assert_allclose(one, other * np.float32(unit), rtol=0.0, atol=least)


def test_amplitudes_that_no_unit_fits_are_refused(case: Case) -> None:
    near, far = case.recorded
    bright = replace(far, amplitude=far.amplitude * np.float32(1e30))
    with pytest.raises(InputError, match=r"plane 2: .*2\.49e\+30.*plane 1"):
        reconstruct(case.engine, case.illumination, [near, bright])


def test_the_truth_stays(case: Case) -> None:
    start = case.illumination.with_values(case.transmission.astype(np.complex64))
    found = reconstruct(
        case.engine, case.illumination, case.recorded, kind="amplitude", iterations=5, scale=1.0, start=start
    )
    assert max(found.misfit) < 1e-4
    assert score(case, found.transmission) > 0.9999


def test_progress_and_early_stop(case: Case) -> None:
    calls: list[int] = []
    start = case.illumination.with_values(case.transmission.astype(np.complex64))
    found = reconstruct(
        case.engine,
        case.illumination,
        case.recorded,
        kind="amplitude",
        iterations=60,
        tv_weight=0.02,
        scale=1.0,
        start=start,
        progress=lambda k, _: calls.append(k),
    )
    assert calls == list(range(len(found.misfit)))
    assert found.stopped_because == "converged"
    assert len(found.misfit) < 60


def noisy(case: Case, electrons: float, seed: int = 4) -> list[Measurement]:
    """Point samples with shot noise, and their standard deviations."""
    random = np.random.default_rng(seed)
    gain = electrons / max(float(p.amplitude.max()) ** 2 for p in case.recorded)
    planes = []
    for plane in case.recorded:
        counts = random.poisson(gain * plane.amplitude.astype(float) ** 2)
        made = recorded_intensity(plane.distance_mm, counts / gain, np.maximum(counts, 1.0) / gain**2)
        assert made.sigma is not None
        planes.append(
            replace(made, amplitude=made.amplitude.astype(np.float32), sigma=made.sigma.astype(np.float32))
        )
    return planes


def test_pixels_that_are_not_known_do_not_count(case: Case) -> None:
    """A block of saturated pixels and scattered dead ones spoil the result, unless they are left out."""
    dead = np.random.default_rng(3).random(case.recorded[0].amplitude.shape) < 0.03
    dead[100:112, 90:104] = True
    spoiled, masked = [], []
    for plane in case.recorded:
        wrong = np.where(dead, 3.0 * plane.amplitude.max(), plane.amplitude).astype(np.float32)
        spoiled.append(replace(plane, amplitude=wrong))
        masked.append(replace(spoiled[-1], sigma=np.where(dead, np.inf, 1.0).astype(np.float32)))
    scores = [
        score(
            case,
            reconstruct(
                case.engine,
                case.illumination,
                planes,
                kind="amplitude",
                tv_weight=0.02,
                iterations=20,
                scale=1.0,
            ).transmission,
        )
        for planes in (spoiled, masked)
    ]
    assert scores[0] < 0.7
    assert scores[1] > 0.95


def test_even_standard_deviations_change_nothing(case: Case) -> None:
    """As long as the misfit is far above what they would leave."""
    even = [replace(p, sigma=np.full(p.amplitude.shape, 1e-4, np.float32)) for p in case.recorded]
    found = [
        reconstruct(case.engine, case.illumination, planes, kind="amplitude", iterations=3, scale=1.0)
        for planes in (case.recorded, even)
    ]
    np.testing.assert_allclose(found[0].transmission.values, found[1].transmission.values, atol=1e-5)
    np.testing.assert_allclose(found[0].misfit, found[1].misfit, rtol=1e-5)


@pytest.mark.parametrize("electrons", [1e4, 4e4])
def test_the_total_variation_weight_by_the_noise_is_near_the_best(case: Case, electrons: float) -> None:
    recorded = noisy(case, electrons)
    noise = noise_of_step(ChannelModel.of_source(case.engine, case.illumination, recorded, 1.0))

    def reached(weight: float | str) -> float:
        return score(
            case,
            reconstruct(
                case.engine,
                case.illumination,
                recorded,
                kind="amplitude",
                tv_weight=weight,
                iterations=10,
                scale=1.0,
            ).transmission,
        )

    best = max(reached(factor * noise) for factor in (0.25, 1.0, 4.0))
    assert 1.0 - reached("auto") < 1.6 * (1.0 - best)


def test_the_weight_by_the_noise_is_told_in_the_models_scale(case: Case) -> None:
    """Seven times the amplitudes with seven times the noise are the same object."""
    recorded = noisy(case, 1e5)
    louder = [replace(p, amplitude=7.0 * p.amplitude, sigma=7.0 * p.sigma) for p in recorded]
    found = [
        reconstruct(
            case.engine,
            case.illumination,
            planes,
            kind="amplitude",
            tv_weight="auto",
            iterations=4,
            scale=scale,
        )
        for planes, scale in ((recorded, 1.0), (louder, 7.0))
    ]
    np.testing.assert_allclose(found[0].transmission.values, found[1].transmission.values, atol=1e-3)


def test_what_is_not_explained_counts_as_noise(case: Case) -> None:
    """At the first step, noise that is stated ten times too small gives the weight of the misfit."""
    recorded = noisy(case, 1e6)
    settings: dict[str, Any] = {"kind": "amplitude", "iterations": 1, "scale": 1.0}
    surer = [replace(p, sigma=0.1 * p.sigma) for p in recorded]
    noise = noise_of_step(ChannelModel.of_source(case.engine, case.illumination, recorded, 1.0))
    first = reconstruct(case.engine, case.illumination, recorded, **settings).misfit[0]
    over = first / noise_misfit(recorded)
    assert over > 2.0
    expected = reconstruct(case.engine, case.illumination, recorded, tv_weight=over * noise, **settings)
    for planes in (recorded, surer):
        found = reconstruct(case.engine, case.illumination, planes, tv_weight="auto", **settings)
        np.testing.assert_allclose(found.transmission.values, expected.transmission.values, atol=1e-4)


def test_planes_are_passed_once_more_for_the_scale_but_once(
    case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its fit goes with each round's first pass, and comes to that of the field which it leaves."""
    passes: list[int] = []
    propagate = PixelMeans.propagate

    def counted(pixels: PixelMeans, *arguments: Any) -> Any:
        passes.append(1)
        return propagate(pixels, *arguments)

    monkeypatch.setattr(PixelMeans, "propagate", counted)
    louder = [replace(p, amplitude=7.0 * p.amplitude, sigma=7.0 * p.sigma) for p in noisy(case, 1e6)]
    settings: dict[str, Any] = {
        "kind": "amplitude",
        "iterations": 4,
        "fill_factor": 1.0,
        "inner_iterations": 3,
    }
    found = reconstruct(case.engine, case.illumination, louder, **settings, residuals=False)
    assert len(passes) == len(louder) * (1 + 4 * 3)
    model = ChannelModel.of_source(case.engine, case.illumination, louder, None, 1.0)
    _, scale = model.fitted_amplitudes(found.transmission.values)
    assert found.scale == pytest.approx(scale, rel=0.02)


def test_first_steps_of_a_whole_field_gain_more(case: Case) -> None:
    """At the same number of inner iterations."""
    longer, usual = (
        reconstruct(
            case.engine,
            case.illumination,
            case.recorded,
            kind="amplitude",
            iterations=4,
            scale=1.0,
            inner_iterations=2,
            step_rule=rule,
        )
        for rule in (COARSE_STEPS, USUAL_STEPS)
    )
    assert longer.misfit[-1] < 0.9 * usual.misfit[-1]


def test_it_ends_at_the_noise(case: Case) -> None:
    """Where the misfit is what noise alone would leave, and falls no more, on request."""
    recorded = noisy(case, 1e5)
    settings: dict[str, Any] = {"kind": "amplitude", "tv_weight": "auto", "iterations": 40, "scale": 1.0}
    found, whole = (
        reconstruct(case.engine, case.illumination, recorded, until_noise=until, **settings)
        for until in (True, False)
    )
    noise = noise_misfit(recorded)
    assert noise is not None
    assert found.stopped_because == "noise"
    falls = -np.diff(found.misfit) / found.misfit[1:]
    assert found.misfit[-1] <= AT_NOISE * noise < found.misfit[2]
    assert falls[-1] < TOLERANCE <= falls[:-1].min()
    assert whole.misfit[: len(found.misfit)] == found.misfit
    assert len(whole.misfit) > len(found.misfit)
    assert score(case, found.transmission) > 0.998
    assert STOPPED["noise"] in repr(found)


def test_the_weight_of_the_total_variation_does_not_depend_on_the_noise_that_is_left(
    case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Iterations converge above the noise with a weight that hides detail."""
    recorded = noisy(case, 1e5)
    noise = noise_misfit(recorded)
    assert noise is not None
    monkeypatch.setattr(object_solver, "TV_PER_NOISE", 8.0)
    whole, eighth = (
        reconstruct(
            case.engine,
            case.illumination,
            recorded,
            kind="amplitude",
            tv_weight="auto",
            iterations=60,
            until_noise=True,
            scale=1.0,
            tv_factor=factor,
        )
        for factor in (1.0, 0.125)
    )
    assert whole.stopped_because == "converged"
    assert 1.3 * noise < whole.misfit[-1] < 2.0 * noise
    assert eighth.misfit[-1] < AT_NOISE * noise
    assert score(case, eighth.transmission) > score(case, whole.transmission) > 0.9


def test_it_ends_at_the_noise_where_all_that_is_to_come_would_change_nothing(case: Case) -> None:
    recorded = noisy(case, 1e6)
    settings: dict[str, Any] = {"kind": "amplitude", "tv_weight": "auto", "iterations": 20, "scale": 1.0}
    found, whole = (
        reconstruct(case.engine, case.illumination, recorded, until_noise=until, **settings)
        for until in (True, False)
    )
    assert found.stopped_because == "noise"
    falls = -np.diff(found.misfit) / found.misfit[1:]
    assert falls[-1] > 1.5 * TOLERANCE
    to_come = found.misfit[-1] - np.array(whole.misfit[len(found.misfit) :])
    assert len(to_come) > 3
    assert np.abs(to_come).max() < TOLERANCE * found.misfit[-1]
    assert score(case, found.transmission) > score(case, whole.transmission) - 1e-4


def test_a_single_small_change_ends_nothing() -> None:
    """A single iteration gains little where the inner iterations end, and later ones gain much."""
    falls = [0.58, 0.121, 0.012, 0.0047, 0.003]
    misfits = [2.0 - sum(falls[:n]) for n in range(len(falls) + 1)]
    for n in range(len(misfits) + 1):
        assert expected_change(misfits[:n]) > 2.0 * TOLERANCE
    assert expected_change([2.0, 1.8, 1.7, 1.65]) == pytest.approx(0.05 / 1.65)  # 1/2 + 1/4 + ... of it


def test_rounds_behind_the_lens_spare_ways_through_it(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = noisy(case, 1e6)
    settings: dict[str, Any] = {"tv_weight": "auto", "iterations": 40, "scale": 1.0, "until_noise": True}
    found = reconstruct(case.engine, case.illumination, recorded, **settings)
    monkeypatch.setattr(object_solver, "INNER_STEP_FACTOR", 1.0)
    without = reconstruct(case.engine, case.illumination, recorded, **settings, inner_iterations=1)
    assert found.stopped_because == without.stopped_because == "noise"
    assert len(found.misfit) < 0.8 * len(without.misfit)
    assert score(case, found.transmission) > max(0.99, score(case, without.transmission))


def test_an_amplitude_start_within_the_iterations(case: Case) -> None:
    calls: list[int] = []
    found = reconstruct(
        case.engine,
        case.illumination,
        case.recorded,
        tv_weight=0.02,
        iterations=16,
        scale=1.0,
        start="amplitude",
        progress=lambda k, _: calls.append(k),
    )
    assert calls == list(range(16))
    assert score(case, found.transmission) > 0.9
    assert np.any(found.transmission.values.imag != 0.0)


@pytest.mark.parametrize("start", [None, "amplitude"])
def test_every_kept_iteration_leads_to_the_same_end(case: Case, start: str | None) -> None:
    """Whether or not arrays lie in files; what is kept is not changed by what comes after."""
    kept: list[SolverState] = []
    settings: dict[str, Any] = {"tv_weight": 0.02, "iterations": 16, "start": start}
    whole = reconstruct(case.engine, case.illumination, case.recorded, keep=kept.append, **settings)
    assert len(kept) == len(whole.misfit)
    for k in (2, 11, 12):
        again = reconstruct(case.engine, case.illumination, case.recorded, resume=kept[k], **settings)
        np.testing.assert_array_equal(again.transmission.values, whole.transmission.values)
        assert again.misfit == whole.misfit
    assert np.isrealobj(kept[3].ahead) == (start == "amplitude")
    assert np.iscomplexobj(kept[-1].ahead)


@pytest.mark.parametrize(("kind", "fill_factor"), [("amplitude", 1.0), ("complex", 0.0)])
def test_in_files_the_result_is_the_same(case: Case, tmp_path: Path, kind: Kind, fill_factor: float) -> None:
    room, used = Scratch(tmp_path, 0.0), []
    quiet = [replace(p, sigma=np.full(p.amplitude.shape, 1e-3)) for p in case.recorded]
    settings: dict[str, Any] = {"kind": kind, "tv_weight": "auto", "fill_factor": fill_factor}
    settings |= {"iterations": 4, "keep": lambda _: used.append(room.bytes_in_files)}
    in_files, in_memory = (
        reconstruct(case.engine, case.illumination, quiet, scratch=scratch, **settings)
        for scratch in (room, None)
    )
    np.testing.assert_array_equal(in_files.transmission.values, in_memory.transmission.values)
    assert in_files.misfit == in_memory.misfit
    # The steps, and standard deviations in the model's precision.
    step = case.illumination.values.nbytes // (2 if kind == "amplitude" else 1)
    assert used[3] >= 2 * step + sum(p.amplitude.nbytes for p in case.recorded)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recorded": []}, "recorded: "),
        ({"recorded": [Measurement(0.0, np.ones((3, 3)))]}, "shape"),
        ({"recorded": [Measurement(0.0, np.zeros((216, 216)))]}, "amplitudes are 0"),
        ({"recorded": [Measurement(0.0, np.full((216, 216), np.nan))]}, "finite"),
        ({"recorded": [Measurement(np.nan, np.ones((216, 216)))]}, "distance_mm = nan"),
        ({"kind": "volume"}, "kind = 'volume'"),
        ({"tv_weight": -1.0}, "tv_weight"),
        ({"iterations": 0}, "iterations = 0"),
        ({"scale": 0.0}, "scale = 0.0"),
        ({"fill_factor": 2.5}, "fill_factor = 2.5"),
        ({"tv_weight": "auto"}, "needs sigma"),
        ({"tv_weight": "strong"}, "tv_weight = 'strong'"),
        ({"start": "random"}, "start = 'random'"),
        ({"start": Field(Grid((3, 3), 1.0, 0.0), np.ones((3, 3)), 0.532)}, "start: its shape"),
        (
            {"recorded": [Measurement(0.0, np.ones((216, 216)), np.zeros((216, 216)))]},
            "sigma must be above 0",
        ),
        ({"recorded": [Measurement(0.0, np.ones((216, 216)), np.ones(3))]}, "sigma must be above 0"),
        ({"recorded": [Measurement(0.0, np.ones((216, 216)), np.full((216, 216), np.inf))]}, "not known"),
    ],
)
def test_refused(case: Case, change: dict, message: str) -> None:
    arguments = {"recorded": case.recorded} | change
    with pytest.raises(InputError, match=message):
        reconstruct(case.engine, case.illumination, **arguments)


@pytest.fixture(scope="module")
def phase_case(case: Case) -> Case:
    """The bars of `case` as steps of phase on a smooth phase, on the first plane, with noise."""
    y, x = case.illumination.grid.y_mm[:, None], case.illumination.grid.x_mm
    smooth = np.cos(2.0 * np.pi * x / 0.03) * np.cos(2.0 * np.pi * y / 0.02)
    transmission = np.exp(1j * (0.7 * (1.0 - case.transmission) + 0.4 * smooth))
    lit = case.illumination
    field = case.engine.forward(lit.with_values((transmission * lit.values).astype(np.complex64)))
    intensity = np.abs(field.values) ** 2
    electrons = 1e6 / intensity.max() * intensity
    noisy = np.random.default_rng(3).normal(electrons, np.sqrt(electrons + 4.0))
    return Case(
        case.engine, lit, transmission, [recorded_intensity(0.0, noisy, np.maximum(noisy, 0.0) + 4.0)]
    )


def test_a_phase_object_is_found_from_one_plane_that_leaves_a_complex_one_open(phase_case: Case) -> None:
    lit = np.abs(phase_case.illumination.values) > 0.0
    scores = {}
    for kind in ("phase", "complex"):
        found = reconstruct(
            phase_case.engine,
            phase_case.illumination,
            phase_case.recorded,
            kind=kind,
            tv_weight="auto",
            until_noise=True,
        )
        values = found.transmission.values
        # A constant phase of the object does not show.
        piston = np.vdot(values[lit], phase_case.transmission[lit])
        turned = found.transmission.with_values(values * piston / abs(piston))
        scores[kind] = score(phase_case, turned)
        if kind == "phase":
            np.testing.assert_allclose(np.abs(values[lit]), 1.0, atol=1e-5)
            assert not values[~lit].any()
            assert found.scale == pytest.approx(found_scale(phase_case), rel=0.01)
    assert scores["phase"] > 0.98
    assert scores["complex"] < 0.9


def found_scale(case: Case) -> float:
    """Scale that the true object has: root of recorded over modelled light."""
    model = ChannelModel.of_source(case.engine, case.illumination, case.recorded, 1.0)
    (modelled,) = model.amplitudes(case.transmission.astype(np.complex64))
    return float(np.linalg.norm(case.recorded[0].amplitude) / np.linalg.norm(modelled))


@settings(max_examples=30)
@given(
    kind=strategies.sampled_from(["amplitude", "complex", "phase"]),
    start=strategies.sampled_from([None, "amplitude"]),
    scale=strategies.sampled_from([None, 1.0]),
    iterations=strategies.integers(1, 16),
    until_noise=strategies.booleans(),
    data=strategies.data(),
)
def test_a_run_continues_from_any_state_as_if_it_had_not_been_interrupted(
    tiny_case: Case,
    kind: Kind,
    start: Literal["amplitude"] | None,
    scale: float | None,
    iterations: int,
    until_noise: bool,
    data: strategies.DataObject,
) -> None:
    """To the last bit, from the file of a checkpoint, the last state included."""
    if kind == "phase":
        start = None
    arguments: dict[str, Any] = {
        "kind": kind,
        "tv_weight": "auto",
        "iterations": iterations,
        "scale": scale,
        "start": start,
        "until_noise": until_noise,
        "fill_factor": 0.9,
        "iterations_without_tv": data.draw(strategies.sampled_from([0, 3]), label="without_tv"),
    }
    states: list[SolverState] = []
    given_planes = tiny_case.engine, tiny_case.illumination, tiny_case.recorded
    whole = reconstruct(*given_planes, keep=states.append, **arguments)
    state = states[data.draw(strategies.integers(0, len(states) - 1), label="state")]
    with TemporaryDirectory() as folder:
        checkpoint = Checkpoint(Path(folder) / "checkpoint.npz", "key")
        checkpoint.keep(**vars(state))
        again = reconstruct(*given_planes, resume=saved_state(checkpoint, Scratch()), **arguments)
    np.testing.assert_array_equal(again.transmission.values, whole.transmission.values)
    assert (again.misfit, again.scale, again.stopped_because) == (
        whole.misfit,
        whole.scale,
        whole.stopped_because,
    )
    for one, other in zip(again.residual_maps, whole.residual_maps, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_phase_object_does_not_start_from_an_amplitude_object(phase_case: Case) -> None:
    with pytest.raises(InputError, match=r"start = 'amplitude': cannot be used for a phase object"):
        reconstruct(
            phase_case.engine, phase_case.illumination, phase_case.recorded, kind="phase", start="amplitude"
        )


def test_dark_values_have_the_phase_0_on_the_unit_circle() -> None:
    values = np.array([[0.0, 3.0j], [-2.0, 1.0 + 1.0j]], np.complex64)
    object_solver._project_on_unit_circle(values)
    np.testing.assert_allclose(values, [[1.0, 1.0j], [-1.0, np.exp(0.25j * np.pi)]], atol=1e-6)
