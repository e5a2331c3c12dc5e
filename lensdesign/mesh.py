"""Triangle meshes of the glass, closed and of known error, for printing, viewing and CAD.

The exact body (:mod:`lensdesign.lens_solid`) becomes a polygon of revolution. Half of the chord error
allowed goes to the meridian, whose rings lie closer where it curves more, and half to the azimuth, so
that no facet lies farther from the glass than was asked.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, atomic_path
from lensdesign.lens_solid import Element, SurfaceMeridian, closed_elements, smallest_gap
from lensdesign.system import Lens

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

MOST_TRIANGLES = 20_000_000
FEWEST_AZIMUTHS = 12

MESH_SUFFIXES = (".stl", ".ply", ".obj", ".glb")
"""Formats that :func:`export_mesh` writes."""


@dataclass(frozen=True)
class LensMesh:
    """A closed mesh and how far it is from the glass.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        In mm, front vertex of the lens at the origin, +z towards the sensor; normals point outwards.
    chord_error_mm
        Greatest distance of the facets from the exact body, measured.
    volume_mm3
        Volume of the mesh.
    exact_volume_mm3
        Volume of the exact body, by quadrature.
    """

    mesh: trimesh.Trimesh
    chord_error_mm: float
    volume_mm3: float
    exact_volume_mm3: float

    @property
    def triangles(self) -> int:
        """Number of facets."""
        return len(self.mesh.faces)

    @property
    def volume_error(self) -> float:
        """Volume of the mesh over the exact one, less 1."""
        return self.volume_mm3 / self.exact_volume_mm3 - 1.0

    @property
    def volume_tolerance(self) -> float:
        """Bound of :attr:`volume_error`: chord error times the area of the mesh, over the exact volume."""
        return float(self.chord_error_mm * self.mesh.area / self.exact_volume_mm3)


def lens_mesh(lens: Lens, chord_error_mm: float = 1e-3, element: int = 0) -> LensMesh:
    """Mesh one element of a lens.

    Parameters
    ----------
    lens
        Any lens with a glass element.
    chord_error_mm
        Greatest distance allowed between a facet and the glass.
    element
        Which body of glass, from 0; those of a cemented group count singly.

    Returns
    -------
    LensMesh

    Raises
    ------
    InputError
        If the element does not exist or does not close, or the chord error is not above 0, asks for
        more than 20 million triangles, or is so coarse that facets of the two surfaces would cross.
    """
    elements = closed_elements(lens)
    if not 0 <= element < len(elements):
        raise InputError(f"element = {element}: there is no such element; allowed: 0 to {len(elements) - 1}")
    _refuse_size(elements, chord_error_mm)
    return _element_mesh(elements[element], chord_error_mm)


def export_mesh(
    lens: Lens,
    path: str | os.PathLike[str],
    chord_error_mm: float = 1e-3,
    report: Callable[[str], None] = warnings.warn,
) -> LensMesh:
    """Write the glass of a lens as a mesh file, every surface in its nominal shape.

    Parameters
    ----------
    lens
        Any lens with a glass element.
    path
        File to write; its suffix names the format: .stl (binary), .ply, .obj in mm, or .glb in metres, as
        glTF demands. Several elements go into one file: as one body each in .glb, side by side elsewhere.
    chord_error_mm
        Greatest distance allowed between a facet and the glass.
    report
        Told in one sentence of each surface whose measured figure is left out.

    Returns
    -------
    LensMesh
        Of all elements together, in mm.

    Raises
    ------
    InputError
        As :func:`lens_mesh`, before anything is written; also if the suffix is unknown or the file cannot
        be written.
    """
    import trimesh

    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"cannot write {path}: unknown suffix {suffix!r}; allowed: {', '.join(MESH_SUFFIXES)}"
        )
    elements = closed_elements(lens)
    _refuse_size(elements, chord_error_mm)
    parts = [_element_mesh(e, chord_error_mm) for e in elements]
    whole = parts[0].mesh if len(parts) == 1 else trimesh.util.concatenate([p.mesh for p in parts])
    data = _encode(suffix, [p.mesh for p in parts], whole)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    for number, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            report(f"surface {number}: nominal shape written, its measured figure left out")
    return LensMesh(
        whole,
        max(p.chord_error_mm for p in parts),
        sum(p.volume_mm3 for p in parts),
        sum(p.exact_volume_mm3 for p in parts),
    )


def _encode(suffix: str, meshes: list[trimesh.Trimesh], whole: trimesh.Trimesh) -> bytes:
    import trimesh

    if suffix == ".glb":
        scene = trimesh.Scene()
        for number, mesh in enumerate(meshes, start=1):
            scaled = trimesh.Trimesh(1e-3 * mesh.vertices, mesh.faces, process=False)
            scene.add_geometry(scaled, geom_name=f"element_{number}", node_name=f"element_{number}")
        return bytes(scene.export(file_type="glb"))
    data = whole.export(file_type=suffix[1:], **({"digits": 12} if suffix == ".obj" else {}))
    return data.encode() if isinstance(data, str) else bytes(data)


def _element_mesh(element: Element, chord_error_mm: float) -> LensMesh:
    import trimesh

    count = _azimuths(element, chord_error_mm)
    rings = [_ring_parameters(m, 0.5 * chord_error_mm) for m in (element.front, element.back)]
    front, back = element.profiles(*rings)
    r, gap = smallest_gap(front, back)
    if gap <= 0.0:
        raise InputError(
            f"{_chord_error(chord_error_mm)} is too coarse for {element.name}: facets of its surfaces would "
            f"cross at a radial height of {r:.6g} mm; ask for less"
        )
    vertices, faces = _revolve(np.concatenate([front, back[::-1]]), count)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.units = "mm"
    return LensMesh(
        mesh, _measured_error(element, front, back, count), float(mesh.volume), element.volume_mm3
    )


def _refuse_size(elements: list[Element], chord_error_mm: float) -> None:
    if not (math.isfinite(chord_error_mm) and chord_error_mm > 0.0):
        raise InputError(f"{_chord_error(chord_error_mm)}: must be above 0")
    triangles = 0.0
    for element in elements:
        rings = sum(_ring_density(m)[1][-1] for m in (element.front, element.back))
        rings = rings / math.sqrt(0.5 * chord_error_mm) + 2.0
        triangles += 2.0 * rings * _azimuths(element, chord_error_mm)
    if triangles > MOST_TRIANGLES:
        raise InputError(
            f"{_chord_error(chord_error_mm)} would need {triangles:.3g} triangles; allowed: at most "
            f"{MOST_TRIANGLES:.3g}, so ask for a larger chord error"
        )


def _chord_error(chord_error_mm: float) -> str:
    """The chord error as messages give it; the command takes it in um."""
    return f"chord_error_mm = {chord_error_mm:g} ({1e3 * chord_error_mm:g} um)"


def _azimuths(element: Element, chord_error_mm: float) -> int:
    """Number of meridians, a multiple of 4, from r (1 - cos(pi / n)) = 2 r sin^2(pi / 2n) at the edge."""
    sine = math.sqrt(min(1.0, 0.25 * chord_error_mm / element.edge_mm))
    return max(FEWEST_AZIMUTHS, 4 * math.ceil(0.125 * math.pi / math.asin(sine)))


def _chord_errors(meridian: SurfaceMeridian, t: Array) -> Array:
    """Greatest distance of the meridian from each of its chords between successive parameters."""
    ends = meridian.points(t)
    chord = np.diff(ends, axis=0)
    share = np.linspace(0.0, 1.0, 17)[1:-1]
    inner = meridian.points(t[:-1, None] + share * np.diff(t)[:, None]) - ends[:-1, None]
    across = inner[..., 0] * chord[:, None, 1] - inner[..., 1] * chord[:, None, 0]
    return np.asarray(np.max(np.abs(across), axis=1) / np.linalg.norm(chord, axis=1))


def _ring_density(meridian: SurfaceMeridian) -> tuple[Array, Array]:
    """Parameters t, and up to each the sum of sqrt(chord error), which counts rings.

    Chord errors go with the square of the spacing, so the square root adds up over intervals: this sum
    over the square root of the error allowed is the number of rings.
    """
    t = np.linspace(0.0, 1.0, 65)
    for _ in range(24):
        errors = _chord_errors(meridian, t)
        coarse = errors > 1e-5 * meridian.end_mm
        if not np.any(coarse):
            break
        t = np.sort(np.concatenate([t, (0.5 * (t[:-1] + t[1:]))[coarse]]))
    errors = _chord_errors(meridian, t)
    # An interval with an inflection looks straight; its neighbours do not.
    weights = np.sqrt(np.maximum(errors, 1e-3 * np.mean(errors)))
    return t, np.concatenate([[0.0], np.cumsum(weights)])


def _ring_parameters(meridian: SurfaceMeridian, error_mm: float) -> Array:
    """Parameters of the rings: as few as keep every chord within the error allowed."""
    t, density = _ring_density(meridian)
    if density[-1] <= 1e-7 * math.sqrt(meridian.end_mm):
        return np.array([0.0, 1.0])
    count = max(1, math.ceil(density[-1] / math.sqrt(error_mm)))
    while True:
        rings = np.interp(np.linspace(0.0, density[-1], count + 1), density, t)
        if np.max(_chord_errors(meridian, rings)) <= error_mm:
            return rings
        count += 1 + count // 30


def _revolve(profile: Array, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Vertices and triangles of an open polygon (r, z), both ends on the axis, turned about z."""
    angle = 2.0 * math.pi * np.arange(count) / count
    r, z = profile[1:-1, 0], profile[1:-1, 1]
    rings = np.stack(
        [np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle)), np.repeat(z[:, None], count, axis=1)],
        axis=-1,
    )
    poles = np.array([[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]])
    vertices = np.concatenate([poles, rings.reshape(-1, 3)])
    here = np.arange(count)
    after = (here + 1) % count
    start = 2 + count * np.arange(len(r))
    inner, outer = start[:-1, None], start[1:, None]
    quads = np.stack(
        [inner + here, outer + after, outer + here, inner + here, inner + after, outer + after], axis=-1
    )
    first = np.stack([np.zeros_like(here), start[0] + after, start[0] + here], axis=-1)
    last = np.stack([np.ones_like(here), start[-1] + here, start[-1] + after], axis=-1)
    return vertices, np.concatenate([first, quads.reshape(-1, 3), last])


