"""Check of an imported lens: its first-order data must agree with those of the file's records.

The imported lens is traced with exact rays close to the axis. The file's records, read a second time and
without interpretation, give the same quantities by the paraxial equations (Hecht, Optics, section 6.2):
refraction n' u' = n u - (n' - n) c y, and transfer y' = y + d u. A difference reveals an error of the import.

Where the file also states indices (the GLAS columns of OpticStudio, a model glass), the focal length by these
indices is compared too (:func:`compare_recorded_indices`). It does not depend on the glasses that were found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from lensdesign.errors import InputError
from lensdesign.files.draft import Draft, ImportedFirstOrder, RecordedSurface, Supplement
from lensdesign.files.index_records import INDEX_REFUSED
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.lens.glass import get_material, refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose

TOLERANCE = 1e-6
"""Allowed relative difference of first-order data."""

MARGINAL_TOLERANCE = 1e-3
"""Allowed relative difference between the marginal ray's height at the stop and the stop's semi-diameter."""

FOCAL_LENGTH_NOTED, FOCAL_LENGTH_REFUSED = 1e-4, 1e-2
"""Relative differences between the focal lengths of the imported lens and by the file's index records from
which an import has a note and from which it needs --lossy."""

SMALLEST_POWER = 1e-3
"""Power in 1/mm below which the comparison is absolute; terms in r^4 still bend rays near the axis."""

# Ratio of the height of the traced rays to the smallest radius. Its square is the error of the comparison.
# Strong aspheres, whose terms in r^4 matter at the first value, are traced again with the second one, where
# rounding errors are larger.
_RELATIVE_HEIGHTS = (1e-5, 1e-7)


@dataclass(frozen=True)
class _SurfaceTrain:
    """The surfaces from the first to the last that refract, with the distances to object and image."""

    object_distance_mm: float
    curvatures: tuple[float, ...]
    distances_mm: tuple[float, ...]
    indices: tuple[float, ...]
    image_distance_mm: float
    stop_z_mm: float | None

    @property
    def refracts(self) -> bool:
        """True if the lens has more than one medium."""
        return len(set(self.indices)) > 1

    @property
    def power_of_surfaces(self) -> float:
        """Sum of the magnitudes of the powers of all surfaces in 1/mm."""
        steps = zip(self.curvatures, pairwise(self.indices), strict=True)
        return sum(abs((behind - n) * c) for c, (n, behind) in steps)

    def matrix(self) -> np.ndarray:
        """Return the ray matrix of (height, slope) from the first to the last vertex."""
        matrix = np.eye(2)
        for i, c in enumerate(self.curvatures):
            n, behind = self.indices[i], self.indices[i + 1]
            matrix = np.array([[1.0, 0.0], [-(behind - n) * c / behind, n / behind]]) @ matrix
            if i + 1 < len(self.curvatures):
                matrix = np.array([[1.0, self.distances_mm[i]], [0.0, 1.0]]) @ matrix
        return matrix

    def height_at_stop(self, y: float, u: float) -> float:
        """Return the height at the stop of a ray with height `y` and slope `u` at the first surface."""
        assert self.stop_z_mm is not None
        z = 0.0
        for i, c in enumerate(self.curvatures):
            if self.stop_z_mm < z or (self.stop_z_mm == z and i > 0):
                break
            if self.stop_z_mm == z:
                return y
            n, behind = self.indices[i], self.indices[i + 1]
            u = (n * u - (behind - n) * c * y) / behind
            if i + 1 < len(self.curvatures) and self.stop_z_mm >= z + self.distances_mm[i]:
                z += self.distances_mm[i]
                y += self.distances_mm[i] * u
            else:
                break
        return y + (self.stop_z_mm - z) * u


def check_first_order(
    draft: Draft, lens: Lens, pose: Pose, supplement: Supplement, filled: bool
) -> ImportedFirstOrder:
    """Trace the imported lens and compare its first-order data with those of the file's records.

    Parameters
    ----------
    draft
        Contents of the file: its records and its system aperture.
    lens, pose
        The imported lens and its pose.
    supplement
        Values that the user gave in place of the file's; these are not compared.
    filled
        Whether the semi-diameter of the stop should equal the height of the marginal ray.

    Raises
    ------
    InputError
        If focal lengths, the distance of the object or image, the aperture or the marginal ray differ.
    """
    _, system, first = _traced(lens, draft.source)
    if not draft.recorded:
        return first
    recorded = _recorded(draft, supplement.glass_catalogs)
    found = _lens_train(lens, system)
    refracts = _refracting_ends(system.indices) is not None  # if not, only the total distance is compared
    differences: list[str] = []
    if refracts or recorded.refracts:
        for relative_height in _RELATIVE_HEIGHTS:
            matrix, _, first = _traced(lens, draft.source, relative_height)
            differences = _matrix_differences(matrix, recorded)
            if not differences:
                break
    despace = float(np.asarray(pose.despace_mm)) if refracts else 0.0
    requested_distance = supplement.working_distance_mm is not None
    requested_planes = supplement.plane_distances_mm is not None
    if not (requested_distance or (requested_planes and not refracts)) and math.isfinite(
        recorded.object_distance_mm
    ):
        differences += _difference(
            "distance from the object (mm)", found.object_distance_mm + despace, recorded.object_distance_mm
        )
    if refracts and not requested_planes:
        differences += _difference(
            "distance to the image (mm)", found.image_distance_mm - despace, recorded.image_distance_mm
        )
    if supplement.numerical_aperture is None:
        differences += _aperture_difference(draft, lens, found, recorded)
    if filled:
        differences += _marginal_difference(lens, first)
    if differences:
        raise InputError(
            f"{draft.source}: the imported lens disagrees with the file's records: "
            + "; ".join(differences)
            + ". A record of the file was misread, so the import is rejected"
        )
    return first


def compare_recorded_indices(draft: Draft, first: ImportedFirstOrder, catalogs: Sequence[Path]) -> str:
    """Compare the focal length of the imported lens with that by the file's own index records.

    A difference of more than `FOCAL_LENGTH_NOTED` adds a remark to the draft. Glasses of catalogues that the
    user gave never cause a loss.

    Parameters
    ----------
    draft
        Contents of the file; the surfaces with an index record count.
    first
        First-order data of the traced lens.
    catalogs
        The user's own catalogue files.

    Returns
    -------
    str
        A loss, if the difference exceeds `FOCAL_LENGTH_REFUSED`; else empty.

    Raises
    ------
    InputError
        If the constant index of a medium is not what the file states.
    """
    if not any(surface.index for surface in draft.recorded):
        return ""
    inner = draft.recorded[1:-1]
    known = [_recorded_index(draft, surface, catalogs) for surface in inner]
    train = _recorded(draft, catalogs, known)
    matrix = train.matrix()
    power = 0.0 if math.isinf(first.efl_mm) else 1.0 / first.efl_mm
    expected = float(-matrix[1, 0])
    scale = max(abs(power), abs(expected))
    if abs(power - expected) <= max(FOCAL_LENGTH_NOTED * scale, TOLERANCE * SMALLEST_POWER):
        return ""
    change = f" (difference {100.0 * (expected / power - 1.0):+.3g} %)" if power else ""
    text = (
        f"focal length {first.efl_mm:.6g} mm at {draft.wavelengths_um[0]:g} µm, by the index records of the "
        f"file {_efl(matrix):.6g} mm{change}"
    )
    smallest_scale = 0.1 * train.power_of_surfaces  # of a nearly afocal lens
    own = {path.name for path in catalogs}
    is_own = any(
        isinstance(s.material, str) and get_material(s.material, catalogs).catalog in own for s in inner
    )
    if abs(power - expected) > FOCAL_LENGTH_REFUSED * max(scale, smallest_scale) and not is_own:
        return text
    draft.add_remark(text)
    return ""


def _recorded_index(draft: Draft, surface: RecordedSurface, catalogs: Sequence[Path]) -> float | None:
    """Return the index behind a surface by the file's index record; None if it has none that can be used."""
    if surface.index is None or surface.material is None:
        return None
    if not isinstance(surface.material, str):
        if abs(surface.material - surface.index.nd) > INDEX_REFUSED:
            raise InputError(
                f"{draft.source}: an index of {surface.material:g} was read where the file states "
                f"{surface.index.nd:g}. A record of the file was misread, so the import is rejected"
            )
        return surface.index.nd
    return surface.index.index(surface.material, draft.wavelengths_um[0], catalogs)


