"""How much light goes to the rim, as frames tell it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lensdesign import Lens, scaled
from wavesim.fields.field import Field
from wavesim.metrics.comparison import random_field
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.scene.light import Light
from wavesim.scene.settings import PatchSettings
from wavesim.sensor.imaging import image
from wavesim.sensor.light_of_frames import light_of_frames
from wavesim.sensor.windows import exit_scene
from wavesim.targets.patch import lit_patch

WIDTH_MM = 0.06


def told(lens: Lens, thing: str | Field, **settings: Any) -> tuple[float, float]:
    """Share of scattered light that frames tell, and what would be as much of it at the rim in truth."""
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
    even, true = told(twin, "usaf", ground=ground, exposures=(1.0, 30.0, 1000.0))
    assert 0.3 * true < even < 4.0 * true
    assert even < 0.1


def test_speckle_is_even_light(twin: Lens) -> None:
    patch, _ = lit_patch(twin, PatchSettings(patch_mm=WIDTH_MM))
    speckle = random_field(patch.grid, patch.wavelength_um, twin.object.numerical_aperture)
    even, true = told(twin, speckle.with_values(speckle.values / np.abs(speckle.values).max()))
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
