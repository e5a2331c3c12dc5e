"""Super-tiles on a device against the compiled loops: on a stand-in for CuPy, and on a GPU where one is."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import stand_in_device
from numpy.typing import NDArray

from benchmarks import gpu_field
from lensdesign import Lens, Pose, scaled
from lensdesign.errors import InputError
from wavesim.engines.choosing import engine_for
from wavesim.engines.whole_field.carried import CarriedStep, interpolation_weights
from wavesim.engines.whole_field.engine import WholeFieldEngine
from wavesim.engines.whole_field.on_gpu import DeviceStep, blocks_of
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.resampling import coarse_axis, interpolation, kernel_for
from wavesim.runtime.device import Device, device_named, fourier_plan
from wavesim.scene.scene import Scene

WAVELENGTH_UM = 0.532
SAME = 1e-5
"""Relative difference that complex64 leaves between two orders of summation."""


def noise(grid: Grid, seed: int = 1) -> Field:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=grid.shape) + 1j * rng.normal(size=grid.shape)
    return Field(grid, values.astype(np.complex64), WAVELENGTH_UM)


def small_scene(lens: Lens, **changes: Any) -> Scene:
    """Part of the field of a twin; two by two super-tiles of a few tiles."""
    twin = scaled(lens, 1.0 / 32.0)
    grid = Grid((200, 190), 0.5e-3, twin.object_z_mm)
    plane = Grid((230, 250), 3.0e-3, twin.sensor_z_mm[0])
    return Scene(twin, grid, plane, WAVELENGTH_UM, **changes)


@pytest.fixture(scope="module", autouse=True)
def _transforms_of_one_library() -> Iterator[None]:
    """FINUFFT's for the loops too: two libraries differ by what a transform may err."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("wavesim.runtime.device.plan_of_terms", fourier_plan)
        yield


@pytest.fixture(scope="module")
def known(paper_lens: Lens) -> tuple[WholeFieldEngine, NDArray[Any], NDArray[Any]]:
    """The engine, and what the compiled loops make of noise there and back."""
    scene = small_scene(paper_lens, pose=Pose(tilt_x_deg=0.2, decenter_y_mm=0.005))
    engine = WholeFieldEngine(scene, error=3e-2, tiles_across=2)
    there = engine.forward(noise(scene.object_grid)).values
    back = engine.adjoint(noise(scene.exit_grid, 2)).values
    return engine, there, back


def on(engine: WholeFieldEngine, device: Device) -> WholeFieldEngine:
    """The same engine, its maps of the field included, on a device."""
    other = WholeFieldEngine(engine.scene, error=3e-2, tiles_across=2)
    other.__dict__.update({name: value for name, value in engine.__dict__.items() if name != "device"})
    other.device = device
    return other


@pytest.mark.parametrize("name", ["numpy", "stand-in"])
def test_a_device_gives_what_the_compiled_loops_give(known: Any, name: str) -> None:
    engine, there, back = known
    other = on(engine, device_named("cpu") if name == "numpy" else stand_in_device.device())
    assert len(other.groups) > 1
    mine = other.forward(noise(engine.scene.object_grid)).values
    assert type(mine) is np.ndarray
    assert mine.dtype == np.complex64
    assert relative_error(mine, there) < SAME
    mine = other.adjoint(noise(engine.scene.exit_grid, 2)).values
    assert type(mine) is np.ndarray
    assert relative_error(mine, back) < SAME


def test_adjoint_is_the_conjugate_transpose(known: Any) -> None:
    engine = on(known[0], stand_in_device.device())
    here, there = noise(engine.scene.object_grid, 3), noise(engine.scene.exit_grid, 4)
    out = engine.forward(here).values.astype(complex)
    back = engine.adjoint(there).values.astype(complex)
    left = np.vdot(there.values.astype(complex), out) * there.grid.cell
    right = np.vdot(back, here.values.astype(complex)) * here.grid.cell
    size = np.linalg.norm(out) * np.linalg.norm(there.values) * there.grid.cell
    assert abs(left - right) < 1e-6 * size


@pytest.mark.parametrize("memory_bytes", [30_000, 100_000])
def test_little_memory_takes_the_plane_in_bands(known: Any, memory_bytes: int) -> None:
    """The plane has 460 kB."""
    engine, there, back = known
    other = on(engine, stand_in_device.device(memory_bytes))
    assert relative_error(other.forward(noise(engine.scene.object_grid)).values, there) < SAME
    assert relative_error(other.adjoint(noise(engine.scene.exit_grid, 2)).values, back) < SAME


def test_bands_asked_for_are_the_computers_own(known: Any) -> None:
    engine, there, _ = known
    bands = list(
        on(engine, stand_in_device.device()).forward_in_bands(noise(engine.scene.object_grid), 77, {})
    )
    assert all(type(values) is np.ndarray for _, values in bands)
    assert relative_error(np.concatenate([values for _, values in bands]), there) < SAME