def _difference(name: str, found: float, expected: float) -> list[str]:
    if abs(found - expected) <= TOLERANCE * max(1.0, abs(found), abs(expected)):
        return []
    return [f"{name} {found:.8g}, by the records {expected:.8g}"]


def _matrix_differences(found: np.ndarray, train: _SurfaceTrain) -> list[str]:
    """Return the differences between two ray matrices in terms of focal lengths."""
    expected = train.matrix()
    length = float(np.sum(np.abs(train.distances_mm)))
    power = train.power_of_surfaces
    scale = np.array([[1.0 + length * power, length], [power, 1.0 + length * power]]) + np.abs(expected)
    with np.errstate(all="ignore"):
        same = np.abs(found - expected) <= TOLERANCE * (
            scale + np.array([[0.0, 1e-6], [SMALLEST_POWER, 0.0]])
        )
    if bool(np.all(same)):
        return []
    pairs = [(_efl(found), _efl(expected)), (_bfl(found), _bfl(expected))]
    names = ("focal length (mm)", "back focal length (mm)")
    differences = [
        f"{name} {a:.8g}, by the records {b:.8g}" for name, (a, b) in zip(names, pairs, strict=True) if a != b
    ]
    return differences or ["ray matrix"]


def _efl(matrix: np.ndarray) -> float:
    return float(-1.0 / matrix[1, 0]) if abs(matrix[1, 0]) > TOLERANCE * SMALLEST_POWER else math.inf


