"""The whole 3 mm field on a GPU: tiles in two levels against the processor's, and the paper's slices in full.

    python -m benchmarks.gpu_field [--device gpu] [--samples 31000]

Where no GPU is there it says so, and that is all. With `--device cpu` NumPy stands in for it, to try the
script at few samples.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.fft

from benchmarks.full_field import MISMATCH, dot_product_mismatch, field_scene, noisy_fields
from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import Lens, load_design
from lensdesign.errors import InputError
from wavesim import Scene, engine_for
from wavesim.engines.slices.compensation import centre_rays, compensation
from wavesim.engines.slices.samples import IlluminatedArea, SlicedSurface, sliced
from wavesim.engines.slices.steps import through_surface
from wavesim.engines.slices.windows import Waves
from wavesim.engines.surfaces.grids import LightWithin, light_within
from wavesim.engines.surfaces.waves import Medium
from wavesim.engines.whole_field.engine import WholeFieldEngine
from wavesim.fields.field import Grid, relative_error
from wavesim.rays.interfaces import surface_map
from wavesim.runtime.device import Device, device_named

FIELD_MM, SIDE, SAMPLES = 3.0, 7000, 31_000
"""Of the paper: field, pixels along the sensor, samples along the sliced method's grid."""

SLICES, FEW, MANY = 200, 2, 6
"""Of each surface, and those that are timed."""

ARRAYS = 4.0
"""Complex arrays that a slice needs: two spectra, the wave, two quarters of factors, and blocks of work."""

COMPILED_MM, COMPILED_SIDE = 0.1, 250
"""Field and pixels along the sensor with which loops and device code are compiled before they are timed."""

CHECKED = 1000
"""Samples along the grid on which slices are held against double precision."""

SAME, SAME_SLICES = 1e-3, 1e-4


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", choices=("cpu", "gpu"), default="gpu")
    parser.add_argument("--samples", type=int, default=SAMPLES)
    given = parser.parse_args()
    try:
        device = device_named(given.device)
    except InputError as error:
        print(f"left out: {error}")
        return
    lens = load_design(DESIGNS / "paper_singlet.toml")
    share = min(given.samples / SAMPLES, 1.0)
    with _transforms(device):
        side = max(round(SIDE * share), 16)
        tiles(lens, device, min(COMPILED_MM, FIELD_MM * share), min(COMPILED_SIDE, side))
        print_table(
            f"Field of {FIELD_MM * share:g} mm, {side}^2 pixels", tiles(lens, device, FIELD_MM * share, side)
        )
        samples = _that_fit(device, given.samples)
        print_table(
            f"Slices on {samples}^2 samples, complex64, {SLICES} for each surface",
            slices(lens, device, samples),
        )


def _transforms(device: Device) -> AbstractContextManager[Any]:
    """The library that does Fourier transforms of the device's arrays."""
    if device.xp is np:
        return nullcontext()
    import cupyx.scipy.fft  # type: ignore[import-not-found]

    return scipy.fft.set_backend(cupyx.scipy.fft)


def tiles(lens: Lens, device: Device, field_mm: float, side: int) -> list[Row]:
    """Forward and adjoint of the processor and of the device, one after the other."""
    scene = field_scene(lens, field_mm, side)
    engine = engine_for(scene, "hierarchical", error=1e-2)
    assert isinstance(engine, WholeFieldEngine)
    starts = noisy_fields(scene)
    engine.groups  # noqa: B018
    rows, results = [], []
    for name, carry, start in zip(
        ("forward", "adjoint"), (engine.forward, engine.adjoint), starts, strict=True
    ):
        engine.device = None
        known, processor_s = _timed(lambda c=carry, s=start: c(s).values)
        engine.device = device
        first, _ = _timed(lambda c=carry, s=start: c(s).values)
        found, device_s = _timed(lambda c=carry, s=start: c(s).values)
        results.append(found)
        rows += [
            Row(f"{name}, processor", processor_s, "s"),
            Row(f"{name}, device", device_s, "s"),
            Row("  processor over device", processor_s / device_s),
            Row("  difference from the processor's", relative_error(found, known), at_most=SAME),
            Row("  difference of two runs", relative_error(found, first), at_most=SAME),
        ]
    mismatch = dot_product_mismatch(starts[0], results[0], starts[1], results[1])
    return [*rows, Row("dot-product test on the device, of the sizes", mismatch, at_most=MISMATCH)]