def test_blocks_are_the_matrix() -> None:
    fine, kernel = np.linspace(-1.0, 1.0, 101), kernel_for(1e-3)
    coarse = coarse_axis(fine, 0.07, kernel)
    weights = interpolation(coarse, fine, kernel)
    blocks = blocks_of(device_named("cpu"), weights, 16)
    assert [len(block) for _, _, block in blocks.parts] == [16] * 6 + [5]
    matrix, rng = weights.matrix().toarray(), np.random.default_rng(2)
    values = rng.normal(size=(len(coarse), 3)) + 1j * rng.normal(size=(len(coarse), 3))
    assert blocks.times(values) == pytest.approx(matrix @ values)
    assert blocks.transposed_times(matrix @ values) == pytest.approx(matrix.T @ (matrix @ values))


@pytest.mark.parametrize("first_row", [0, 10, 40])
def test_a_step_against_the_compiled_loop(first_row: int) -> None:
    """With phases of many turns, part of the aperture dark, and rows that lie in the plane in part."""
    rng, kernel = np.random.default_rng(4), kernel_for(1e-3)
    fine = np.linspace(-1.0, 1.0, 61), np.linspace(-0.7, 0.9, 53)
    coarse = tuple(coarse_axis(a, 0.11, kernel) for a in fine)
    y, x = (np.linspace(a[0] - 0.2, a[-1] + 0.2, 30) for a in fine)
    turns = 1e4 + 30.0 * y[:, None] ** 3 - 12.0 * x**2 + 7.0 * y[:, None] * x
    edge = ((1.2 - y[:, None] ** 2 - x**2) * 2.0 - 0.7).astype(np.float32)
    ways = interpolation_weights((coarse[0], coarse[1]), (y, x), fine, kernel)
    window = slice(2, 63), slice(1, 54)
    shape = len(coarse[0]), len(coarse[1])
    field = (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)
    expected, found = (np.zeros((45, 60), np.complex64) for _ in range(2))
    CarriedStep(ways, turns, edge, window).add(field, expected, first_row=first_row)
    DeviceStep(device_named("cpu"), CarriedStep(ways, turns, edge, window)).add(field, found, first_row)
    assert np.any(expected)
    assert found == pytest.approx(expected, abs=2e-5)


def test_the_device_is_told_among_the_settings(known: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    engine, device = known[0], stand_in_device.device()
    assert "device" not in engine.settings()
    assert on(engine, device).settings() == engine.settings() | {"device": "gpu"}
    monkeypatch.setattr("wavesim.engines.whole_field.engine.device_named", lambda name: device)
    made = engine_for(engine.scene, "hierarchical", device="gpu")
    assert isinstance(made, WholeFieldEngine)
    assert made.device is device


def test_a_mixture_of_memories_is_caught_by_the_stand_in() -> None:
    own, other = stand_in_device.device().to_device(np.ones(3)), np.ones(3)
    for mix in (lambda: own + other, lambda: other * own, lambda: np.asarray(own)):
        with pytest.raises(TypeError):
            mix()


def test_what_is_not_there_is_refused(paper_lens: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"no such device.*cpu, gpu"):
        WholeFieldEngine(small_scene(paper_lens), device="gpus")
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(InputError, match="extra gpu"):
        device_named("gpu")


@pytest.mark.parametrize("count", [0, None])
def test_a_computer_without_a_gpu_is_refused(monkeypatch: pytest.MonkeyPatch, count: int | None) -> None:
    class CUDARuntimeError(Exception):
        pass

    def get_device_count() -> int:
        if count is None:
            raise CUDARuntimeError("cudaErrorInsufficientDriver")
        return count

    runtime = SimpleNamespace(CUDARuntimeError=CUDARuntimeError, getDeviceCount=get_device_count)
    cupy = ModuleType("cupy")
    cupy.cuda = SimpleNamespace(runtime=runtime)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "cupy", cupy)
    monkeypatch.setitem(sys.modules, "cufinufft", ModuleType("cufinufft"))
    with pytest.raises(InputError, match="no GPU"):
        device_named("gpu")


def test_the_benchmark_runs_at_few_samples(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["gpu_field", "--device", "cpu", "--samples", "300"])
    gpu_field.main()
    said = capsys.readouterr().out
    assert said.count("difference from") == 3
    assert " NO" not in said


def test_a_gpu_gives_what_the_processor_gives(known: Any) -> None:
    try:
        device = device_named("gpu")
    except InputError as error:
        pytest.skip(str(error))
    engine, there, back = known
    other = on(engine, device)
    # Beside rounding, each of two libraries may err by 1e-3 in its transforms.
    assert relative_error(other.forward(noise(engine.scene.object_grid)).values, there) < 3e-3
    assert relative_error(other.adjoint(noise(engine.scene.exit_grid, 2)).values, back) < 3e-3
