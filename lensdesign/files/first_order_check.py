"""Whether an imported lens does to rays near the axis what the records of its file imply.

The lens is traced with exact rays close to the axis. The file's records, read a second time and without what
the reader made of them, give the same figures by the paraxial equations (Hecht, Optics, section 6.2):
refraction n' u' = n u - (n' - n) c y, transfer y' = y + d u. Where both differ, something was lost or
invented on the way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from lensdesign.errors import InputError
from lensdesign.files.draft import Draft, ImportedFirstOrder, Supplement
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose

TOLERANCE = 1e-6
"""Relative difference of first-order data that rounding may leave."""

MARGINAL_TOLERANCE = 1e-3
"""Relative difference between the marginal ray's height at the stop and the stop's semi-diameter."""

SMALLEST_POWER = 1e-3
"""Per mm; power is compared to `TOLERANCE` of this at least: terms in r^4 still bend rays near the axis."""

NEAR_AXIS = 1e-5
"""Height of the traced rays by the smallest radius; its square is the error of the comparison."""

NEARER_AXIS = 1e-7
"""The same for strong aspheres, whose terms in r^4 still count at `NEAR_AXIS`; rounding counts more here."""


@dataclass(frozen=True)
class _Train:
    """The surfaces from the first that refracts to the last, with the space on both sides."""

    before_mm: float
    curvatures: tuple[float, ...]
    distances_mm: tuple[float, ...]
    indices: tuple[float, ...]
    behind_mm: float
    stop_z_mm: float | None

    @property
    def refracts(self) -> bool:
        """Whether any two of the media differ."""
        return len(set(self.indices)) > 1

    def matrix(self) -> np.ndarray:
        """Ray matrix from the first to the last vertex, of (height, slope) in media of their own."""
        matrix = np.eye(2)
        for i, c in enumerate(self.curvatures):
            n, behind = self.indices[i], self.indices[i + 1]
            matrix = np.array([[1.0, 0.0], [-(behind - n) * c / behind, n / behind]]) @ matrix
            if i + 1 < len(self.curvatures):
                matrix = np.array([[1.0, self.distances_mm[i]], [0.0, 1.0]]) @ matrix
        return matrix

    def height_at_stop(self, y: float, u: float) -> float:
        """Height at the stop of a paraxial ray with height `y` and slope `u` at the first surface."""
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
    """Trace the imported lens and compare it with the file's records.

    Parameters
    ----------
    draft
        With the records and the system aperture of the file.
    lens, pose
        What was made of it.
    supplement
        What the user gave in place of the file's values, which is not compared.
    filled
        Whether the stop is as high as the marginal ray, and neither smaller nor the user's.

    Raises
    ------
    InputError
        If focal lengths, distances of object and image, magnification or the marginal ray differ.
    """
    _, system, first = _traced(lens, draft.source)
    if not draft.recorded:
        return first
    recorded = _recorded(draft, supplement.glass_catalogs)
    found = _lens_train(lens, system)
    refracts = _ends(system.indices) is not None  # if not, only the way from object to image counts
    differences: list[str] = []
    if refracts or recorded.refracts:
        for near in (NEAR_AXIS, NEARER_AXIS):
            matrix, _, first = _traced(lens, draft.source, near)
            differences = _matrix_differences(matrix, recorded)
            if not differences:
                break
    despace = float(np.asarray(pose.despace_mm)) if refracts else 0.0
    asked_distance = supplement.working_distance_mm is not None
    asked_planes = supplement.plane_distances_mm is not None
    if not (asked_distance or (asked_planes and not refracts)) and math.isfinite(recorded.before_mm):
        differences += _difference(
            "distance from the object (mm)", found.before_mm + despace, recorded.before_mm
        )
    if refracts and not asked_planes:
        differences += _difference(
            "distance to the image (mm)", found.behind_mm - despace, recorded.behind_mm
        )
    if supplement.numerical_aperture is None:
        differences += _aperture_difference(draft, lens, found, recorded)
    if filled:
        differences += _marginal_difference(lens, first)
    if differences:
        raise InputError(
            f"{draft.source}: the lens as imported does not do what the file's records imply: "
            + "; ".join(differences)
            + ". A record of the file is misread; no lens is given"
        )
    return first


def _difference(name: str, found: float, expected: float) -> list[str]:
    if abs(found - expected) <= TOLERANCE * max(1.0, abs(found), abs(expected)):
        return []
    return [f"{name} {found:.8g}, by the records {expected:.8g}"]


def _matrix_differences(found: np.ndarray, train: _Train) -> list[str]:
    """What differs between two ray matrices, as the figures that a designer knows."""
    expected = train.matrix()
    length = float(np.sum(np.abs(train.distances_mm)))
    power = sum(
        abs((behind - n) * c)
        for c, n, behind in zip(train.curvatures, train.indices, train.indices[1:], strict=False)
    )
    scale = np.array([[1.0 + length * power, length], [power, 1.0 + length * power]]) + np.abs(expected)
    with np.errstate(all="ignore"):
        same = np.abs(found - expected) <= TOLERANCE * (
            scale + np.array([[0.0, 1e-6], [SMALLEST_POWER, 0.0]])
        )
    if bool(np.all(same)):
        return []
    pairs = [(_efl(found), _efl(expected)), (_bfl(found), _bfl(expected))]
    names = ("focal length (mm)", "back focal length (mm)")
    said = [
        f"{name} {a:.8g}, by the records {b:.8g}" for name, (a, b) in zip(names, pairs, strict=True) if a != b
    ]
    return said or ["ray matrix"]


def _efl(matrix: np.ndarray) -> float:
    return float(-1.0 / matrix[1, 0]) if abs(matrix[1, 0]) > TOLERANCE * SMALLEST_POWER else math.inf


def _bfl(matrix: np.ndarray) -> float:
    return float(-matrix[0, 0] / matrix[1, 0]) if math.isfinite(_efl(matrix)) else math.inf


def _traced(
    lens: Lens, source: str, near: float = NEAR_AXIS
) -> tuple[np.ndarray, MeridionalSystem, ImportedFirstOrder]:
    """Ray matrix of the trimmed lens by exact rays near the axis, and its first-order data."""
    system = meridional_system(lens)
    front, back = _ends(system.indices) or (0, len(system.shapes) - 1)
    part = MeridionalSystem(
        system.shapes[front : back + 1],
        system.distances_mm[front:back],
        system.indices[front : back + 2],
    )
    matrix = _near_axis_matrix(part, near)
    if matrix is None:
        raise InputError(f"{source}: no ray near the axis passes through the lens as imported")
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


def meridional_system(lens: Lens, wavelength_um: float | None = None) -> MeridionalSystem:
    """The surfaces of a lens for exact rays in the meridional plane."""
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    return MeridionalSystem(
        tuple(s.shape for s in lens.surfaces),
        tuple(float(s.thickness_mm or 0.0) for s in lens.surfaces[:-1]),
        tuple(float(n) for n in lens.indices(wavelength_um)),
    )


def _near_axis_matrix(system: MeridionalSystem, near: float) -> np.ndarray | None:
    """Ray matrix by two exact rays, one parallel to the axis and one through the first vertex."""
    bent = [abs(1.0 / s.curvature) for s in system.shapes if s.curvature]
    radius = min([r for r in bent if math.isfinite(r)], default=1.0)
    length = sum(abs(d) for d in system.distances_mm)
    end = float(sum(system.distances_mm))
    height = near * radius / max(system.indices)
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


def _ends(indices: Sequence[float]) -> tuple[int, int] | None:
    """First and last surface between two different media; None where there is none."""
    bends = [before != behind for before, behind in pairwise(indices)]
    if not any(bends):
        return None
    return bends.index(True), len(bends) - 1 - bends[::-1].index(True)


def _lens_train(lens: Lens, system: MeridionalSystem) -> _Train:
    return _trimmed(
        lens.object.working_distance_mm,
        [s.curvature for s in lens.surfaces],
        [*system.distances_mm, lens.sensor.plane_distances_mm[0]],
        system.indices,
        lens.stop_index,
    )


def _recorded(draft: Draft, catalogs: Sequence[Path]) -> _Train:
    """The train of a file's records: the object first, the image last, breaks as planes in one medium."""
    wavelength_um = draft.wavelengths_um[0]
    front, *inner, _ = draft.recorded
    indices = [1.0] + [
        1.0 if s.material is None else refractive_index(s.material, wavelength_um, catalogs) for s in inner
    ]
    stop = next((i for i, s in enumerate(inner) if s.stop), None)
    return _trimmed(
        front.distance_mm,
        [s.curvature_per_mm for s in inner],
        [s.distance_mm for s in inner],
        indices,
        stop,
    )


