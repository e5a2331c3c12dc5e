"""From the rows of another program's file to a lens and its pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.toml_files import validate
from lensdesign.errors import InputError, MaterialError
from lensdesign.files.draft import (
    MOST_SURFACES,
    TOLERANCE_MM,
    Break,
    Draft,
    Imported,
    LossyImportError,
    Row,
    Supplement,
    shown,
)
from lensdesign.files.first_order_check import MARGINAL_TOLERANCE, check_first_order
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.surface import Surface


def assemble(draft: Draft, supplement: Supplement, lossy: bool) -> Imported:
    """Make a lens of what was read.

    Raises
    ------
    LossyImportError
        If something would be lost and `lossy` is not set.
    InputError
        If values are missing, or it is no lens.
    """
    source = draft.source
    if len(draft.rows) < 3:
        raise InputError(
            f"{source}: {len(draft.rows)} surfaces found; there must be an object, a surface and an image"
        )
    if not draft.wavelengths_um:
        raise InputError(f"{source}: no wavelength found")
    own = draft.notes.get("materials")
    real = sum(row.axes is None for row in draft.rows) - 2
    rows = draft.rows if isinstance(own, list) and len(own) == real else folded(draft.rows)
    if len(rows) < 3:
        raise InputError(f"{source}: nothing but planes in air between the object and the image")
    rows, pose, working_distance, first_plane = _placed(rows, draft)
    planes = _first(supplement.plane_distances_mm, _planes(draft, first_plane))
    noted = draft.notes.get("glass_catalogs")
    if noted and not supplement.glass_catalogs:
        draft.lose(
            f"glass catalogues {shown(str(noted))}: files that a lens file names are not opened; "
            "give them along"
        )
    if draft.dropped and not lossy:
        raise LossyImportError(source, draft.dropped)
    catalogs = supplement.glass_catalogs
    distance = _first(
        supplement.working_distance_mm, working_distance if working_distance < math.inf else None
    )
    values = {
        "working_distance_mm": distance,
        "field_diameter_mm": _first(
            supplement.field_diameter_mm, 2.0 * draft.half_field_mm if draft.half_field_mm else None
        ),
        "numerical_aperture": _first(
            supplement.numerical_aperture,
            _numerical_aperture(draft, rows, distance, catalogs) if draft.aperture and distance else None,
        ),
        "pixel_pitch_um": _first(supplement.pixel_pitch_um, draft.notes.get("pixel_pitch_um")),
        "pixels": _first(supplement.pixels, draft.notes.get("pixels")),
        "plane_distances_mm": planes,
    }
    asked = supplement.numerical_aperture is not None
    rows, filled = _with_stop(rows, draft, values, catalogs, asked)
    surfaces = _surfaces(rows)
    missing = [name for name, value in values.items() if value is None]
    if missing:
        raise InputError(
            f"{source}: the file does not tell {', '.join(missing)}; give it along with the file"
        )
    _remark_automatic(rows, draft)
    lens = _lens(draft, values, surfaces, catalogs)
    first_order = check_first_order(draft, lens, pose, supplement, filled)
    return Imported(lens, pose, tuple(draft.dropped), tuple(draft.remarks), first_order)


def _first(*values: Any) -> Any:
    """The first value that is one."""
    return next((value for value in values if value is not None), None)


def _lens(
    draft: Draft, values: dict[str, Any], surfaces: list[dict[str, Any]], catalogs: Sequence[Path]
) -> Lens:
    """The lens, validated as a design file would be."""
    data = {
        "title": draft.title,
        "wavelengths_um": draft.wavelengths_um,
        "glass_catalogs": list(catalogs),
        "object": {k: values[k] for k in ("working_distance_mm", "field_diameter_mm", "numerical_aperture")},
        "sensor": {k: values[k] for k in ("pixel_pitch_um", "pixels", "plane_distances_mm")},
        "surface": surfaces,
        "edge": draft.notes.get("edges", []),
    }
    lens = validate(Lens, data, draft.source)
    try:
        for wavelength in lens.wavelengths_um:
            lens.indices(wavelength)
    except MaterialError as error:
        raise MaterialError(f"{draft.source}: {error}") from error
    return lens


def folded(rows: Sequence[Row]) -> list[Row]:
    """Rows without the dummy planes in air: those that clip nothing, or have no space on one side."""
    result, medium = [rows[0]], rows[0].material
    for row in rows[1:-1]:
        before = result[-1]
        plane = row.radius_mm is None and not any(row.shape.values()) and row.axes is None and not row.stop
        in_air = row.material is None and medium is None
        idle = (
            row.semi_diameter_mm is None
            or row.thickness_mm <= 0.0
            or (before.thickness_mm <= 0.0 and len(result) > 1)
        )
        if plane and in_air and idle:
            result[-1] = replace(before, thickness_mm=before.thickness_mm + row.thickness_mm)
        else:
            result.append(row)
            medium = medium if row.axes is not None else row.material
    return [*result, rows[-1]]


def _placed(rows: list[Row], draft: Draft) -> tuple[list[Row], Pose, float, float]:
    """Rows without the breaks, the pose for which those stand, the working distance, and the first plane.

    That is a break before the first surface, whose inverse stands at the same point behind the last.
    """
    if all(row.axes is None for row in rows):
        return rows, Pose(), rows[0].thickness_mm, rows[-2].thickness_mm
    front, back, inner = rows[1], rows[-2], rows[2:-2]
    exit_z = sum(row.thickness_mm for row in inner[:-1])
    if (
        inner
        and front.axes is not None
        and back.axes is not None
        and all(row.axes is None for row in inner)
        and back.axes.undoes(front.axes)
        and _is_pose(front.axes)
        and abs(front.thickness_mm + exit_z + inner[-1].thickness_mm) <= TOLERANCE_MM * (1.0 + abs(exit_z))
    ):
        pivot = -front.thickness_mm
        pose = _noted_pose(draft, front.axes, pivot)
        (x, y), (a, b, _) = front.axes.decenter_mm, front.axes.tilt_deg
        if pose is None:
            pose = Pose(x, y, 0.0, a, b, pivot)
        despace = float(np.asarray(pose.despace_mm))
        working_distance = rows[0].thickness_mm - pivot - despace
        noted: Any = draft.notes.get("working_distance_mm")
        if _near(noted, working_distance):
            working_distance = float(noted)
        first_plane = back.thickness_mm + pivot + despace - exit_z
        return [rows[0], *inner, rows[-1]], pose, working_distance, first_plane
    for row in rows:
        if row.axes is not None and row.axes not in (Break(), Break().inverse()):
            draft.dropped.append(f"{row.name}: coordinate break that is no pose of the whole lens")
    kept = [rows[0]]
    for row in rows[1:]:
        if row.axes is None:
            kept.append(row)
        else:
            kept[-1] = replace(kept[-1], thickness_mm=kept[-1].thickness_mm + row.thickness_mm)
    if len(kept) < 3:
        raise InputError(f"{draft.source}: no surface found between the object and the image")
    return kept, Pose(), kept[0].thickness_mm, kept[-2].thickness_mm


def _is_pose(axes: Break) -> bool:
    """Whether a break is a decenter and then tilts about x and the turned y."""
    a, b, c = axes.tilt_deg
    if not axes.reverse or not (a or b):
        return c == 0.0
    return c == 0.0 and not (a and b) and not any(axes.decenter_mm)


def _near(noted: Any, value: float) -> bool:
    """Whether a remark's number still holds of a value that was had from the surfaces."""
    if isinstance(noted, bool) or not isinstance(noted, int | float) or not abs(noted) < 1e12:
        return False
    return abs(noted - value) <= TOLERANCE_MM * (1.0 + abs(value))


