"""How wide a source is, from frames that were made by more directions than the model has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.fft

from lensdesign import load_design
from wavesim.fields.field import Field, Grid
from wavesim.forward.forward_model import ForwardModel
from wavesim.reconstruction.source_width import blur_ratio, coherent_deg, find_source_width
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import ReconstructionSettings
from wavesim.scene.source import Source
from wavesim.sensor.measurement import Measurement, recorded_intensity

SAMPLES, PITCH_MM, DISTANCES_MM, ELECTRONS = 64, 0.42e-3, (0.0, 0.17), 1e6


class FarField(Engine):
    """The object's spectrum within an aperture, one sample for each pixel: a lens that does not err."""

    name = "far field"

    def __init__(self) -> None:
        lens = load_design("designs/paper_singlet.toml")
        shape = (SAMPLES, SAMPLES)
        before = Grid(shape, PITCH_MM, lens.object_z_mm)
        super().__init__(Scene(lens, before, Grid(shape, 3.2e-3, lens.exit_vertex_z_mm + 1.0), 0.532))
        sine = scipy.fft.fftshift(scipy.fft.fftfreq(SAMPLES, PITCH_MM)) * 0.532e-3
        squares = sine[:, None] ** 2 + sine**2
        self.passed = (squares < 0.25) * np.exp(40j * squares)

    def _forward(self, values: Any) -> Any:
        spectrum = scipy.fft.fft2(scipy.fft.ifftshift(values), norm="ortho")
        return (scipy.fft.fftshift(spectrum) * self.passed).astype(values.dtype)

    def _adjoint(self, values: Any) -> Any:
        spectrum = scipy.fft.ifftshift(values * self.passed.conj())
        return scipy.fft.fftshift(scipy.fft.ifft2(spectrum, norm="ortho")).astype(values.dtype)

    def cost(self) -> Cost:
        return Cost(0.1, 0.0, 0)

    def error_terms(self) -> tuple:
        return ()

    def settings(self) -> dict:
        return {}


def lit_by(engine: Engine) -> Field:
    grid = engine.scene.object_grid
    stop = np.hypot(grid.y_mm[:, None], grid.x_mm) < 0.4 * SAMPLES * PITCH_MM
    return Field(grid, stop.astype(np.complex64), 0.532)


def planes_in(engine: Engine, light: Field, width_deg: float) -> list[Measurement]:
    """Of random blocks, with shot noise; 30 directions."""
    random = np.random.default_rng(3)
    blocks = np.kron(random.random((16, 16)) > 0.4, np.ones((4, 4)))
    blank = [Measurement(distance, np.ones(blocks.shape, np.float32)) for distance in DISTANCES_MM]
    modes = Source(width_deg).modes(0.532, 3, 10)
    planes = []
    for made, plane in zip(
        ForwardModel(engine, light, blank, 1.0, 1.0, modes=modes).amplitudes(blocks), blank, strict=True
    ):
        gain = ELECTRONS / float(made.max()) ** 2
        counts = random.poisson(gain * made.astype(float) ** 2)
        planes.append(recorded_intensity(plane.distance_mm, counts / gain, np.maximum(counts, 1.0) / gain**2))
    return planes


@pytest.mark.parametrize("fraction", [0.0, 1.2])
def test_the_width_of_a_source_is_found_with_the_object(fraction: float) -> None:
    """In widths at which light is coherent over half of the object."""
    engine = FarField()
    light = lit_by(engine)
    width_deg = fraction * coherent_deg(light)
    settings = ReconstructionSettings(kind="amplitude")
    messages: list[str] = []
    found, start = find_source_width(
        engine, light, planes_in(engine, light, width_deg), settings, messages.append
    )
    assert found == pytest.approx(width_deg, rel=0.05)
    assert messages[0] == f"width of the source: {coherent_deg(light):.3g} deg"
    assert start.grid == light.grid


def test_blur_ratio_follows_from_the_planes() -> None:
    engine = FarField()
    light = lit_by(engine)
    random = np.random.default_rng(5)
    shape = engine.scene.exit_grid.shape
    point = [1.0 + random.random(shape) for _ in DISTANCES_MM]
    wide = [np.sqrt(one**2 + 1e-3 * random.standard_normal(shape)) for one in point]
    for ratio in (0.0, 0.7, 1.0, 1.6):
        seen = [np.sqrt(p**2 + ratio * (w**2 - p**2)) for p, w in zip(point, wide, strict=True)]
        recorded = [Measurement(d, one) for d, one in zip(DISTANCES_MM, seen, strict=True)]
        model = ForwardModel(engine, light, recorded, 1.0)
        assert blur_ratio(recorded, model, wide, point) == pytest.approx(ratio, abs=2e-3)
