"""Errors of a bench as settings: what they become, and what is refused."""

from __future__ import annotations

import pytest

from lensdesign import load_design
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.scene.bench_settings import BenchSettings, modes_of
from wavesim.scene.system_state import SystemState

LENS = load_design("designs/paper_singlet.toml")


def state(**settings: object) -> SystemState:
    return BenchSettings().replaced(**settings).state(LENS, Pose(), 2)


def test_nothing_set_is_a_bench_as_designed() -> None:
    found = state()
    assert (found.surface_perturbations, found.light.amplitude) == ({}, {})
    assert (found.sensor_pose(1).shift_mm, found.background(1), found.source.width_deg) == (
        (0.0, 0.0),
        0.0,
        0.0,
    )
    assert BenchSettings().errors() == {}


def test_modes_and_surfaces_come_from_their_text() -> None:
    assert modes_of("10:-0.04, 02:5e-2") == {(1, 0): -0.04, (0, 2): 0.05}
    made = state(perturb="surface 1: radius_mm=0.01, index=-2e-3; surface 2: zernike_5_um=0.03, conic=0.1")
    first, second = (made.surface_perturbations[place] for place in (0, 1))
    assert (first.radius_mm, first.index, first.figure) == (0.01, -2e-3, None)
    assert second.conic == 0.1
    assert second.figure is not None
    assert second.figure.semi_diameter_mm == LENS.surfaces[1].semi_diameter_mm


def test_planes_get_what_is_theirs() -> None:
    made = state(
        plane_shift_um=((0.0, 0.0), (1.3, -2.2)), plane_background=(0.01,), working_distance_error_mm=0.004
    )
    assert made.sensor_pose(1).shift_mm == (pytest.approx(0.0013), pytest.approx(-0.0022))
    assert (made.background(0), made.background(1)) == (0.01, 0.01)
    assert made.object_shift_mm == (0.0, 0.0, -0.004)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"light_amplitude": "10=0.1"}, r"'10=0.1'"),
        ({"light_phase_waves": "00:0.1"}, "'00:0.1': must be orders"),
        ({"perturb": "surface 1: radius=0.1"}, "'radius': allowed: .*radius_mm"),
        ({"perturb": "surface 1: radius_mm=x"}, "'radius_mm=x'"),
        ({"perturb": "radius_mm=1"}, "'radius_mm=1': must have the form 'surface 1: radius_mm=0.01"),
        ({"perturb": "surface 3: conic=1"}, r"surface 3: .* 2"),
        ({"plane_background": (0.1, 0.1, 0.1)}, "plane_background = '0.1,0.1,0.1': must be one number, or 2"),
        ({"plane_background": (1.5,)}, "must be from 0 to below 1"),
        ({"plane_shift_um": ((0.0, 0.0),) * 3}, r"plane_shift_um: 3 .* 2 planes"),
        ({"exposure_error": (-1.0,)}, "exposure_error: .*above -1"),
        ({"source_deg": -1.0}, "source width_deg = -1.0"),
        ({"light_error_deg": (90.0, 0.0)}, "must be two angles"),
    ],
)
def test_what_cannot_be_is_refused_by_name(settings: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        state(**settings)
