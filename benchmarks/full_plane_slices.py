"""Annular slices on the whole plane beside those on a line: a twin of the paper's lens, as large as fits.

    python -m benchmarks.full_plane_slices [--scale 0.125] [--oblique 10] [--vertical N] [--precision single]

Bars of 0.775 um in a patch of 0.05 mm are carried to 2 mm (times the scale) behind the lens by slices and by
the eikonal engine, on the plane and on a meridional line, and what slices made is brought back by the eikonal
engine and refocused. Left out, the vertical slices are as thick as the paper's 200; 0 leaves them out.
"""

from __future__ import annotations

import argparse
import resource
import time
import warnings
from dataclasses import dataclass

import numpy as np
import scipy.fft

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import Field, Scene, engine_for, patch_scene
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.fields.field import Grid, correlation, relative_error
from wavesim.fields.plane_waves import PlaneWaves, phasor_of
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics.resolving import bars_field
from wavesim.scene.engine import Engine

PATCH_MM, PLANE_MM, LINE_UM, LENGTH_MM = 0.05, 2.0, 0.775, 0.004
OBJECT_PITCH_UM = 0.2
PAPER_SLICES, SCALE = 200, 0.125
REFOCUS_MM = np.arange(-0.03, 0.0301, 0.0005)


@dataclass(frozen=True)
class CarriedStep:
    """What slices make of bars, beside the eikonal engine, and what it took."""

    error: float
    correlation: float
    contrast: float
    refocus_um: float
    seconds: float
    setup_seconds: float
    predicted_bytes: float


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--oblique", type=int, default=10)
    parser.add_argument("--vertical", type=int)
    parser.add_argument("--precision", choices=("single", "double"), default="single")
    given = parser.parse_args()
    vertical = round(PAPER_SLICES * given.scale) if given.vertical is None else given.vertical
    for kind, count in (("oblique", given.oblique), ("vertical", vertical)):
        if count > 0:
            title = f"{count} {kind} slices of each surface, {given.scale:g} of the paper's lens"
            print_table(
                f"{title}, {given.precision} precision", rows(given.scale, count, kind, given.precision)
            )


def rows(scale: float, count: int, kind: str, precision: str) -> list[Row]:
    """Of the plane and of the line."""
    found = {}
    for name in ("line", "plane"):
        found[name] = carried(scale, name == "line", count, kind, precision)
    peak = 1e-6 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    plane = found["plane"]
    result = []
    for name, one in found.items():
        result += [
            Row(f"{name}: relative error of the exit field", one.error),
            Row(f"{name}: correlation with the eikonal engine's", one.correlation),
            Row(f"{name}: contrast of the lines, brought back", one.contrast),
            Row(f"{name}: refocus", one.refocus_um, "um"),
        ]
    return [
        *result,
        Row("plane: forward", plane.seconds, "s"),
        Row("plane: set-up", plane.setup_seconds, "s"),
        Row("plane: memory predicted", 1e-9 * plane.predicted_bytes, "GB"),
        Row("most memory of the process so far", peak, "GB"),
    ]


def carried(scale: float, line: bool, count: int, kind: str, precision: str) -> CarriedStep:
    """One engine on the plane or on a line."""
    scene = scene_of(scale, line)
    truth = engine_for(scene, "eikonal", error=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)  # of too few slices, which is what is looked at
        slices = AnnularSlices(scene, count, kind, precision=precision)  # type: ignore[arg-type]
        started = time.perf_counter()
        slices._prepared  # noqa: B018
        setup = time.perf_counter()
        bars = bars_of(scene)
        found = slices.forward(bars)
        done = time.perf_counter()
    exact = truth.forward(bars)
    contrast, refocus = brought_back(truth, found, exact)
    return CarriedStep(
        relative_error(found.values, exact.values),
        correlation(found.values, exact.values),
        contrast,
        refocus,
        done - setup,
        setup - started,
        slices.cost().peak_bytes,
    )


def scene_of(scale: float, line: bool) -> Scene:
    """A patch of a twin of the paper's lens, and all its light behind."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), scale)
    return patch_scene(
        lens,
        PATCH_MM,
        plane_distance_mm=scale * PLANE_MM,
        meridional=line,
        object_pitch_um=OBJECT_PITCH_UM,
    )


def bars_of(scene: Scene) -> Field:
    """Five bars across y; on the plane of a length, with soft ends."""
    grid = scene.object_grid
    along_y = bars_field(
        Grid(grid.shape[:1], grid.pitch_mm, grid.z_mm, (0.0, grid.centre_mm[1])), scene.wavelength_um, LINE_UM
    ).values
    values = along_y if grid.is_line else along_y[:, None] * np.exp(-0.5 * (grid.x_mm / LENGTH_MM) ** 2)
    return Field(grid, values, scene.wavelength_um)


def brought_back(truth: Engine, found: Field, exact: Field) -> tuple[float, float]:
    """Contrast of the bars where they are sharpest, and how far from the object that is (um)."""
    grid = truth.scene.object_grid
    target, seen = (scipy.fft.fftn(np.asarray(truth.adjoint(f).values, complex)) for f in (exact, found))
    kz = PlaneWaves.of(grid, found.wavelength_um).kz
    moved = [scipy.fft.ifftn(seen * target.conj() * phasor_of(kz * z)) for z in REFOCUS_MM]
    best = int(np.argmax([np.abs(one).max() for one in moved]))
    shift = np.unravel_index(int(np.argmax(np.abs(moved[best]))), grid.shape)
    sharp = scipy.fft.ifftn(seen * phasor_of(kz * REFOCUS_MM[best]))
    sharp = np.roll(sharp, [-s for s in shift], range(len(grid.shape)))
    profile = np.abs(sharp if grid.is_line else sharp[:, grid.shape[1] // 2]) ** 2
    middles = 2e-3 * LINE_UM * np.arange(-2, 3)
    y = grid.y_mm - grid.centre_mm[1]
    bright = float(np.interp(middles, y, profile).mean())
    dark = float(np.interp(0.5 * (middles[1:] + middles[:-1]), y, profile).mean())
    return (bright - dark) / (bright + dark), 1e3 * float(REFOCUS_MM[best])


if __name__ == "__main__":
    main()
