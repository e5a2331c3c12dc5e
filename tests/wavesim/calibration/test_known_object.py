"""Finding how a lens is mounted from frames of a known object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from small_twins import bars_under_stop

from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.calibration.known_object import calibrate
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor.measurement import Measurement

TRUE = SystemState(Pose(decenter_x_mm=2.5e-3, decenter_y_mm=-1e-3, tilt_x_deg=-1.0, tilt_y_deg=2.0))


def tiles(scene: Scene) -> Engine:
    """One tile: the search makes an engine for every mounting."""
    return engine_for(scene, "eikonal", error=0.3)


@dataclass(frozen=True, eq=False)
class Bench:
    """Bars behind a small twin that is mounted with errors, and their frames."""

    scene: Scene
    light: Field
    known: Field
    recorded: list[Measurement]


@pytest.fixture(scope="module")
def bench() -> Bench:
    scene, light, bars, _ = bars_under_stop()
    known = Field(scene.object_grid, bars.astype(np.complex64), 0.532)
    blank = [Measurement(d, np.ones(scene.exit_grid.shape, np.float32)) for d in (0.0, 0.6)]
    model = ChannelModel.of_source(tiles(placed_scene(scene, TRUE)), placed_light(light, TRUE), blank, 1.0)
    seen = [
        Measurement(plane.distance_mm, amplitude.astype(np.float32))
        for plane, amplitude in zip(blank, model.amplitudes(known.values), strict=True)
    ]
    return Bench(scene, light, known, seen)


def test_a_known_target_tells_decenter_and_tilt(bench: Bench) -> None:
    brighter = [Measurement(p.distance_mm, 3.0 * p.amplitude) for p in bench.recorded]
    found = calibrate(bench.scene, bench.light, brighter, known=bench.known, make=tiles)
    assert found.values == pytest.approx([parameter.value(TRUE) for parameter in found.sought], rel=0.03)
    assert found.state.pose == Pose(**dict(zip(found.parameters, found.values, strict=True)))
    assert found.misfit < 0.05 * found.misfit_before
    assert found.stopped_because == "converged"
    assert found.at_reach == ()
    assert repr(found).startswith("Calibrated(decenter_x_mm 0.00")
    assert f"{len(found.trail)} mountings, converged" in found._repr_html_()
    assert "at the border tilt_x_deg" in repr(replace(found, at_reach=("tilt_x_deg",)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"parameters": "decenter_z_mm"}, "unknown; allowed"),
        ({"parameters": ""}, "one or more"),
        ({"most_mountings": 0}, "most_mountings = 0"),
        ({"known": Field(Grid((4, 4), 1e-3, -1.0), np.ones((4, 4)), 0.532)}, "known object"),
    ],
)
def test_unusable_choices_are_refused(bench: Bench, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        calibrate(bench.scene, bench.light, bench.recorded, **{"known": bench.known, **changed})
