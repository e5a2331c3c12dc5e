"""How wide and how broad the light is, from frames of more directions and wavelengths than the model has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design
from wavesim.fields.field import Field, Grid
from wavesim.forward.channel_model import ChannelModel
from wavesim.reconstruction import source_search
from wavesim.reconstruction.source_search import SourceWarning, coherent_deg, coherent_nm, find_source
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import Source, SourceMode
from wavesim.sensor.measurement import Measurement, recorded_intensity

SAMPLES, PITCH_MM, DISTANCES_MM, ELECTRONS = 48, 0.42e-3, (0.0, 0.17), 1e6


class FarField(Engine):
    """The object's spectrum within an aperture, one sample for each pixel: a lens that does not err."""

    name = "far field"

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        # Directions on the samples of the sensor, at which the waves of all wavelengths arrive.
        index = np.arange(SAMPLES) - SAMPLES // 2
        sine = index * 0.532e-3 / (SAMPLES * PITCH_MM)
        wave = np.exp(-2e3j * np.pi / scene.wavelength_um * PITCH_MM * np.outer(sine, index))
        self.wave = wave / np.sqrt(SAMPLES)
        squares = sine[:, None] ** 2 + sine**2
        self.passed = (squares < 0.25) * np.exp(40j * squares)

    def _forward(self, values: Any) -> Any:
        return (self.passed * (self.wave @ values @ self.wave.T)).astype(values.dtype)

    def _adjoint(self, values: Any) -> Any:
        back = self.wave.conj().T @ (values * self.passed.conj()) @ self.wave.conj()
        return back.astype(values.dtype)

    def cost(self) -> Cost:
        return Cost(0.1, 0.0, 0)

    def error_terms(self) -> tuple:
        return ()

    def settings(self) -> dict:
        return {}


def far_field() -> FarField:
    lens = load_design("designs/paper_singlet.toml")
    shape = (SAMPLES, SAMPLES)
    grids = Grid(shape, PITCH_MM, lens.object_z_mm), Grid(shape, 3.2e-3, lens.exit_vertex_z_mm + 1.0)
    return FarField(Scene(lens, *grids, 0.532))


def lit_by(engine: Engine) -> Field:
    grid = engine.scene.object_grid
    stop = np.hypot(grid.y_mm[:, None], grid.x_mm) < 0.4 * SAMPLES * PITCH_MM
    return Field(grid, stop.astype(np.complex64), 0.532)


def planes_in(engine: Engine, light: Field, modes: Sequence[SourceMode]) -> list[Measurement]:
    """Of random blocks, with shot noise."""
    random = np.random.default_rng(3)
    blocks = np.kron(random.random((SAMPLES // 4, SAMPLES // 4)) > 0.4, np.ones((4, 4)))
    blank = [Measurement(distance, np.ones(blocks.shape, np.float32)) for distance in DISTANCES_MM]
    planes = []
    for made, plane in zip(
        ChannelModel.of_source(engine, light, blank, 1.0, 1.0, modes=modes).amplitudes(blocks),
        blank,
        strict=True,
    ):
        gain = ELECTRONS / float(made.max()) ** 2
        counts = random.poisson(gain * made.astype(float) ** 2)
        planes.append(recorded_intensity(plane.distance_mm, counts / gain, np.maximum(counts, 1.0) / gain**2))
    return planes


@pytest.mark.parametrize("fraction", [0.0, 1.2])
def test_the_width_of_a_source_is_found_with_the_object(fraction: float) -> None:
    """In widths at which light is coherent over half of the object."""
    engine = far_field()
    light = lit_by(engine)
    width_deg = fraction * coherent_deg(light)
    settings = ReconstructionSettings(kind="amplitude", source_deg="find")
    messages: list[str] = []
    planes = planes_in(engine, light, Source(width_deg).modes(0.532, 3, 10))
    found = find_source(engine, light, planes, settings, messages.append)
    assert found.source.width_deg == pytest.approx(width_deg, rel=0.05)
    assert found.source.bandwidth_nm == 0.0
    assert messages[1] == f"width of the source: {coherent_deg(light):.3g}°"
    assert found.transmission.grid == light.grid


@pytest.mark.parametrize(("fraction", "width_deg"), [(0.0, 0.0), (1.5, 0.0), (1.5, 0.3)])
def test_the_bandwidth_is_found_with_the_object(fraction: float, width_deg: float) -> None:
    """In bandwidths that shift the steepest light by a speckle; the light comes from a known width."""
    engine = far_field()
    light = lit_by(engine)
    bandwidth_nm = fraction * coherent_nm(light)
    settings = ReconstructionSettings(kind="amplitude", bandwidth_nm="find", source_deg=width_deg)
    planes = planes_in(engine, light, Source(width_deg, bandwidth_nm).modes(0.532))
    known = Source(width_deg)
    found = find_source(engine, light, planes, settings, lambda text: None, known=known)
    assert found.source.bandwidth_nm == pytest.approx(bandwidth_nm, rel=0.05)
    assert found.source.width_deg == width_deg
    assert 0.0 < found.deviations["bandwidth_nm"] < 0.5 * coherent_nm(light)


def test_width_and_bandwidth_are_found_together() -> None:
    engine = far_field()
    light = lit_by(engine)
    true = Source(0.8 * coherent_deg(light), 1.2 * coherent_nm(light))
    settings = ReconstructionSettings(kind="amplitude", source_deg="find", bandwidth_nm="find")
    found = find_source(
        engine, light, planes_in(engine, light, true.modes(0.532, 3, 10)), settings, lambda text: None
    )
    assert found.source.width_deg == pytest.approx(true.width_deg, rel=0.07)
    assert found.source.bandwidth_nm == pytest.approx(true.bandwidth_nm, rel=0.07)
    assert set(found.deviations) == {"width_deg", "bandwidth_nm"}


def test_a_band_beyond_the_limit_of_the_search_is_not_stated_as_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With a limit of one speckle in place of eight, for light of two."""
    monkeypatch.setattr(source_search, "BROADEST", 1.0)
    engine = far_field()
    light = lit_by(engine)
    planes = planes_in(engine, light, Source(0.0, 2.0 * coherent_nm(light)).modes(0.532))
    settings = ReconstructionSettings(kind="amplitude", bandwidth_nm="find")
    with pytest.warns(SourceWarning, match=f"{coherent_nm(light):.3g} nm is the limit of the search"):
        found = find_source(engine, light, planes, settings, lambda text: None)
    assert found.source.bandwidth_nm == pytest.approx(coherent_nm(light))
    assert found.at_limit == ("bandwidth_nm",)
    assert found.deviations == {}


def test_a_width_that_has_not_converged_is_not_stated_as_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_search, "MOST_WIDTHS", 1)
    engine = far_field()
    light = lit_by(engine)
    planes = planes_in(engine, light, Source(3.0 * coherent_deg(light)).modes(0.532, 3, 10))
    settings = ReconstructionSettings(kind="amplitude", source_deg="find")
    with pytest.warns(SourceWarning, match="did not converge with 1 sources"):
        found = find_source(engine, light, planes, settings, lambda text: None)
    assert not found.has_converged
    assert not found.at_limit
    assert found.deviations == {}