def _measured_error(element: Element, front: Array, back: Array, count: int) -> float:
    """Greatest distance of facets from the glass, at 231 points of every facet of one sector.

    All sectors are alike. The flat annulus counts as far as its polygonal inner rim stands off the round
    one.
    """
    greatest = element.edge_mm * (1.0 - math.cos(math.pi / count))
    for meridian, profile in ((element.front, front), (element.back, back)):
        rings = len(profile) if meridian.end_mm >= element.edge_mm else len(profile) - 1
        points = _sector_points(profile[:rings], count)
        radial = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]], axis=-1)
        greatest = max(greatest, float(np.max(meridian.distances(radial))))
    return greatest


def _sector_points(profile: Array, count: int, parts: int = 20) -> Array:
    """Points all over the facets of one sector of a surface, shape (n, 3)."""
    angle = 2.0 * math.pi / count
    one = np.stack([profile[:, 0], np.zeros(len(profile)), profile[:, 1]], axis=-1)
    other = np.stack(
        [profile[:, 0] * math.cos(angle), profile[:, 0] * math.sin(angle), profile[:, 1]], axis=-1
    )
    corners = np.concatenate(
        [
            np.stack([one[:-1], one[1:], other[1:]], axis=1),
            np.stack([one[:-1], other[:-1], other[1:]], axis=1),
        ]
    )
    i, j = np.meshgrid(np.arange(parts + 1), np.arange(parts + 1))
    share = np.stack([i, j, parts - i - j], axis=-1)[i + j <= parts] / parts
    return (share @ corners).reshape(-1, 3)