def _trimmed(
    before_mm: float,
    curvatures: Sequence[float],
    distances_mm: Sequence[float],
    indices: Sequence[float],
    stop: int | None,
) -> _Train:
    ends = _ends(indices)
    if ends is None:  # nothing refracts: what counts is the way from object to image
        return _Train(before_mm + sum(distances_mm), (0.0,), (), (1.0, 1.0), 0.0, None)
    front, back = ends
    return _Train(
        before_mm + sum(distances_mm[:front]),
        tuple(curvatures[front : back + 1]),
        tuple(distances_mm[front:back]),
        tuple(indices[front : back + 2]),
        float(sum(distances_mm[back:])),
        None if stop is None else sum(distances_mm[front:stop]) - sum(distances_mm[stop:front]),
    )


def _aperture_difference(draft: Draft, lens: Lens, found: _Train, recorded: _Train) -> list[str]:
    """Where the design's numerical aperture is not the paraxial one that the file's aperture implies."""
    kind, value = draft.aperture or ("", 0.0)
    matrix = recorded.matrix()
    slope = abs(
        found.before_mm * matrix[1, 0] + matrix[1, 1]
    )  # behind the lens, for a slope of 1 at the object
    tangent = math.nan
    if kind == "object_na" and abs(value) < 1.0:
        tangent = math.tan(math.asin(value))
    elif kind == "working_f_number" and value and slope:
        tangent = 0.5 / (value * slope)
    elif kind == "image_na" and abs(value) < 1.0 and slope:
        tangent = value / math.sqrt(1.0 - value * value) / slope
    elif kind in ("pupil_diameter_mm", "image_f_number") and recorded.stop_z_mm is not None:
        from_object = recorded.height_at_stop(found.before_mm, 1.0)
        parallel = recorded.height_at_stop(1.0, 0.0)
        pupil = value if kind == "pupil_diameter_mm" else _over(1.0, value * abs(matrix[1, 0]))
        tangent = abs(_over(0.5 * pupil * parallel, from_object))
    if not math.isfinite(tangent):
        return []
    return _difference("numerical aperture", lens.object.numerical_aperture, math.sin(math.atan(tangent)))


def _over(value: float, by: float) -> float:
    return value / by if by else math.nan


def _marginal_difference(lens: Lens, first: ImportedFirstOrder) -> list[str]:
    """Where the exact marginal ray of the lens does not meet the rim of its stop."""
    semi = lens.stop_semi_diameter_mm
    if abs(first.stop_height_mm - semi) <= MARGINAL_TOLERANCE * semi * (1.0 + 1e-9):
        return []
    return [f"semi-diameter of the stop (mm) {semi:.6g}, its marginal ray is {first.stop_height_mm:.6g} high"]
