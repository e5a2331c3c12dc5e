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
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import hankel1, j0, j1

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from wavesim import Engine, Field, Grid, Scene
from wavesim.engines.surfaces.samples import surface_slopes, transmission_at
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.rays.interfaces import crossings, surface_map
from wavesim.scene.patches import patch_scene

Array = NDArray[Any]

PLANE_MM, PITCH_MM = 2.0, 0.25e-3
"""Behind the full-size lens; of the object's samples, whose own band then ends far beyond the stop."""

LARGEST_PLANE = 0.1
"""Scale below which the plane is tried, too."""

NODES, PANEL_MM, BLOCKS = 8, 1e-3, 400
"""Of a Gauss-Legendre rule in each panel; width of one on a surface; angles that are summed at a time."""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=0.0625, help="of the twin")
    scale = parser.parse_args().scale
    print(f"lens times {scale:g}: error of the field, and as it is told beforehand (%)")
    for is_line in (True, False) if scale < LARGEST_PLANE else (True,):
        scene = _scene(scale, is_line)
        middle = tuple(n // 2 for n in scene.exit_grid.shape)
        radii = np.abs(scene.exit_grid.y_mm[middle[0] :])
        true, weight = summed_plane_waves(scene, radii), np.ones_like(radii) if is_line else radii
        engines: dict[str, Engine] = {"eikonal": EikonalTiles(scene, tile_width_mm=PITCH_MM, error=0.01)}
        if is_line:
            engines |= {f"wpm, {zones:g} zones": WavePropagation(scene, zones=zones) for zones in (4.0, 80.0)}
        for name, engine in engines.items():
            found = engine.forward(_point(scene)).values
            along = found[middle[0] :] if is_line else found[middle[0] :, middle[1]]
            error = math.sqrt(np.sum(weight * np.abs(along - true) ** 2) / np.sum(weight * np.abs(true) ** 2))
            where, told = "line" if is_line else "plane", engine.predicted_error()
            print(f"{where}, {name:14} {100.0 * error:7.3f} {100.0 * told:7.3f}", flush=True)


def _scene(scale: float, is_line: bool) -> Scene:
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), scale)
    scene = patch_scene(lens, 0.005, 0.0, meridional=is_line, plane_distance_mm=PLANE_MM * scale)
    grid = Grid((25,) if is_line else (5, 5), PITCH_MM, scene.object_grid.z_mm)
    return replace(scene, object_grid=grid)


def _point(scene: Scene) -> Field:
    values = np.zeros(scene.object_grid.shape, complex)
    values[tuple(n // 2 for n in values.shape)] = 1.0
    return Field(scene.object_grid, values, scene.wavelength_um)


def summed_plane_waves(scene: Scene, radii_mm: Array) -> Array:
    """Field on the exit plane of a sample of 1 on the axis: Rayleigh-Sommerfeld, then Kirchhoff twice.

    Parameters
    ----------
    scene
        A lens of two surfaces of revolution, upright and centred.
    radii_mm
        Distances from the axis on the exit grid's plane.
    """
    surfaces = [_Surface(scene, number) for number in (0, 1)]
    field = _light_of_point(scene, surfaces[0]) * surfaces[0].transmission
    exit_z = np.full_like(radii_mm, scene.exit_grid.z_mm)
    targets = ((surfaces[1].r, surfaces[1].z), (radii_mm, exit_z))
    for number, (surface, (r, z)) in enumerate(zip(surfaces, targets, strict=True)):
        k = scene.wavenumber_per_mm * float(scene.system.index[0, number + 1])
        field = _radiated(surface, field, k, r, z, scene.object_grid.is_line)
        if number == 0:
            field = field * surfaces[1].transmission
    return field


class _Surface:
    """Nodes along a radius, up to the very rim: place, weight, slope and transmission."""

    def __init__(self, scene: Scene, number: int) -> None:
        semi_mm = float(scene.system.semi_diameter[number])
        self.r, self.weight = _nodes(0.0, semi_mm, PANEL_MM)
        zero = np.zeros_like(self.r)
        self.z = surface_map(scene.system, number, zero, self.r).z_mm
        self.slope = surface_slopes(scene.system, number, zero, self.r, self.z)[0]
        rays = crossings(scene, scene.object_grid.centre_mm)[number]
        self.transmission = transmission_at(scene, number, rays, zero, self.r)


def _nodes(start: float, stop: float, width: float) -> tuple[Array, Array]:
    x, weight = np.polynomial.legendre.leggauss(NODES)
    edges = np.linspace(start, stop, max(1, math.ceil((stop - start) / width)) + 1)
    half, middle = 0.5 * np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * weight).ravel()


def _light_of_point(scene: Scene, surface: _Surface) -> Array:
    """Rayleigh-Sommerfeld's field of a sample of 1."""
    along = surface.z - scene.object_grid.z_mm
    away, cell = np.hypot(surface.r, along), scene.object_grid.cell
    k = scene.wavenumber_per_mm * float(scene.system.index[0, 0])
    if scene.object_grid.is_line:
        return np.asarray(0.5j * cell * k * along / away * hankel1(1, k * away))
    wave = np.exp(1j * k * away) / away
    return np.asarray(cell / (2.0 * np.pi) * along / away * (1.0 / away - 1j * k) * wave)


def _radiated(surface: _Surface, field: Array, k: float, r: Array, z: Array, is_line: bool) -> Array:
    """Kirchhoff's integral of what a surface sends out, by its plane waves, at other radii and heights."""
    widest = 4.0 * math.pi / (k * (float(surface.r[-1]) + float(np.max(r))))
    angles, weights = _nodes(0.0, 0.5 * math.pi, widest)
    found, top = np.zeros(len(r), complex), float(np.max(surface.z))
    for part in np.array_split(np.arange(len(angles)), max(1, len(angles) // BLOCKS)):
        q, kz = k * np.sin(angles[part]), k * np.cos(angles[part])
        back = np.exp(-1j * np.outer(kz, surface.z - top))
        lean = 1j * (q / kz)[:, None] * surface.slope
        across, on = np.outer(q, surface.r), np.exp(1j * np.outer(z - top, kz))
        if is_line:
            sent = 2.0 * (np.cos(across) + lean * np.sin(across)) * back @ (field * surface.weight)
            found += np.cos(np.outer(r, q)) * on @ (sent * kz * weights[part]) / np.pi
        else:
            sent = (j0(across) + lean * j1(across)) * back @ (field * surface.weight * surface.r)
            found += j0(np.outer(r, q)) * on @ (sent * q * kz * weights[part])
    return found


if __name__ == "__main__":
    main()
