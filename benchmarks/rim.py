"""A point that fills the stop, on the axis of a twin: rays with the edge as light draws it, against a sum.

    python -m benchmarks.rim [--scale 0.0625]

The truth takes tangent planes at the surfaces, as the wave propagation method does, and sums over all plane
waves of a medium by quadrature: it has neither a band nor samples at the rim. It is for a point on the axis
alone, where all that is needed lies along a radius. Its seconds grow with the square of the scale and more:
a minute at 1/16 on a line, a quarter of an hour at 1/4.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from wavesim import Engine, Field, Grid, Scene
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.metrics.axisymmetric_reference import summed_plane_waves
from wavesim.scene.patches import patch_scene

PLANE_MM, PITCH_MM = 2.0, 0.25e-3
"""Behind the full-size lens; of the object's samples, whose own band then ends far beyond the stop."""

LARGEST_PLANE = 0.1
"""Scale below which the plane is tried, too."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=0.0625, help="of the twin")
    scale = parser.parse_args().scale
    print(f"lens times {scale:g}: measured and predicted error of the field (%)")
    for is_line in (True, False) if scale < LARGEST_PLANE else (True,):
        scene = _scene(scale, is_line)
        middle = tuple(n // 2 for n in scene.exit_grid.shape)
        radii = np.abs(scene.exit_grid.y_mm[middle[0] :])
        true = summed_plane_waves(scene, _point(scene).values, radii)
        weight = np.ones_like(radii) if is_line else radii
        engines: dict[str, Engine] = {"eikonal": FlatTiles(scene, tile_width_mm=PITCH_MM, error=0.01)}
        if is_line:
            engines |= {f"wpm, {zones:g} zones": WavePropagation(scene, zones=zones) for zones in (4.0, 80.0)}
        for name, engine in engines.items():
            found = engine.forward(_point(scene)).values
            along = found[middle[0] :] if is_line else found[middle[0] :, middle[1]]
            error = math.sqrt(np.sum(weight * np.abs(along - true) ** 2) / np.sum(weight * np.abs(true) ** 2))
            where, predicted = "line" if is_line else "plane", engine.predicted_error()
            print(f"{where}, {name:14} {100.0 * error:7.3f} {100.0 * predicted:7.3f}", flush=True)


def _scene(scale: float, is_line: bool) -> Scene:
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), scale)
    scene = patch_scene(lens, 0.005, 0.0, meridional=is_line, plane_distance_mm=PLANE_MM * scale)
    grid = Grid((25,) if is_line else (5, 5), PITCH_MM, scene.object_grid.z_mm)
    return replace(scene, object_grid=grid)


def _point(scene: Scene) -> Field:
    values = np.zeros(scene.object_grid.shape, complex)
    values[tuple(n // 2 for n in values.shape)] = 1.0
    return Field(scene.object_grid, values, scene.wavelength_um)


if __name__ == "__main__":
    main()