def _bfl(matrix: np.ndarray) -> float:
    return float(-matrix[0, 0] / matrix[1, 0]) if math.isfinite(_efl(matrix)) else math.inf


def _traced(
    lens: Lens, source: str, relative_height: float = _RELATIVE_HEIGHTS[0]
) -> tuple[np.ndarray, MeridionalSystem, ImportedFirstOrder]:
    """Return the ray matrix by exact rays near the axis, the surfaces, and the first-order data."""
    system = meridional_system(lens)
    front, back = _refracting_ends(system.indices) or (0, len(system.shapes) - 1)
    refracting = MeridionalSystem(
        system.shapes[front : back + 1],
        system.distances_mm[front:back],
        system.indices[front : back + 2],
    )
    matrix = _near_axis_matrix(refracting, relative_height)
    if matrix is None:
        raise InputError(f"{source}: no ray near the axis passes through the imported lens")
    behind = sum(system.distances_mm[back:])
    before = lens.object.working_distance_mm + sum(system.distances_mm[:front])
    (a, b), (c, d) = matrix.tolist()
    denominator = c * before + d
    image = -(a * before + b) / denominator - behind if denominator else math.inf
    na = lens.object.numerical_aperture
    height = system.height_at_stop(lens.object.working_distance_mm, na, lens.stop_index)
    return (
        matrix,
        system,
        ImportedFirstOrder(
            efl_mm=_efl(matrix),
            bfl_mm=_bfl(matrix) - behind,
            magnification=1.0 / (system.indices[-1] * denominator) if denominator else math.inf,
            image_distance_mm=image,
            object_na=na,
            stop_height_mm=math.nan if height is None else height,
        ),
    )


def meridional_system(lens: Lens) -> MeridionalSystem:
    """Return the surfaces of a lens for exact rays in the meridional plane, at its first wavelength."""
    return MeridionalSystem(
        tuple(s.shape for s in lens.surfaces),
        tuple(float(s.thickness_mm or 0.0) for s in lens.surfaces[:-1]),
        tuple(float(n) for n in lens.indices(lens.wavelengths_um[0])),
    )


def _near_axis_matrix(system: MeridionalSystem, relative_height: float) -> np.ndarray | None:
    """Return the ray matrix by two exact rays: one parallel to the axis, one through the first vertex."""
    bent = [abs(1.0 / s.curvature) for s in system.shapes if s.curvature]
    radius = min([r for r in bent if math.isfinite(r)], default=1.0)
    length = sum(abs(d) for d in system.distances_mm)
    end = float(sum(system.distances_mm))
    height = relative_height * radius / max(system.indices)
    sine = height / (radius + length)
    parallel = system.trace(height, -radius, 0.0)
    through = system.trace(-sine / math.sqrt(1.0 - sine * sine) * radius, -radius, sine)
    if parallel is None or through is None:
        return None
    tangent = sine / math.sqrt(1.0 - sine * sine)
    return np.array(
        [
            [parallel.height_at(end) / height, through.height_at(end) / tangent],
            [parallel.slope / height, through.slope / tangent],
        ]
    )