def slices(lens: Lens, device: Device, samples: int) -> list[Row]:
    """Some slices of the first surface, and what all slices would take."""
    scene = field_scene(lens, FIELD_MM)
    light = light_within(scene)
    sides, few, many = _surface(scene, light, samples)
    seconds = []
    for surface in (few, few, many):  # the first one compiles
        _, taken = _timed(lambda s=surface: _passed(device, sides, s))
        seconds.append(taken)
    each = (seconds[2] - seconds[1]) / (MANY - FEW)
    transported = 8.0 * samples * samples
    off = _difference(device, scene, light, min(samples, CHECKED))
    return [
        Row("one slice", each, "s"),
        Row(f"{SLICES} slices of both surfaces, from {MANY - FEW} of them", 2.0 * SLICES * each, "s"),
        Row("an array", 1e-9 * transported, "GB"),
        Row(f"difference from double precision, {min(samples, CHECKED)}^2", off, at_most=SAME_SLICES),
    ]


def _difference(device: Device, scene: Scene, light: LightWithin, samples: int) -> float:
    """Of the device's single precision from the processor's double precision."""
    sides, _, surface = _surface(scene, light, samples)
    found = device.to_host(_passed(device, sides, surface))
    return relative_error(found, through_surface(*sides, surface, _from_middle(np, sides[0], complex)))


def _passed(device: Device, sides: tuple[Waves, Waves], surface: SlicedSurface) -> Any:
    """Waves behind slices."""
    return through_surface(*sides, surface, _from_middle(device.xp, sides[0], np.complex64))


def _from_middle(xp: Any, waves: Waves, kind: Any) -> Any:
    """Waves of one size, in phase in the middle of the window."""
    start = xp.ones(waves.shape, dtype=kind)
    start[1::2] *= -1.0
    start[:, 1::2] *= -1.0
    return start


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """A result, and the seconds until the device has it."""
    start = time.perf_counter()
    result = work()
    if hasattr(result, "get"):
        result[:1, :1].get()
    return result, time.perf_counter() - start


def _surface(
    scene: Scene, light: LightWithin, samples: int
) -> tuple[tuple[Waves, Waves], SlicedSurface, SlicedSurface]:
    """Waves about the first surface on a grid of so many samples, and its innermost slices: few, and many."""
    half = light.own_half_mm(0)
    grid = Grid((samples, samples), 2.0 * half / samples, 0.0, light.middle_mm)
    front, behind = (
        Waves(Medium(grid, scene.wavelength_um, float(scene.system.index[0, i]), light.bands_per_mm[i]))
        for i in (0, 1)
    )
    low, high = light.heights_mm[0]
    planes = np.linspace(low, high, SLICES + 1)[: MANY + 1]
    reach = _radius_mm(scene, float(planes[-1]), light.reach_mm[0])
    given = compensation(scene, centre_rays(scene, scene.object_grid.centre_mm)[0], oblique=False)
    many = sliced(IlluminatedArea(scene, 0, grid, reach), given, planes, False, np.complex64)
    cut = slice(FEW)
    few = replace(
        many,
        labels=many.labels[cut],
        boxes=many.boxes[cut],
        before_mm=many.before_mm[cut],
        behind_mm=many.behind_mm[cut],
    )
    return (front, behind), few, many


def _radius_mm(scene: Scene, highest_mm: float, reach_mm: float) -> float:
    """Distance from the axis at which the first surface has a height."""
    profile = np.linspace(0.0, reach_mm, 1001)
    heights = surface_map(scene.system, 0, 0.0 * profile, profile).z_mm
    return float(np.interp(highest_mm, heights, profile))


def _that_fit(device: Device, samples: int) -> int:
    """So many samples along the grid as asked for, or as memory holds, which is said."""
    free = device.memory()[0]
    most = int(math.sqrt(free / (8.0 * ARRAYS)))
    if samples > most:
        print(f"{samples}^2 samples need {8e-9 * ARRAYS * samples**2:.3g} GB, {1e-9 * free:.3g} GB are free")
    return min(samples, most)


if __name__ == "__main__":
    main()
