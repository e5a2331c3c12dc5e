"""Upper limit of an amplitude object whose scale is not known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from lensdesign import load_design, scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction.amplitude_limit import with_own_limit
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.patches import patch_scene
from wavesim.sensor.measurement import Measurement, recorded_intensity

SCALE = 150.0
"""True square root of the electrons on a pixel per unit of the modelled amplitude."""


@dataclass(frozen=True, eq=False)
class Bench:
    engine: Engine
    light: Field
    inside: NDArray[np.bool_]

    def recorded(self, transmission: NDArray[np.floating]) -> list[Measurement]:
        """Return planes with shot noise."""
        shape = self.engine.scene.exit_grid.shape
        blank = [Measurement(z, np.zeros(shape, np.float32)) for z in (0.0, 0.3)]
        model = ChannelModel.of_source(self.engine, self.light, blank, SCALE)
        random, planes = np.random.default_rng(3), []
        for plane, modelled in zip(blank, model.amplitudes(transmission.astype(np.complex64)), strict=True):
            electrons = random.poisson(modelled.astype(float) ** 2).astype(float)
            planes.append(recorded_intensity(plane.distance_mm, electrons, np.maximum(electrons, 1.0)))
        return planes

    def found(self, recorded: list[Measurement]) -> tuple[Reconstructed, Reconstructed]:
        """Return the object with a fitted scale, and the one whose brightest parts are 1."""
        solve = partial(
            reconstruct,
            self.engine,
            self.light,
            recorded,
            kind="amplitude",
            tv_weight="auto",
            until_noise=True,
        )

        def search(
            start: Field | None, scale: float, *, bounded: bool, iterations: int | None = None
        ) -> Reconstructed:
            return solve(start=start, scale=scale, bounded=bounded, iterations=iterations or 80)

        first = solve()
        noise = noise_of_step(ChannelModel.of_source(self.engine, self.light, recorded, 1.0))
        return first, with_own_limit(search, first, self.light, noise)


@pytest.fixture(scope="module")
def bench() -> Bench:
    scene = patch_scene(scaled(load_design("designs/paper_singlet.toml"), 1 / 48), 0.02)
    engine, grid = engine_for(scene, "eikonal", error=0.1), scene.object_grid
    inside = np.sqrt(grid.radius_squared_mm2()) < 0.01
    return Bench(engine, Field(grid, inside.astype(np.complex64), scene.wavelength_um), inside)


def scene_picture(bench: Bench) -> NDArray[np.floating]:
    """Return a grey picture: a smooth ground, darker blocks, and some bright ones."""
    grid = bench.light.grid
    x, y = 1e3 * grid.x_mm, 1e3 * grid.y_mm[:, None]
    values = 0.45 + 0.01 * x + 0.008 * y
    values[(np.abs(x + 4) < 2) & (np.abs(y) < 3)] = 0.15
    values[(np.abs(x - 3) < 1.5) & (np.abs(y - 3) < 1.5)] = 0.9
    values[(np.abs(x - 1) < 1.5) & (np.abs(y + 5) < 1.0)] = 0.7
    return values


def clipped(found: Reconstructed, bench: Bench) -> float:
    return float(np.mean(found.transmission.values.real[bench.inside] > 0.999))


def correlation(found: Reconstructed, true: NDArray[np.floating], bench: Bench) -> float:
    return float(np.corrcoef(found.transmission.values.real[bench.inside], true[bench.inside])[0, 1])


def test_bright_parts_of_a_grey_picture_are_not_clipped(bench: Bench) -> None:
    true = scene_picture(bench)
    first, found = bench.found(bench.recorded(true))
    assert clipped(first, bench) > 0.2
    assert clipped(found, bench) < 0.1
    assert correlation(found, true, bench) > correlation(first, true, bench) + 0.02
    # The bright block is the brightest part.
    assert found.scale == pytest.approx(0.9 * SCALE, rel=0.05)
    assert found.transmission.values.real.max() <= 1.0


def test_the_result_does_not_depend_on_the_brightness_of_the_object(bench: Bench) -> None:
    true = scene_picture(bench)
    scale = [bench.found(bench.recorded(factor * true))[1].scale for factor in (1.0, 0.7)]
    assert scale[1] / scale[0] == pytest.approx(0.7, rel=0.05)


def test_an_object_through_which_no_light_passes_stays_as_it_is(bench: Bench) -> None:
    dark = bench.light.with_values(np.zeros_like(bench.light.values))
    found = Reconstructed(dark, (1.0,), (), 1.0, "converged")
    assert with_own_limit(lambda *_, **__: found, found, bench.light, 0.1) is found


def test_the_clear_ground_of_a_chart_is_1(bench: Bench) -> None:
    grid = bench.light.grid
    x, y = 1e3 * grid.x_mm, 1e3 * grid.y_mm[:, None]
    bars = (np.floor(x / 1.5) % 2 == 0) & (np.abs(x) < 5) & (np.abs(y) < 3)
    true = np.where(bars, 0.0, 1.0)
    first, found = bench.found(bench.recorded(true))
    assert found.scale == pytest.approx(SCALE, rel=0.03)
    assert correlation(found, true, bench) > correlation(first, true, bench) - 0.002


def test_a_limit_that_is_far_too_low_does_not_decide_what_is_found(bench: Bench) -> None:
    """The search that starts anew is kept where it fits better than the one that continues."""
    ones = np.ones_like(bench.light.values)

    def search(
        start: Field | None, scale: float, *, bounded: bool, iterations: int | None = None
    ) -> Reconstructed:
        value, misfit = (0.5, 0.1) if start is None else (1.2, 0.2)
        unlimited = bench.light.with_values((value * ones).astype(np.complex64))
        found = unlimited if start is None or not bounded else start
        return Reconstructed(found, (misfit,), (), scale, "converged")

    first = Reconstructed(bench.light.with_values(ones), (0.3,), (), SCALE, "converged")
    found = with_own_limit(search, replace(first, transmission=trapped(bench)), bench.light, 1e-3)
    assert found.scale == pytest.approx(0.5 * SCALE)
    assert found.transmission.values.real[bench.inside] == pytest.approx(1.0)


def trapped(bench: Bench) -> Field:
    """Return an object of which half is at the limit."""
    x = bench.light.grid.x_mm
    return bench.light.with_values(
        np.where(x > 0.0, 1.0, 0.4).astype(np.complex64) * np.ones_like(bench.light.values)
    )
