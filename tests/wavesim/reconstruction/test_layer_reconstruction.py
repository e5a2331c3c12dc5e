"""Layers from frames that other models have made, and layers that are refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.layers import Case, bench, field_behind, outcome, recorded_frames, true_layer
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.reconstruction.layer_reconstruction import (
    LEAST_RATIO,
    layers_oversampling,
    reconstruct_layers,
    why_undetermined,
)
from wavesim.scene.settings import ReconstructionSettings, SettingError
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image

CASE = Case("amplitude", "sparse", (-20.0, 0.0), 2, stop_mm=0.016)


@cache
def frames_of_one_plane() -> tuple[Frame, ...]:
    lens, patch = bench(CASE.stop_mm)
    layers = [true_layer(patch, "amplitude", "sparse", seed) for seed in (1, 2)]
    behind = field_behind(patch, CASE.layers_um, layers)
    return tuple(recorded_frames(lens, patch, behind, [0.2], 0))


def settings(**changes: object) -> ReconstructionSettings:
    return ReconstructionSettings(
        kind="amplitude", patch_mm=0.03, field_stop_mm=CASE.stop_mm, engine="eikonal", error=0.1
    ).replaced(**changes)


def test_two_layers_are_found_from_frames_of_other_models() -> None:
    found, _ = outcome(Case("amplitude", "sparse", (-20.0, 0.0), 2))
    assert found.verdict.explained
    assert found.oversampling.ratio >= LEAST_RATIO
    for compared in found.truth:
        assert (compared["object_correlation"] or 0.0) > 0.97
    assert found.as_dict()["layers"][0]["distance_um"] == -20.0


def test_frames_with_too_few_measurements_are_refused_with_the_planes_that_would_do() -> None:
    lens, _ = bench(CASE.stop_mm)
    with pytest.raises(SettingError) as refused:
        reconstruct_layers(lens, frames_of_one_plane(), CASE.layers_um, settings())
    ratio = layers_oversampling(lens, frames_of_one_plane(), settings(), 2)
    assert ratio.ratio < LEAST_RATIO
    assert ratio.planes_for(LEAST_RATIO) == 2
    message = str(refused.value)
    for part in (f"{ratio.ratio:.3g} measurements", f"{LEAST_RATIO:g} are required", "record 2 such planes"):
        assert part in message


def test_pixels_darker_than_their_noise_do_not_count() -> None:
    lens, _ = bench(CASE.stop_mm)
    short, *_ = frames_of_one_plane()
    few, all_exposures = (
        layers_oversampling(lens, frames, settings(), 2) for frames in ([short], frames_of_one_plane())
    )
    assert few.measurements < 0.95 * all_exposures.measurements
    assert few.unknowns == all_exposures.unknowns


@pytest.mark.parametrize(
    ("kind", "layers", "numbers"), [("amplitude", 3, 3), ("phase", 3, 3), ("complex", 2, 4)]
)
def test_no_number_of_planes_determines_more_unknowns_than_the_light_has(
    kind: str, layers: int, numbers: int
) -> None:
    lens, _ = bench(CASE.stop_mm)
    ratio = layers_oversampling(lens, frames_of_one_plane(), settings(), layers)
    many = replace(ratio, kind=kind, measurements_of_planes=(1e9,) * 100)
    assert f"{numbers} unknowns" in why_undetermined(many)
    assert why_undetermined(replace(many, kind="amplitude", layers=2)) == ""


def test_undetermined_layers_are_not_trusted() -> None:
    lens, _ = bench(CASE.stop_mm)
    found = reconstruct_layers(
        lens, frames_of_one_plane(), CASE.layers_um, settings(), undetermined=True, iterations=3
    )
    assert "several objects" in [finding.cause for finding in found.verdict.findings]
    assert not found.verdict.explained


def test_settings_that_layers_cannot_use_are_refused() -> None:
    lens, _ = bench(CASE.stop_mm)
    for name, value in (
        ("method", "paper"),
        ("starts", 2),
        ("verdict", "none"),
        ("region_mm", (0.0, 0.0, 0.01, 0.01)),
    ):
        with pytest.raises(SettingError, match=name):
            reconstruct_layers(lens, frames_of_one_plane(), CASE.layers_um, settings(**{name: value}))
    with pytest.raises(InputError, match="ascending"):
        reconstruct_layers(lens, frames_of_one_plane(), (0.0, -20.0), settings())
    with pytest.raises(InputError, match="at least one frame"):
        reconstruct_layers(lens, [], CASE.layers_um, settings())
    true = [np.ones((2, 2))]
    with pytest.raises(InputError, match="1 layers; must be 2"):
        reconstruct_layers(
            lens, frames_of_one_plane(), CASE.layers_um, settings(), truth=true, undetermined=True
        )


def test_light_that_is_not_coherent_is_refused() -> None:
    lens, _ = bench(CASE.stop_mm)
    broad = SystemState(source=Source(0.4, 20.0))
    message = r"calibration: its light is not coherent \(diameter .* 0.4°.* 20 nm.*layers_um.*source_deg 0"
    with pytest.raises(SettingError, match=message):
        reconstruct_layers(lens, frames_of_one_plane(), CASE.layers_um, settings(), calibration=broad)
    coherent = settings(source_deg=0.0, bandwidth_nm=0.0)
    with pytest.raises(SettingError, match="are required"):  # the next check, of the oversampling
        reconstruct_layers(lens, frames_of_one_plane(), CASE.layers_um, coherent, calibration=broad)
    with pytest.raises(SettingError, match="source_deg: cannot be used with layers_um"):
        reconstruct_layers(lens, frames_of_one_plane(), CASE.layers_um, settings(source_deg=0.4))


def test_layers_use_the_calibration_and_a_stated_scale() -> None:
    lens, _ = bench(CASE.stop_mm)
    state = SystemState(Pose(decenter_x_mm=0.003))
    few = settings(field_stop_mm=0.024, iterations=6)
    patch = few.model_dump(include={"patch_mm", "field_stop_mm", "engine", "error"})
    taken = image(
        lens,
        ("star", "empty"),
        layers_um=CASE.layers_um,
        state=state,
        exposures=(1.0, 30.0, 1000.0),
        **patch,
    )
    designed, calibrated = (
        reconstruct_layers(lens, taken.frames, CASE.layers_um, few, calibration=calibration)
        for calibration in (None, state)
    )
    assert calibrated.curve[-1] < 0.2 * designed.curve[-1]
    scale = 1.1 * calibrated.scale
    scaled = reconstruct_layers(
        lens, taken.frames, CASE.layers_um, few.replaced(scale=scale), calibration=state
    )
    assert scaled.scale == pytest.approx(scale)
    products = [
        float(np.linalg.norm(np.prod([layer.values for layer in found.transmissions], axis=0)))
        for found in (scaled, calibrated)
    ]
    assert products[0] * 1.1 == pytest.approx(products[1], rel=0.03)