def _refracting_ends(indices: Sequence[float]) -> tuple[int, int] | None:
    """Return the indices of the first and the last surface that refract; None if no surface does."""
    bends = [before != behind for before, behind in pairwise(indices)]
    if not any(bends):
        return None
    return bends.index(True), len(bends) - 1 - bends[::-1].index(True)


def _lens_train(lens: Lens, system: MeridionalSystem) -> _SurfaceTrain:
    return _trim(
        lens.object.working_distance_mm,
        [s.curvature for s in lens.surfaces],
        [*system.distances_mm, lens.sensor.plane_distances_mm[0]],
        system.indices,
        lens.stop_index,
    )


def _recorded(
    draft: Draft, catalogs: Sequence[Path], stated: Sequence[float | None] | None = None
) -> _SurfaceTrain:
    """Return the surfaces of a file's records; coordinate breaks count as planes within one medium.

    Indices that the file states replace those of the glasses.
    """
    wavelength_um = draft.wavelengths_um[0]
    front, *inner, _ = draft.recorded
    indices = [1.0]
    for surface, index in zip(inner, stated or [None] * len(inner), strict=True):
        if index is None and surface.material is not None:
            index = refractive_index(surface.material, wavelength_um, catalogs)
        indices.append(1.0 if index is None else index)
    stop = next((i for i, s in enumerate(inner) if s.stop), None)
    return _trim(
        front.distance_mm,
        [s.curvature_per_mm for s in inner],
        [s.distance_mm for s in inner],
        indices,
        stop,
    )


def _trim(
    object_distance_mm: float,
    curvatures: Sequence[float],
    distances_mm: Sequence[float],
    indices: Sequence[float],
    stop: int | None,
) -> _SurfaceTrain:
    ends = _refracting_ends(indices)
    if ends is None:  # no surface refracts: only the distance from object to image matters
        return _SurfaceTrain(object_distance_mm + sum(distances_mm), (0.0,), (), (1.0, 1.0), 0.0, None)
    front, back = ends
    return _SurfaceTrain(
        object_distance_mm + sum(distances_mm[:front]),
        tuple(curvatures[front : back + 1]),
        tuple(distances_mm[front:back]),
        tuple(indices[front : back + 2]),
        float(sum(distances_mm[back:])),
        None if stop is None else sum(distances_mm[front:stop]) - sum(distances_mm[stop:front]),
    )


def _aperture_difference(
    draft: Draft, lens: Lens, found: _SurfaceTrain, recorded: _SurfaceTrain
) -> list[str]:
    """Return the difference between the design's numerical aperture and the file's, by paraxial rays."""
    kind, value = draft.aperture or ("", 0.0)
    matrix = recorded.matrix()
    slope = abs(
        found.object_distance_mm * matrix[1, 0] + matrix[1, 1]
    )  # behind the lens, for a slope of 1 at the object
    tangent = math.nan
    if kind == "object_na" and abs(value) < 1.0:
        tangent = math.tan(math.asin(value))
    elif kind == "working_f_number" and value and slope:
        tangent = 0.5 / (value * slope)
    elif kind == "image_na" and abs(value) < 1.0 and slope:
        tangent = value / math.sqrt(1.0 - value * value) / slope
    elif kind in ("pupil_diameter_mm", "image_f_number") and recorded.stop_z_mm is not None:
        from_object = recorded.height_at_stop(found.object_distance_mm, 1.0)
        parallel = recorded.height_at_stop(1.0, 0.0)
        pupil = value if kind == "pupil_diameter_mm" else _ratio(1.0, value * abs(matrix[1, 0]))
        tangent = abs(_ratio(0.5 * pupil * parallel, from_object))
    if not math.isfinite(tangent):
        return []
    return _difference("numerical aperture", lens.object.numerical_aperture, math.sin(math.atan(tangent)))


def _ratio(value: float, by: float) -> float:
    return value / by if by else math.nan


def _marginal_difference(lens: Lens, first: ImportedFirstOrder) -> list[str]:
    """Return the difference between the exact marginal ray's height and the stop's semi-diameter."""
    semi = lens.stop_semi_diameter_mm
    if abs(first.stop_height_mm - semi) <= MARGINAL_TOLERANCE * semi * (1.0 + 1e-9):
        return []
    return [f"semi-diameter of the stop (mm) {semi:.6g}, its marginal ray is {first.stop_height_mm:.6g} high"]