def _noted_pose(draft: Draft, axes: Break, pivot_mm: float) -> Pose | None:
    """The pose of the file's remarks where the coordinate breaks still have it."""
    noted = draft.notes.get("pose")
    names = {f.name for f in fields(Pose)}
    if not isinstance(noted, dict) or set(noted) != names:
        return None
    (x, y), (a, b, _) = axes.decenter_mm, axes.tilt_deg
    found = {"decenter_x_mm": x, "decenter_y_mm": y, "tilt_x_deg": a, "tilt_y_deg": b, "pivot_z_mm": pivot_mm}
    if not all(_near(noted[name], value) for name, value in found.items()) or not _near(
        noted["despace_mm"], noted["despace_mm"] if isinstance(noted["despace_mm"], int | float) else 0.0
    ):
        return None
    return Pose(**{name: float(noted[name]) for name in names})


def _planes(draft: Draft, first_plane: float) -> tuple[float, ...] | None:
    """The sensor's planes: the image distance, and those that the file's remarks put behind it."""
    noted = draft.notes.get("plane_distances_mm")
    if isinstance(noted, list) and noted:
        if _near(noted[0], first_plane):
            return tuple(noted)
        if len(noted) > 1:
            draft.dropped.append(
                f"sensor planes {noted}: the image now lies {first_plane:g} mm behind the last surface"
            )
    return (first_plane,)


