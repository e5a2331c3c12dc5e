"""What frames of another model tell of ours: the bench that they state explains them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import GOLDEN

from lensdesign import Lens, load_design, scaled
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface_figure import surface_figure_from_zernike
from wavesim import read_frames
from wavesim.fields.field import Field
from wavesim.fields.files import read_field
from wavesim.forward.channel_model import ChannelModel
from wavesim.metrics.comparison import random_field
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.reconstruction.problem import ReconstructionProblem, light_of_frames, reconstruction_problem
from wavesim.runtime.memory import MemoryNeed, in_memory
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import PatchSettings, ReconstructionSettings, SettingError
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image
from wavesim.sensor.measurement import Measurement, noise_misfit, placed_planes
from wavesim.sensor.windows import exit_scene
from wavesim.targets.patch import lit_patch

BENCH = GOLDEN / "bench"
SETTINGS = ReconstructionSettings(kind="amplitude", patch_mm=0.16)


def stated(lens: Lens) -> SystemState:
    """The errors of `set.json`, but for the bend of the light, whose form it does not say."""
    errors = json.loads((BENCH / "everything" / "set.json").read_text())["errors"]
    front, back = lens.surfaces
    waves = errors["surface_2_figure_zernike_waves_633nm"]
    assert front.radius_mm is not None
    assert back.radius_mm is not None
    assert back.semi_diameter_mm is not None
    figure = surface_figure_from_zernike({int(j): 0.633 * w for j, w in waves.items()}, back.semi_diameter_mm)
    surfaces = {
        0: SurfacePerturbation(
            index=errors["index"],
            radius_mm=errors["surface_1_radius_relative"] * front.radius_mm,
            thickness_mm=errors["thickness_mm"],
        ),
        1: SurfacePerturbation(radius_mm=errors["surface_2_radius_relative"] * back.radius_mm, figure=figure),
    }
    # 1 - 0.05 (x^2 + 0.5 y + 0.2 x y), in Legendre polynomials.
    light = LightErrors(
        (errors["light_tilt_x_deg"], errors["light_tilt_y_deg"]),
        {(2, 0): -0.1 / 3.0, (0, 1): -0.025, (1, 1): -0.01},
    )
    return SystemState(
        Pose(decenter_y_mm=errors["lens_decenter_y_mm"]),
        surface_perturbations=surfaces,
        plane_distance_errors_mm=(0.0, errors["plane_2_distance_mm"]),
        light=light,
        plane_backgrounds=(errors["background_share_of_mean"],) * 2,
    )


def over_noise(case: ReconstructionProblem, recorded: list[Measurement], true: np.ndarray) -> float:
    """Misfit that the true object leaves, over that of the stated noise."""
    model = ChannelModel.of_source(case.engine, case.light, recorded, None, SETTINGS.fill_factor)
    noise = noise_misfit(recorded)
    assert noise is not None
    return model.step(true, fits_scale=True).misfit / noise


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_frames_of_another_model_are_those_of_the_bench_that_they_state() -> None:
    lens = load_design(BENCH / "nominal.toml")
    frames = read_frames(sorted((BENCH / "everything").glob("frame_*.tif")), lens=lens)
    bench = stated(lens)
    case = reconstruction_problem(lens, frames, SETTINGS, None, bench, None)
    true = read_field(BENCH / "everything" / "object.npz")[0].real.astype(np.float32)
    recorded = recorded_planes(frames)
    assert over_noise(case, placed_planes(recorded, bench), true) < 2.4

    farther = replace(bench, plane_distance_errors_mm=(0.0, 0.02))
    assert over_noise(case, placed_planes(recorded, farther), true) > 3.0
    brighter = replace(bench, plane_backgrounds=(0.02, 0.02))
    assert over_noise(case, placed_planes(recorded, brighter), true) > 3.0


WIDTH_MM = 0.06


def scattered_fractions(lens: Lens, thing: str | Field, **settings: Any) -> tuple[float, float]:
    """Return the fraction of scattered light from frames, and the true one at the rim."""
    patch, light = lit_patch(lens, PatchSettings(patch_mm=WIDTH_MM))
    of_object: dict[str, Any] = {} if isinstance(thing, Field) else {"patch_mm": WIDTH_MM}
    made = image(lens, thing, engine="eikonal", error=0.2, **of_object, **settings)
    scene = exit_scene(lens, patch, made.sensor, made.recording.plane_distances_mm[0])
    found = light_of_frames(scene, made.frames, light)
    assert found.field is light
    behind = light.with_values(light.values * made.target.transmission.values)
    return found.even, made.engine.edge_illumination(Light(behind.with_values(behind.values))) ** 2


@pytest.fixture(scope="module")
def twin(paper_lens: Lens) -> Lens:
    return scaled(paper_lens, 1 / 32)


@pytest.mark.parametrize("ground", ["bright", "dark"])
def test_charts_scatter_little(twin: Lens, ground: str) -> None:
    even, true = scattered_fractions(twin, "usaf", ground=ground, exposures=(1.0, 30.0, 1000.0))
    assert 0.3 * true < even < 4.0 * true
    assert even < 0.1


def test_speckle_is_even_light(twin: Lens) -> None:
    patch, _ = lit_patch(twin, PatchSettings(patch_mm=WIDTH_MM))
    speckle = random_field(patch.grid, patch.wavelength_um, twin.object.numerical_aperture)
    even, true = scattered_fractions(twin, speckle.with_values(speckle.values / np.abs(speckle.values).max()))
    assert even == pytest.approx(true, rel=0.4)
    assert even > 0.6


def test_where_no_pixel_sees_the_border_all_light_may_be_scattered(twin: Lens) -> None:
    patch, light = lit_patch(twin, PatchSettings(patch_mm=WIDTH_MM))
    made = image(twin, "usaf", patch_mm=WIDTH_MM, engine="eikonal", error=0.2)
    few = slice(0, 8)
    narrow = made.sensor.replaced(pixels=(8, 8))
    scene = exit_scene(twin, patch, narrow, made.recording.plane_distances_mm[0])
    frames = [type(frame)(frame.counts[few, few], frame.settings) for frame in made.frames]
    assert light_of_frames(scene, frames, light).even == 1.0


def test_a_few_changed_pixels_do_not_change_it(twin: Lens) -> None:
    patch, light = lit_patch(twin, PatchSettings(patch_mm=WIDTH_MM))
    made = image(twin, "usaf", patch_mm=WIDTH_MM, engine="eikonal", error=0.2)
    scene = exit_scene(twin, patch, made.sensor, made.recording.plane_distances_mm[0])
    before = light_of_frames(scene, made.frames, light).even
    first, *others = made.frames
    counts = first.counts.copy()
    rows, columns = np.indices(counts.shape) - 0.5 * (np.array(counts.shape) - 1.0)[:, None, None]
    dark = np.flatnonzero(counts.ravel() < np.quantile(counts, 0.6))
    outermost = dark[np.argsort(np.hypot(rows, columns).ravel()[dark])]
    for place in (0.3, 0.5, 0.6, 0.7):
        counts.ravel()[outermost[int(place * len(outermost))]] = 4000
    changed = light_of_frames(scene, (replace(first, counts=counts), *others), light).even
    assert changed == pytest.approx(before, rel=0.2)


@pytest.mark.parametrize("kind", ["single", "neighbours", "scattered", "dark", "all exposures"])
def test_a_few_changed_pixels_change_little(twin: Lens, kind: str) -> None:
    """Whatever they hold: damaged bytes, hot pixels, hits of cosmic rays."""
    patch, light = lit_patch(twin, PatchSettings(patch_mm=WIDTH_MM))
    made = image(twin, "usaf", patch_mm=WIDTH_MM, engine="eikonal", error=0.2, exposures=(1.0, 30.0, 1000.0))
    scene = exit_scene(twin, patch, made.sensor, made.recording.plane_distances_mm[0])
    whole = light_of_frames(scene, made.frames, light).even
    ys, xs = _ring(scene)
    rng = np.random.default_rng(3)
    picked = {
        "single": [len(ys) // 3],
        "neighbours": np.arange(len(ys) // 2, len(ys) // 2 + 6),
        "scattered": rng.choice(len(ys), 10, replace=False),
        "dark": rng.choice(len(ys), 10, replace=False),
        "all exposures": rng.choice(len(ys), 5, replace=False),
    }[kind]
    frames = []
    for number, frame in enumerate(made.frames):
        counts = frame.counts.copy()
        if kind == "all exposures" or number in (0, 2):
            counts[ys[picked], xs[picked]] = 0 if kind == "dark" else frame.settings.top_counts
        frames.append(type(frame)(counts, frame.settings))
    assert light_of_frames(scene, frames, light).even == pytest.approx(whole, rel=0.25)


def _ring(scene: Any) -> tuple[Any, Any]:
    """Rows and columns of the pixels next to the border of the footprint, inside."""
    pupil = open_pupil(scene, scene.object_grid.centre_mm, scene.exit_grid.z_mm, RIM_ARMS)
    rim = trace_bundle(scene, np.zeros(2), pupil.rim, scene.exit_grid.z_mm).sensor_mm
    width = 0.08 * float(np.mean(np.linalg.norm(rim - rim.mean(axis=0), axis=1)))
    axes = (scene.exit_grid.y_mm, scene.exit_grid.x_mm)
    inside, within = (inside_border(moved(rim, by), axes) for by in (-0.2 * width, -width))
    return np.nonzero(inside & ~within)


@pytest.fixture(scope="module")
def few_frames() -> tuple[Lens, tuple[Frame, ...]]:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    made = image(lens, "star", patch_mm=0.03, planes_mm=(0.03, 0.3), engine="eikonal", error=0.1)
    return lens, made.frames


CALIBRATED = SystemState(source=Source(0.4, 20.0))


@pytest.mark.parametrize(
    ("stated", "used"),
    [
        ({}, Source(0.4, 20.0)),
        ({"source_deg": 0.0}, Source(0.0, 20.0)),
        ({"bandwidth_nm": 0}, Source(0.4, 0.0)),
        ({"source_deg": 0.1, "bandwidth_nm": 0.0}, Source(0.1, 0.0)),
    ],
)
def test_settings_replace_each_width_of_a_calibrated_source(
    few_frames: tuple[Lens, tuple[Frame, ...]], stated: dict[str, float], used: Source
) -> None:
    settings = ReconstructionSettings(patch_mm=0.03, error=0.1, engine="eikonal", **stated)
    case = reconstruction_problem(*few_frames, settings, None, CALIBRATED, None)
    assert case.source == used


def test_a_checkpoint_belongs_to_the_source_that_is_known(
    few_frames: tuple[Lens, tuple[Frame, ...]], tmp_path: Path
) -> None:
    def key(source: Source, **changes: Any) -> str:
        settings = ReconstructionSettings(patch_mm=0.03, error=0.1, engine="eikonal", **changes)
        case = reconstruction_problem(*few_frames, settings, None, SystemState(source=source), tmp_path)
        assert case.checkpoint is not None
        return case.checkpoint.key

    narrow, wide = Source(0.2), Source(0.4)
    assert key(narrow, bandwidth_nm="find") != key(wide, bandwidth_nm="find")
    assert key(narrow, source_deg="find") == key(wide, source_deg="find")
    assert key(Source()) == key(Source(), source_deg=0.0)
    assert key(narrow) != key(wide)


def test_the_method_of_the_paper_refuses_a_calibrated_source(
    few_frames: tuple[Lens, tuple[Frame, ...]],
) -> None:
    settings = ReconstructionSettings(patch_mm=0.03, error=0.1, engine="eikonal", method="paper")
    with pytest.raises(
        SettingError, match=r"calibration: its light is not coherent .*20 nm.*method paper.*source_deg 0"
    ):
        reconstruction_problem(*few_frames, settings, None, CALIBRATED, None)
    coherent = settings.replaced(source_deg=0.0, bandwidth_nm=0.0)
    assert reconstruction_problem(*few_frames, coherent, None, CALIBRATED, None).source == Source()


def test_other_benches_are_not_tested_where_that_alone_does_not_fit_into_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As behind the full-size lens, on whose planes the test takes ten times as much as the search."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    settings = ReconstructionSettings(kind="amplitude", patch_mm=0.03, engine="eikonal", error=0.3)
    taken = {"patch_mm": 0.03, "planes_mm": (0.04, 1.1), "pixels": 146, "engine": "eikonal", "error": 0.3}
    frames = image(lens, "star", seed=0, **taken).frames
    usual = reconstruct_frames(lens, frames, settings)
    assert usual.verdict.explained
    assert usual.verdict.untested == ()

    key_with_test = reconstruction_problem(lens, frames, settings, None, None, None).key

    def needs(*_: Any, tests_bench: bool, **__: Any) -> MemoryNeed:
        return in_memory(10**15 if tests_bench else 10)

    monkeypatch.setattr("wavesim.reconstruction.problem.run_bytes", needs)
    found = reconstruct_frames(lens, frames, settings)
    assert np.array_equal(found.transmission.values, usual.transmission.values)
    assert found.verdict.explained
    assert found.verdict.untested == ("other benches, which needs --memory-gb 1e+06",)
    assert reconstruct_frames(lens, frames, settings.replaced(verdict="quick")).verdict.explained
    assert reconstruction_problem(lens, frames, settings, None, None, None).key != key_with_test
