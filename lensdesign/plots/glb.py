"""The whole optical system as a GLB scene with named nodes: glass, stop, object, sensor planes and rays.

glTF uses metres, so all lengths in mm are divided by 1000. Its y points up like that of the lens, and light
travels along its z; the front vertex is at the origin.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.mesh.rings import circle
from lensdesign.manufacture.mesh.writing import glass_visuals, plain_visuals
from lensdesign.plots.scene import ScenePart, scene_parts

if TYPE_CHECKING:
    import trimesh

Faces = NDArray[np.int64]


def write_scene(lens: Lens, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a lens with its object, sensor planes and rays as a 3D scene (GLB, in metres, as glTF requires).

    Parameters
    ----------
    lens
        A lens whose elements close. Surfaces without a semi-diameter have the size of their footprint.
    path
        File to write, with the suffix .glb.

    Returns
    -------
    tuple of str
        Names of the nodes: ``element_1_N-BK7``, ..., ``stop_ring``, ``object_disc``, ``sensor_plane_1``, ...,
        ``cover_glass_1``, ... for a sensor with a cover glass, and ``rays_0_mm``, ... for three field
        heights. Sensor planes have the size of the sensor. Rays end on the last plane.

    Raises
    ------
    InputError
        If the suffix is not .glb, an element does not close, or the file cannot be written.

    Examples
    --------
    >>> from lensdesign import load_design, write_scene
    >>> nodes = write_scene(load_design("designs/paper_singlet.toml"), "scene.glb")
    >>> nodes[:3]
    ('element_1_N-BK7', 'stop_ring', 'object_disc')
    """
    import trimesh

    if Path(path).suffix.lower() != ".glb":
        raise InputError(f"cannot write {path}: the name of a scene must end in .glb")
    scene = trimesh.Scene()
    chord_error_um = 1.0
    # Radius of the tubes that represent rays, as a fraction of the stop's semi-diameter.
    tube_fraction = 0.006
    for part in scene_parts(lens, chord_error_um):
        mesh = _mesh(part, tube_fraction * lens.stop_semi_diameter_mm)
        mesh.apply_scale(1e-3)
        scene.add_geometry(mesh, geom_name=part.name, node_name=part.name)
    data = bytes(scene.export(file_type="glb"))
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return tuple(scene.geometry)


def _mesh(scene_part: ScenePart, tube_mm: float) -> trimesh.Trimesh:
    import trimesh

    vertices, faces = (
        _tubes(scene_part.lines, tube_mm)
        if scene_part.kind == "rays"
        else (scene_part.vertices, scene_part.faces)
    )
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = (
        glass_visuals(scene_part.glass)
        if scene_part.glass
        else plain_visuals(scene_part.color, scene_part.opacity)
    )
    return mesh


def _tubes(paths: Array, radius_mm: float) -> tuple[Array, Faces]:
    """Return tubes around polylines, shape (rays, corners, 3), whose ends are perpendicular to z."""
    sides = 8
    x, y = radius_mm * circle(sides)
    ring = np.stack([x, y, np.zeros(sides)], axis=-1)
    rays, corners, _ = paths.shape
    vertices = (paths[:, :, None] + ring).reshape(-1, 3)
    first = sides * np.arange(rays * corners).reshape(rays, corners)[:, :-1]
    # The last corners of a failed ray coincide; nothing is drawn between them.
    first = first[np.any(np.diff(paths, axis=1) != 0.0, axis=-1)][:, None]
    here = np.arange(sides)
    after = (here + 1) % sides
    back = first + sides
    faces = np.stack(
        [first + here, first + after, back + after, first + here, back + after, back + here], axis=-1
    )
    return vertices, faces.reshape(-1, 3)