def _surfaces(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The surfaces between object and image as tables of a design file."""
    inner = rows[1:-1]
    if len(inner) > MOST_SURFACES:
        raise InputError(f"{inner[-1].where}: {len(inner)} surfaces; at most {MOST_SURFACES} are read")
    for row in inner[:-1]:
        if not 0.0 < row.thickness_mm < math.inf:
            raise InputError(
                f"{row.where}: the next surface lies {row.thickness_mm:g} mm behind {row.name}; "
                "in a design this must be finite and greater than 0"
            )
    return [
        {
            "radius_mm": row.radius_mm,
            "conic": row.conic,
            **row.shape,
            "thickness_mm": None if row is inner[-1] else row.thickness_mm,
            "material": row.material,
            "semi_diameter_mm": row.semi_diameter_mm,
            "stop": row.stop,
        }
        for row in inner
    ]


def _with_stop(
    rows: Sequence[Row], draft: Draft, values: dict[str, Any], catalogs: Sequence[Path], asked: bool
) -> tuple[list[Row], bool]:
    """Rows whose stop is as wide as the file's rays fill it; and whether it is as high as the marginal ray.

    The system aperture decides: the stop is as high as the exact marginal ray there, unless the file has a
    smaller aperture at the stop, which clips. Where the user gave a numerical aperture (`asked`), that is
    what the design has to reach, and a stop with an aperture stays as it is. A stop that floats gives the
    numerical aperture.
    """
    stop = _stop(rows)
    distance, na = values["working_distance_mm"], values["numerical_aperture"]
    row = rows[stop + 1]
    semi = row.semi_diameter_mm
    floating = draft.aperture is not None and draft.aperture[0] == "stop"
    if floating and semi is None:
        semi = row.automatic_mm
    if not _is_number(distance, 0.0, math.inf) or not _is_number(na, 0.0, 1.0):
        return _resized(rows, semi), False
    noted = draft.notes.get("aperture")
    if semi is not None and (asked or noted == [na, semi]):
        return _resized(rows, semi), False
    system = _system(draft, rows, catalogs)
    if floating and semi is not None:
        through = None if system is None else system.sine_through_stop(distance, semi, stop)
        values["numerical_aperture"] = na if through is None else through
        return _resized(rows, semi), through is not None
    paraxial = _paraxial_height(draft, rows, distance, na, catalogs)
    exact = None if asked or system is None else system.height_at_stop(distance, na, stop)
    height = paraxial if exact is None else exact
    if not 0.0 < height < math.inf:
        return list(rows), False
    if semi is None:
        draft.remark(
            f"{row.name}: the stop has no aperture in the file; {height:.6g} mm taken, its marginal ray's "
            "height"
        )
        return _resized(rows, height), exact is not None
    if any(abs(semi - h) <= MARGINAL_TOLERANCE * h for h in (height, paraxial)):
        return list(rows), abs(semi - height) <= MARGINAL_TOLERANCE * height
    if semi > height:
        draft.remark(
            f"{row.name}: a stop of {semi:.6g} mm lets through more than the system aperture "
            f"({_said(draft)}); "
            f"{height:.6g} mm taken, its marginal ray's height"
        )
        return _resized(rows, height), exact is not None
    draft.remark(
        f"{row.name}: the system aperture ({_said(draft)}) needs {height:.6g} mm at the stop, whose "
        f"aperture of {semi:.6g} mm clips it"
    )
    return list(rows), False


def _is_number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low < value < high


def _said(draft: Draft) -> str:
    """The file's system aperture in words."""
    names = {
        "object_na": "object NA",
        "image_na": "image NA",
        "pupil_diameter_mm": "entrance pupil diameter, mm:",
        "image_f_number": "image F-number",
        "working_f_number": "working F-number",
    }
    kind, value = draft.aperture or ("", 0.0)
    return f"{names.get(kind, 'aperture')} {value:g}"


def _resized(rows: Sequence[Row], semi_diameter_mm: float | None) -> list[Row]:
    """Rows with another semi-diameter of the stop."""
    at = 1 + _stop(rows)
    return [*rows[:at], replace(rows[at], semi_diameter_mm=semi_diameter_mm), *rows[at + 1 :]]


def _system(draft: Draft, rows: Sequence[Row], catalogs: Sequence[Path]) -> MeridionalSystem | None:
    """The surfaces for exact rays; None where one of them is none."""
    inner = rows[1:-1]
    try:
        shapes = tuple(
            Surface.model_validate({"radius_mm": row.radius_mm, "conic": row.conic, **row.shape}).shape
            for row in inner
        )
    except ValueError:  # said when the lens is validated
        return None
    indices = [1.0, *(_index(draft, row, catalogs) for row in inner)]
    return MeridionalSystem(shapes, tuple(row.thickness_mm for row in inner[:-1]), tuple(indices))


def _index(draft: Draft, row: Row, catalogs: Sequence[Path]) -> float:
    """Index behind a surface at the first wavelength."""
    if row.material is None:
        return 1.0
    try:
        return refractive_index(row.material, draft.wavelengths_um[0], catalogs)
    except MaterialError as error:
        raise MaterialError(f"{row.where}: {error}") from error


def _paraxial_height(
    draft: Draft, rows: Sequence[Row], distance: float, na: float, catalogs: Sequence[Path]
) -> float:
    """Height of the paraxial marginal ray at the stop."""
    kind, value = draft.aperture or ("", 0.0)
    at_stop, _ = _two_rays(draft, rows, distance, catalogs)
    if kind == "pupil_diameter_mm":
        return abs(float(0.5 * value * at_stop[1]))
    return abs(float(na / math.sqrt(1.0 - na * na) * at_stop[0]))


def _remark_automatic(rows: Sequence[Row], draft: Draft) -> None:
    """Say which semi-diameters the other program only computed; they are no apertures of the design."""
    found = [
        f"{row.name} {row.automatic_mm:.6g} mm"
        for row in rows[1:-1]
        if row.automatic_mm is not None and row.semi_diameter_mm is None
    ]
    if found:
        draft.remark(f"automatic semi-diameters clip nothing and were left out: {', '.join(found)}")


def _stop(rows: Sequence[Row]) -> int:
    """Index of the stop among the surfaces between object and image."""
    return next((i for i, row in enumerate(rows[1:-1]) if row.stop), 0)


def _numerical_aperture(
    draft: Draft,
    rows: Sequence[Row],
    working_distance_mm: float,
    catalogs: Sequence[Path],
) -> float | None:
    """Sine of the marginal ray's angle at the object, from whichever aperture the file has; paraxially."""
    kind, value = draft.aperture or ("", 0.0)
    if kind == "object_na":
        return value
    stop = rows[1 + _stop(rows)]
    semi = stop.automatic_mm if stop.semi_diameter_mm is None else stop.semi_diameter_mm
    at_stop, slope = _two_rays(draft, rows, working_distance_mm, catalogs)
    with np.errstate(all="ignore"):
        tangents = {
            "stop": math.nan if semi is None else semi / at_stop[0],
            "pupil_diameter_mm": 0.5 * value * at_stop[1] / at_stop[0],
            "image_f_number": 0.5 / (value * np.abs(slope[1])) * at_stop[1] / at_stop[0],
            "working_f_number": 0.5 / (value * np.abs(slope[0])),
            "image_na": value / np.sqrt(1.0 - np.float64(value) ** 2) / np.abs(slope[0]),
        }
        result = abs(float(np.sin(np.arctan(tangents[kind]))))
    return result if 0.0 < result < 1.0 else None


def _two_rays(
    draft: Draft, rows: Sequence[Row], working_distance_mm: float, catalogs: Sequence[Path]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights at the stop, and slopes behind the lens, of two paraxial rays.

    One has unit slope from the axis of the object, the other goes parallel to the axis at unit height.
    """
    inner, stop, index = rows[1:-1], _stop(rows), 1.0
    height, slope = np.array([working_distance_mm, 1.0]), np.array([1.0, 0.0])
    at_stop = height
    with np.errstate(all="ignore"):
        for i, row in enumerate(inner):
            if i == stop:
                at_stop = height.copy()
            behind = _index(draft, row, catalogs)
            curvature = 0.0 if row.radius_mm is None else 1.0 / row.radius_mm
            slope = (index * slope - (behind - index) * curvature * height) / behind
            index = behind
            height = height + row.thickness_mm * slope
    return at_stop, slope
