"""Rays that are guided by a few others, against rays that are all aimed by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import Pose, SurfacePerturbation, load_design
from lensdesign.raytrace.compiled import compile_system
from wavesim.pupil import ray_aiming
from wavesim.pupil.characteristic import point_characteristic
from wavesim.pupil.ray_aiming import DEGREE, AimingMap
from wavesim.scene.system_state import SystemState

PAPER = load_design(DESIGNS / "paper_singlet.toml")
WAVELENGTH_UM = PAPER.wavelengths_um[0]

STATES = {
    "moved": SystemState(Pose(decenter_x_mm=0.05, tilt_y_deg=0.1)),
    "other lens": SystemState(surface_perturbations={0: SurfacePerturbation(index=1e-3, thickness_mm=0.02)}),
    "tilted sensor": SystemState(sensor_tilt_deg=(0.3, -0.2), sensor_shift_mm=(0.01, 0.0, 0.02)),
}


@pytest.fixture(scope="module", params=[(0.0, 0.0), (0.4, -1.2)])
def nominal(request: pytest.FixtureRequest) -> AimingMap:
    """Rays from a point on the axis, and from one at the rim of the field."""
    return point_characteristic(PAPER, request.param, samples=48).aiming_map()


@pytest.mark.parametrize("what", STATES)
def test_guided_rays_end_where_rays_aimed_by_themselves_do(
    nominal: AimingMap, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    state = STATES[what]
    system = compile_system(PAPER, WAVELENGTH_UM, state.pose, state.surface_perturbations)
    assert nominal._guides is not None
    guided = nominal.aim(system, state)
    plain = replace(nominal)
    plain.__dict__["_guides"] = None
    alone = plain.aim(system, state)
    np.testing.assert_array_equal(guided.arrived, alone.arrived)
    path_waves = 1e3 * (guided.path_mm - alone.path_mm)[alone.arrived] / WAVELENGTH_UM
    assert np.abs(path_waves).max() < ray_aiming.PATH_TOLERANCE_WAVES


def test_polynomials_between_guides_are_exact(nominal: AimingMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in parts, for bundles of many rays."""
    guides, random = nominal._guides, np.random.default_rng(0)
    assert guides is not None
    coefficients = random.standard_normal((DEGREE + 1, DEGREE + 1, 2))
    i, j = np.indices((DEGREE + 1, DEGREE + 1))
    coefficients[i + j > DEGREE] = 0.0
    values = np.polynomial.polynomial.polyval2d(*nominal.cosines, coefficients)
    found = guides.interpolated(values[:, guides.rays])
    np.testing.assert_allclose(found, values, atol=1e-9 * np.abs(values).max())
    monkeypatch.setattr(ray_aiming, "KEPT_RAYS", 1000)
    np.testing.assert_allclose(guides.interpolated(values[:, guides.rays]), found, atol=1e-15)


def test_corrections_that_polynomials_miss_guide_no_ray(
    nominal: AimingMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of a fine figure. Rays near the rim of the stop could otherwise be lost."""
    state = STATES["moved"]
    system = compile_system(PAPER, WAVELENGTH_UM, state.pose)
    assert nominal._guides is not None
    x, y = nominal.cosines[:, nominal._guides.rays]
    fine = np.cos(9.0 * np.arctan2(y, x))
    times = ray_aiming._times
    monkeypatch.setattr(ray_aiming, "_times", lambda matrices, vectors: times(matrices, vectors) * fine)
    targets = nominal.points_mm
    assert nominal._guided_cosines(system, nominal.object_point_mm, nominal.plane_z_mm, targets, None) is None
