"""Finding how a lens is mounted from frames of a known object: first by blurred intensities, then jointly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from small_twins import bars_under_stop

from lensdesign.lens.poses import Pose
from wavesim.calibration.joint.blurred_search import BlurredResponse, blurred_search
from wavesim.calibration.joint.pixels import DensePixels
from wavesim.calibration.joint.search import JointSearch, SearchState
from wavesim.calibration.parameters import LensPose, Parameter, Unknowns, mounting_parameters
from wavesim.engines.choosing import engine_for
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement

TRUE = SystemState(Pose(decenter_x_mm=2.5e-3, decenter_y_mm=-1e-3, tilt_x_deg=-1.0, tilt_y_deg=2.0))
HERE = SystemState(Pose(decenter_x_mm=1e-3, tilt_y_deg=0.2))


def tiles(scene: Scene) -> Engine:
    """One tile: the search makes an engine for every mounting."""
    return engine_for(scene, "eikonal", error=0.3)


@pytest.fixture(scope="module")
def pixels() -> DensePixels:
    """Frames of bars behind a small twin that is mounted with errors; their scale is not known."""
    scene, light, bars, _ = bars_under_stop()
    blank = [Measurement(d, np.ones(scene.exit_grid.shape, np.float32)) for d in (0.0, 0.6)]
    model = ChannelModel.of_source(tiles(placed_scene(scene, TRUE)), placed_light(light, TRUE), blank, 1.0)
    seen = [
        Measurement(plane.distance_mm, 3.0 * amplitude.astype(np.float32))
        for plane, amplitude in zip(blank, model.amplitudes(bars), strict=True)
    ]
    return DensePixels(scene, light, seen, None, 0.0, tiles)


@pytest.fixture(scope="module")
def bars() -> np.ndarray:
    return bars_under_stop()[2].astype(np.complex64)


@pytest.fixture(scope="module")
def pose(pixels: DensePixels) -> tuple[Parameter, ...]:
    return tuple(p for p in mounting_parameters(pixels.scene.lens, 2) if isinstance(p, LensPose))


def test_a_known_target_tells_decenter_and_tilt(
    pixels: DensePixels, bars: np.ndarray, pose: tuple[Parameter, ...]
) -> None:
    """The errors are several times as large as usual ones."""
    start = blurred_search(pixels, bars, pose, Unknowns())
    search = JointSearch(pixels, "amplitude", pose, 5, 40, None, bars, has_deviations=False)
    found = search.run(SearchState(start))
    assert found.estimates == pytest.approx([parameter.value(TRUE) for parameter in pose], rel=0.03)
    assert found.misfit < 0.05 * search._fit_bench(Unknowns()).misfit
    assert found.stopped_because == "converged"


def response(
    pixels: DensePixels, bars: np.ndarray, state: SystemState, pose: Sequence[Parameter]
) -> BlurredResponse:
    unknowns = Unknowns().changed(pose, [parameter.value(state) for parameter in pose])
    return BlurredResponse(pixels, unknowns, bars, pose)


@pytest.mark.parametrize(("fill_factor", "scale"), [(0.0, 3.0), (1.0, None)])
def test_derivatives_are_those_of_the_engine(
    pixels: DensePixels,
    bars: np.ndarray,
    pose: tuple[Parameter, ...],
    fill_factor: float,
    scale: float | None,
) -> None:
    """Light near the aperture's edge, which moves with the lens but not with the rays, is what differs."""
    own = replace(pixels, fill_factor=fill_factor, scale=scale)
    found = response(own, bars, HERE, pose)
    for parameter, change in zip(pose, found.jacobian.T, strict=True):
        value, step = parameter.value(HERE), 0.01 if parameter.name.startswith("tilt") else 5e-5
        up, down = (response(own, bars, parameter.set(HERE, value + s), pose).residual for s in (step, -step))
        numeric = (up - down) / (2.0 * step)
        sizes = np.linalg.norm(change), np.linalg.norm(numeric)
        assert np.dot(change, numeric) > 0.95 * sizes[0] * sizes[1], parameter.name
        assert sizes[0] == pytest.approx(sizes[1], rel=0.1), parameter.name


def test_unknown_pixels_do_not_count(
    pixels: DensePixels, bars: np.ndarray, pose: tuple[Parameter, ...]
) -> None:
    found = []
    for value in (0.0, 1e3):
        planes = []
        for plane in pixels.recorded:
            sigma, amplitude = np.ones(plane.amplitude.shape, np.float32), plane.amplitude.copy()
            sigma[120:130, 120:130], amplitude[120:130, 120:130] = np.inf, value
            planes.append(Measurement(plane.distance_mm, amplitude, sigma))
        found.append(response(replace(pixels, recorded=planes), bars, HERE, pose))
    assert np.array_equal(found[0].residual, found[1].residual)
    assert np.array_equal(found[0].jacobian, found[1].jacobian)


def test_where_no_pose_is_sought_the_start_stays(pixels: DensePixels, bars: np.ndarray) -> None:
    start = Unknowns(HERE)
    assert blurred_search(pixels, bars, mounting_parameters(pixels.scene.lens, 2)[4:], start) is start
