"""Sommerfeld's half-plane, against its closed form, and the edge that eikonal tiles draw against it."""

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.analytic.beam import Beam
from wavesim.analytic.half_plane import GAP, half_plane_scene
from wavesim.analytic.registry import AnalyticCase
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.fields.field import relative_error
from wavesim.rays.edge_diffraction import fresnel_edge

DISTANCE_MM, SPREAD, THICKNESS_MM = 0.1, 0.1, 0.05


def closed_form(case: AnalyticCase, screen: str) -> np.ndarray:
    """Fresnel integrals of each plane wave of the beam, and of its reflection."""
    z = (1.0 + GAP) * DISTANCE_MM + THICKNESS_MM
    y = case.scene.exit_grid.y_mm - case.scene.object_grid.centre_mm[1]
    k, r, turn = case.scene.wavenumber_per_mm, np.hypot(y, z), np.arctan2(y, z)[:, None]
    angle, weight = Beam(case.scene.wavelength_um, SPREAD).plane_waves(DISTANCE_MM + 2.0 * z)
    x = -np.sqrt(2.0 * k * r)[:, None]
    across, along = np.outer(y, np.sin(angle)), z * np.cos(angle)
    wave = np.exp(1j * k * (across + along)) * fresnel_edge(x * np.sin(0.5 * (turn - angle)))
    if screen == "conductor":
        reflected = fresnel_edge(x * np.sin(0.5 * (np.pi - angle - turn)))
        wave -= np.exp(1j * k * (across - along)) * reflected
    return wave @ (weight * np.exp(1j * k * DISTANCE_MM * np.cos(angle)))


@pytest.mark.parametrize("screen", ["black", "conductor"])
def test_a_plate_of_air_leaves_the_closed_form(screen: str) -> None:
    case = half_plane_scene(1.0, THICKNESS_MM, DISTANCE_MM, spread=SPREAD, screen=screen)
    assert relative_error(case.exact.values, closed_form(case, screen)) < 1e-8


def test_half_of_the_light_passes() -> None:
    """But for what both faces of the plate reflect, and what the edge sends beyond the grid."""
    case = half_plane_scene(1.5195, THICKNESS_MM, DISTANCE_MM)
    passed = (4.0 * 1.5195 / 2.5195**2) ** 2
    assert case.exact.energy == pytest.approx(0.5 * passed * case.object_field.energy, rel=0.02)


@pytest.mark.parametrize("index", [1.0, 1.5195])
def test_edge_of_eikonal_tiles(index: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Most of what they leave out lies deep in the shadow, where they end."""
    case = half_plane_scene(index)
    width_mm = 4.0 * case.scene.object_grid.pitch_mm
    drawn = FlatTiles(case.scene, tile_width_mm=width_mm)
    error = relative_error(drawn.forward(case.object_field).values, case.exact.values)
    monkeypatch.setattr(FlatTiles, "_draws_edges", False)
    sharp = FlatTiles(case.scene, tile_width_mm=width_mm)
    assert error < 0.03
    assert error < drawn.predicted_error()
    assert relative_error(sharp.forward(case.object_field).values, case.exact.values) > 4.0 * error


def test_what_the_screen_is_made_of_matters_less_with_distance() -> None:
    near, far = (
        relative_error(
            *(half_plane_scene(distance_mm=d, screen=s).exact.values for s in ("conductor", "black"))
        )
        for d in (0.1, 0.4)
    )
    assert far == pytest.approx(0.5 * near, rel=0.1)


@pytest.mark.parametrize(
    "arguments",
    [{"index": 0.9}, {"thickness_mm": 0.0}, {"distance_mm": np.nan}, {"screen": "grey"}, {"spread": 0.3}],
)
def test_refused(arguments: dict) -> None:
    with pytest.raises(InputError):
        half_plane_scene(**arguments)
