"""Scene of the whole system: glass, stop, object, sensor planes and rays.

The rendered view, the window, the page for browsers and the GLB file all show this scene.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.outline import drawn_outline
from lensdesign.common.arrays import Array
from lensdesign.lens.cover_glass import CoverGlass
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import closed_elements
from lensdesign.manufacture.mesh.mesh import lens_mesh
from lensdesign.manufacture.mesh.rings import circle
from lensdesign.raytrace.bundles import pupil_hexapolar
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS, ray_paths, sized_lens

if TYPE_CHECKING:
    import trimesh

Faces = NDArray[np.int64]

SHARP_DEG = 15.0
"""Angle between faces of a body in degrees above which their common edge is drawn."""

_NO_VERTICES, _NO_FACES = np.empty((0, 3)), np.empty((0, 3), np.int64)


@dataclass(frozen=True)
class ScenePart:
    """An object of the scene.

    Attributes
    ----------
    name
        Identifier, such as ``element_1_N-BK7`` or ``sensor_plane_2``.
    kind
        ``glass``, ``stop``, ``object``, ``plane`` or ``rays``.
    label
        Label for the reader.
    color, opacity
        Colour and opacity of the faces, and of lines whose kind has no edge colour.
    vertices, faces
        Triangles, in mm; empty for rays.
    lines
        Polylines in mm, shape (lines, points, 3): rays, or the edges of a body.
    glass
        Name of the material; empty for other kinds than glass.
    """

    name: str
    kind: str
    label: str
    color: str
    opacity: float
    vertices: Array
    faces: Faces
    lines: Array
    glass: str = ""

    @property
    def label_below(self) -> bool:
        """True if the label is placed below the object instead of above it."""
        return self.kind in ("glass", "object")


def scene_parts(lens: Lens, chord_error_um: float) -> list[ScenePart]:
    """Return glass, stop, object, sensor planes and rays of three fields, in this order.

    Parameters
    ----------
    lens
        A lens whose elements close. Surfaces without a semi-diameter have the size of their footprint. The
        glass has the outline of :func:`lensdesign.analysis.outline.drawn_outline`.
    chord_error_um
        Chord error of the glass in um; see :func:`lensdesign.manufacture.mesh.mesh.lens_mesh`.

    Raises
    ------
    InputError
        If an element does not close.
    """
    lens = sized_lens(lens)
    return [
        *_glass(drawn_outline(lens).lens, chord_error_um),
        _stop(lens),
        _object_disc(lens),
        *_planes(lens),
        *_rays(lens),
    ]


def _glass(lens: Lens, chord_error_um: float) -> Iterator[ScenePart]:
    for element in closed_elements(lens):
        glass, index = str(lens.surfaces[element.surfaces[0]].material), element.index + 1
        mesh = lens_mesh(lens, chord_error_um, element.index).mesh
        yield ScenePart(
            f"element_{index}_{glass}",
            "glass",
            f"element {index}: {glass}",
            "#A9D3EE",
            0.4,
            mesh.vertices,
            mesh.faces,
            _sharp_edges(mesh),
            glass,
        )


def _sharp_edges(mesh: trimesh.Trimesh) -> Array:
    sharp = mesh.face_adjacency_angles > math.radians(SHARP_DEG)
    return np.asarray(mesh.vertices[mesh.face_adjacency_edges[sharp]], float)


def _stop(lens: Lens) -> ScenePart:
    """Return a torus around the rim of the stop surface."""
    import trimesh

    semi = lens.stop_semi_diameter_mm
    z = float(lens.vertex_z_mm[lens.stop_index] + lens.surfaces[lens.stop_index].sag_mm(semi))
    # Wire radius of the ring that represents the stop, as a fraction of the stop's semi-diameter.
    stop_wire_fraction = 0.012
    wire = stop_wire_fraction * semi
    torus = trimesh.creation.torus(semi + wire, wire, major_sections=96, minor_sections=12)
    vertices = torus.vertices + np.array([0.0, 0.0, z])
    label = f"stop Ø {2.0 * semi:.4g} mm"
    return ScenePart("stop_ring", "stop", label, "#333333", 1.0, vertices, torus.faces, np.empty((0, 2, 3)))


def _object_disc(lens: Lens) -> ScenePart:
    count, radius, z = 96, lens.half_field_mm, lens.object_z_mm
    x, y = radius * circle(count)
    vertices = np.concatenate([[[0.0, 0.0, z]], np.stack([x, y, np.full(count, z)], axis=-1)])
    corners = 1 + np.arange(count)
    faces = np.stack([np.zeros_like(corners), corners, np.roll(corners, -1)], axis=-1)
    rim = vertices[[*corners.tolist(), 1]][None]
    label = f"object Ø {lens.object.field_diameter_mm:g} mm"
    return ScenePart("object_disc", "object", label, "#E6B800", 1.0, vertices, faces, rim)


def _planes(lens: Lens) -> Iterator[ScenePart]:
    half_x, half_y = (0.5 * side for side in lens.sensor.size_mm)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    pairs = zip(lens.sensor_z_mm, lens.sensor.plane_distances_mm, strict=True)
    for index, (z, distance) in enumerate(pairs, start=1):
        corners = [(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)]
        vertices = np.array([(x, y, z) for x, y in corners])
        border = vertices[[[0, 1, 2, 3, 0]]]
        label = f"H{index} = {distance:g} mm"
        name = f"sensor_plane_{index}"
        yield ScenePart(name, "plane", label, "#707070", 0.25, vertices, faces, border)
    if lens.sensor.cover_glass is not None:
        yield from _cover_glasses(lens, lens.sensor.cover_glass)


def _cover_glasses(lens: Lens, glass: CoverGlass) -> Iterator[ScenePart]:
    """Return the cover glass in front of each sensor plane, as a box of the sensor's size."""
    import trimesh

    label = f"cover glass: {glass.material}"
    for index, z in enumerate(lens.sensor_z_mm, start=1):
        box = trimesh.creation.box((*lens.sensor.size_mm, glass.thickness_mm))
        vertices = box.vertices + np.array([0.0, 0.0, z - glass.depth_mm + 0.5 * glass.thickness_mm])
        edges = vertices[box.face_adjacency_edges[box.face_adjacency_angles > 0.5]]
        name = f"cover_glass_{index}"
        yield ScenePart(name, "plane", label, "#A9D3EE", 0.4, vertices, box.faces, edges)


def _rays(lens: Lens) -> Iterator[ScenePart]:
    pupil = pupil_hexapolar(2).points
    for fraction, color in zip(FIELD_FRACTIONS, FIELD_COLORS, strict=True):
        height = fraction * lens.half_field_mm
        paths = ray_paths(lens, (0.0, height), pupil)
        name, label = f"rays_{height:g}_mm", f"field height {height:.3g} mm"
        yield ScenePart(name, "rays", label, color, 1.0, _NO_VERTICES, _NO_FACES, paths)
