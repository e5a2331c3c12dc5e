"""The whole optical system as one GLB scene: glass, stop, object, sensor planes and rays, each a named node.

glTF counts in metres, so that all lengths are divided by 1000 from mm. Its y points up as that of the lens
does, and light runs along its z; the front vertex is at the origin.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.bundles import pupil_hexapolar
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens_solid import closed_elements
from lensdesign.mesh import lens_mesh
from lensdesign.mesh_files import glass_visuals, plain_visuals
from lensdesign.mesh_rings import circle
from lensdesign.ray_paths import FIELD_COLORS, FIELD_SHARES, ray_paths, sized_lens
from lensdesign.system import Lens

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

SCENE_CHORD_ERROR_MM = 1e-3
_TUBE_SIDES = 8
_TUBE_SHARE = 0.006
"""Radius of the tubes that stand for rays, as a share of the stop's semi-diameter."""

_RIM_SHARE = 0.012
"""Radius of the ring's wire that stands for the stop, likewise."""


def export_scene(lens: Lens, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write glass, stop ring, object disc, sensor planes and rays of three fields as a GLB scene in metres.

    Parameters
    ----------
    lens
        Any lens whose elements close; surfaces without a semi-diameter are as large as their footprint.
    path
        File to write, with the suffix .glb.

    Returns
    -------
    tuple of str
        Names of the nodes: ``element_1_N-BK7``, ..., ``stop_ring``, ``object_disc``, ``sensor_plane_1``, ...,
        ``rays_0_mm``, ... by field height. Sensor planes have the size of the sensor; rays end on the last.

    Raises
    ------
    InputError
        If the suffix is another, an element does not close, or the file cannot be written.
    """
    import trimesh

    if Path(path).suffix.lower() != ".glb":
        raise InputError(f"cannot write {path}: a scene is written as .glb alone")
    lens = sized_lens(lens)
    scene = trimesh.Scene()
    for name, mesh in _parts(lens):
        mesh.apply_scale(1e-3)
        scene.add_geometry(mesh, geom_name=name, node_name=name)
    data = bytes(scene.export(file_type="glb"))
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return tuple(scene.geometry)


def _parts(lens: Lens) -> Iterator[tuple[str, trimesh.Trimesh]]:
    """Name and mesh in mm of everything in the scene."""
    for element in closed_elements(lens):
        glass = str(lens.surfaces[element.surfaces[0]].material)
        mesh = lens_mesh(lens, SCENE_CHORD_ERROR_MM, element.number).mesh
        mesh.visual = glass_visuals(glass)
        yield f"element_{element.number + 1}_{glass}", mesh
    yield "stop_ring", _plain(*_stop_ring(lens), "#333333")
    yield "object_disc", _plain(*_disc(lens.half_field_mm, lens.object_z_mm), "#E6B800")
    for number, z in enumerate(lens.sensor_z_mm, start=1):
        yield f"sensor_plane_{number}", _plain(*_rectangle(lens.sensor.size_mm, z), "#707070", 0.35)
    pupil = pupil_hexapolar(2).points
    for share, color in zip(FIELD_SHARES, FIELD_COLORS, strict=True):
        height = share * lens.half_field_mm
        paths = ray_paths(lens, (0.0, height), pupil)
        yield f"rays_{height:g}_mm", _plain(*_tubes(paths, _TUBE_SHARE * lens.stop_semi_diameter_mm), color)


def _plain(vertices: Array, faces: Faces, color: str, opacity: float = 1.0) -> trimesh.Trimesh:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = plain_visuals(color, opacity)
    return mesh


def _stop_ring(lens: Lens) -> tuple[Array, Faces]:
    """A torus round the rim of the stop surface."""
    import trimesh

    semi = lens.stop_semi_diameter_mm
    z = lens.vertex_z_mm[lens.stop_index] + lens.surfaces[lens.stop_index].sag_mm(semi)
    wire = _RIM_SHARE * semi
    torus = trimesh.creation.torus(semi + wire, wire, major_sections=96, minor_sections=12)
    return torus.vertices + np.array([0.0, 0.0, float(z)]), torus.faces


def _disc(radius_mm: float, z_mm: float) -> tuple[Array, Faces]:
    count = 96
    x, y = radius_mm * circle(count)
    rim = np.stack([x, y, np.full(count, z_mm)], axis=-1)
    here = 1 + np.arange(count)
    faces = np.stack([np.zeros_like(here), here, np.roll(here, -1)], axis=-1)
    return np.concatenate([[[0.0, 0.0, z_mm]], rim]), faces


def _rectangle(size_mm: tuple[float, float], z_mm: float) -> tuple[Array, Faces]:
    half_x, half_y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    corners = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
    return np.array([(x, y, z_mm) for x, y in corners]), np.array([[0, 1, 2], [0, 2, 3]])


def _tubes(paths: Array, radius_mm: float) -> tuple[Array, Faces]:
    """Tubes about polylines, shape (rays, corners, 3), cut across z so that they end on their planes."""
    x, y = radius_mm * circle(_TUBE_SIDES)
    ring = np.stack([x, y, np.zeros(_TUBE_SIDES)], axis=-1)
    rays, corners, _ = paths.shape
    vertices = (paths[:, :, None] + ring).reshape(-1, 3)
    first = _TUBE_SIDES * np.arange(rays * corners).reshape(rays, corners)[:, :-1]
    # A failed ray's last corners coincide; nothing is drawn between these.
    first = first[np.any(np.diff(paths, axis=1) != 0.0, axis=-1)][:, None]
    here = np.arange(_TUBE_SIDES)
    after = (here + 1) % _TUBE_SIDES
    back = first + _TUBE_SIDES
    faces = np.stack(
        [first + here, first + after, back + after, first + here, back + after, back + here], axis=-1
    )
    return vertices, faces.reshape(-1, 3)
