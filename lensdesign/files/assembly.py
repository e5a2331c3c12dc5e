"""Assembly of a lens and its pose from the surfaces of another program's file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.toml_files import validate
from lensdesign.errors import DesignError, InputError, MaterialError
from lensdesign.files.contacts import read_contacts, without_crossings
from lensdesign.files.draft import (
    MAX_SURFACES,
    NO_WAVELENGTH,
    TOLERANCE_MM,
    CoordinateBreak,
    Draft,
    Imported,
    LossyImportError,
    Supplement,
    SurfaceRow,
    quoted,
)
from lensdesign.files.first_order_check import (
    MARGINAL_TOLERANCE,
    check_first_order,
    compare_recorded_indices,
)
from lensdesign.files.marginal_ray import MeridionalSystem
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.surface import Surface


def assemble(draft: Draft, supplement: Supplement, lossy: bool) -> Imported:
    """Convert the contents of a file to a lens.

    Parameters
    ----------
    draft
        Contents of the file.
    supplement
        Values that replace or complete those of the file.
    lossy
        Whether to continue if a design cannot represent the whole file.

    Raises
    ------
    LossyImportError
        If a design cannot represent the whole file and `lossy` is False.
    InputError
        If values are missing, or if the surfaces do not form a valid lens.
    MaterialError
        If a glass is unknown.
    """
    source = draft.source
    if len(draft.rows) < 3:
        raise InputError(
            f"{source}: {len(draft.rows)} surfaces found; there must be an object, a surface and an image"
        )
    if not draft.wavelengths_um:
        raise InputError(NO_WAVELENGTH.format(source))
    own_materials = draft.notes.get("materials")
    count = sum(row.axes is None for row in draft.rows) - 2
    written_here = isinstance(own_materials, list) and len(own_materials) == count
    rows = draft.rows if written_here else merge_touching_stop(fold_dummy_planes(draft.rows), draft)
    if len(rows) < 3:
        raise InputError(f"{source}: there are only planes in air between the object and the image")
    rows, cover_glass = _without_cover_glass(rows, draft)
    rows, pose, working_distance, first_plane = _extract_pose(rows, draft)
    rows = read_contacts(rows, draft)
    planes = _first_given(supplement.plane_distances_mm, _planes(draft, first_plane))
    stored = draft.notes.get("glass_catalogs")
    if stored and not supplement.glass_catalogs:
        draft.add_loss(
            f"glass catalogues {quoted(str(stored))}: files that a lens file names are not opened; "
            "give them together with the file"
        )
    _refuse_losses(draft, lossy)
    catalogs = supplement.glass_catalogs
    distance = _first_given(
        supplement.working_distance_mm, working_distance if working_distance < math.inf else None
    )
    values = {
        "working_distance_mm": distance,
        "field_diameter_mm": _first_given(
            supplement.field_diameter_mm, 2.0 * draft.half_field_mm if draft.half_field_mm else None
        ),
        "numerical_aperture": _first_given(
            supplement.numerical_aperture,
            _numerical_aperture(draft, rows, distance, catalogs) if draft.aperture and distance else None,
        ),
        "pixel_pitch_um": _first_given(supplement.pixel_pitch_um, draft.notes.get("pixel_pitch_um")),
        "pixels": _first_given(supplement.pixels, draft.notes.get("pixels")),
        "plane_distances_mm": planes,
        "cover_glass": cover_glass,
        "reflectance": draft.notes.get("reflectance"),
    }
    requested = supplement.numerical_aperture is not None
    stated = tuple(
        _first_given(row.glass_semi_diameter_mm, row.semi_diameter_mm, row.automatic_mm) for row in rows[1:-1]
    )
    rows, filled = _with_stop(rows, draft, values, catalogs, requested)
    stop_mm = rows[1 + _stop(rows)].semi_diameter_mm
    rows = _without_crossings(rows, draft, values, catalogs)
    filled = filled and rows[1 + _stop(rows)].semi_diameter_mm == stop_mm  # a crossing may clip the stop
    _refuse_losses(draft, lossy)
    surfaces = _surfaces(rows, draft)
    optional = ("cover_glass", "reflectance")
    missing = [name for name, value in values.items() if value is None and name not in optional]
    if missing:
        image = ""
        if "plane_distances_mm" in missing:
            image = f" (its image lies {first_plane:g} mm behind the last surface, where no sensor can be)"
        raise InputError(
            f"{source}: the file lacks {', '.join(missing)}{image}; give these values together with the file"
        )
    _remark_automatic(rows, draft)
    try:
        lens = _lens(draft, values, surfaces, catalogs)
    except DesignError as error:
        names = ", ".join(row.name.removeprefix("surface ") for row in rows[1:-1])
        raise DesignError(
            f"{error} (in words of the design that would be written; its surfaces 1, 2, ... are the surfaces "
            f"{names} of the file)"
        ) from error
    first_order = check_first_order(draft, lens, pose, supplement, filled)
    if loss := compare_recorded_indices(draft, first_order, catalogs):
        draft.add_loss(loss)
    _refuse_losses(draft, lossy)
    return Imported(lens, pose, tuple(draft.dropped), tuple(draft.remarks), first_order, stated)


def _refuse_losses(draft: Draft, lossy: bool) -> None:
    """Raise a LossyImportError if the draft has losses so far, unless they are accepted."""
    if draft.dropped and not lossy:
        raise LossyImportError(draft.source, tuple(draft.dropped))


def _without_crossings(
    rows: list[SurfaceRow], draft: Draft, values: dict[str, Any], catalogs: Sequence[Path]
) -> list[SurfaceRow]:
    """Return the rows with clear semi-diameters within which consecutive surfaces do not cross."""
    distance, field = values["working_distance_mm"], values["field_diameter_mm"]
    system = _system(draft, rows, catalogs)
    if system is None or not _is_number(distance, 0.0, math.inf):
        return rows
    half_field = 0.5 * field if _is_number(field, 0.0, math.inf) else 0.0
    return without_crossings(rows, draft, system, distance, half_field)


def _first_given(*values: Any) -> Any:
    """Return the first value that is not None."""
    return next((value for value in values if value is not None), None)


def _lens(
    draft: Draft, values: dict[str, Any], surfaces: list[dict[str, Any]], catalogs: Sequence[Path]
) -> Lens:
    """Return the lens after the same validation as for a design file."""
    data = {
        "title": draft.title,
        "wavelengths_um": draft.wavelengths_um,
        "glass_catalogs": list(catalogs),
        "object": {k: values[k] for k in ("working_distance_mm", "field_diameter_mm", "numerical_aperture")},
        "sensor": {
            k: values[k]
            for k in ("pixel_pitch_um", "pixels", "plane_distances_mm", "cover_glass", "reflectance")
            if values[k] is not None
        },
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


def _without_cover_glass(
    rows: list[SurfaceRow], draft: Draft
) -> tuple[list[SurfaceRow], dict[str, Any] | None]:
    """Return the rows without the cover glass that the file's comments describe, and its table.

    Planes that do not agree with the comments remain surfaces of the lens.
    """
    stored = draft.notes.get("cover_glass")
    if stored is None:
        return rows, None
    keys = {"thickness_mm", "material", "distance_mm"}
    is_table = isinstance(stored, dict) and set(stored) == keys
    if len(rows) >= 5 and is_table:
        before, front, rear, image = rows[-4:]
        is_plane = all(row.radius_mm is None and not any(row.shape.values()) for row in (front, rear))
        if (
            is_plane
            and front.material is not None
            and rear.material is None
            and _agrees(stored["thickness_mm"], front.thickness_mm)
            and _agrees(stored["distance_mm"], rear.thickness_mm)
        ):
            added_mm = front.thickness_mm + rear.thickness_mm
            kept = [*rows[:-4], replace(before, thickness_mm=before.thickness_mm + added_mm), image]
            recorded = draft.recorded
            if recorded:
                last = replace(recorded[-4], distance_mm=recorded[-4].distance_mm + added_mm)
                draft.recorded = [*recorded[:-4], last, recorded[-1]]
            return kept, stored
    draft.add_loss(
        "cover glass of the sensor: the last two surfaces do not agree with the file's comment on it, and "
        "remain surfaces of the lens"
    )
    return rows, None


def fold_dummy_planes(rows: Sequence[SurfaceRow]) -> list[SurfaceRow]:
    """Remove dummy planes in air that do not clip, or that have no distance to a neighbour."""
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


def merge_touching_stop(rows: Sequence[SurfaceRow], draft: Draft) -> list[SurfaceRow]:
    """Move the stop to the lens surface that its plane touches, because surfaces of a design have a distance.

    If that surface is a plane, this is exact. Otherwise the stop follows the sag of the surface, which is a
    loss. So is a stop whose plane lies behind the vertex of the next surface, within its sag, or in front of
    that of the preceding one.
    """
    i = next((i for i, row in enumerate(rows[1:-1], start=1) if row.stop), 0)
    row, before, behind = rows[i], rows[i - 1], rows[min(i + 1, len(rows) - 1)]
    is_plane = row.radius_mm is None and not any(row.shape.values()) and row.axes is None
    if not i or not is_plane or row.material is not None:
        return list(rows)
    if before.material is not None:  # the plane is the back of a lens
        return list(rows)
    if row.thickness_mm == 0.0 and i + 1 < len(rows) - 1 and behind.axes is None:
        touched, distance_mm = i + 1, behind.thickness_mm
    elif before.thickness_mm == 0.0 and i > 1 and before.axes is None:
        touched, distance_mm = i - 1, row.thickness_mm
    elif row.thickness_mm < 0.0 and i + 1 < len(rows) - 1 and behind.axes is None and not before.axes:
        return _with_stop_within_sag(rows, draft, i, i + 1)
    elif before.thickness_mm < 0.0 and i > 1 and before.axes is None and behind.axes is None:
        return _with_stop_within_sag(rows, draft, i, i - 1)
    else:
        return list(rows)
    surface = rows[touched]
    text = f"{row.name}: the stop touches {surface.name} and is read as its aperture"
    if surface.radius_mm is None and not any(surface.shape.values()):
        draft.add_remark(text)
    else:
        draft.add_loss(f"{text}, which has a sag")
    semis = [r.semi_diameter_mm for r in (row, surface) if r.semi_diameter_mm is not None]
    merged = replace(
        surface,
        stop=True,
        semi_diameter_mm=min(semis, default=None),
        glass_semi_diameter_mm=surface.semi_diameter_mm,
        thickness_mm=distance_mm,
    )
    kept = list(rows)
    kept[touched] = merged
    del kept[i]
    return kept


def _with_stop_within_sag(
    rows: Sequence[SurfaceRow], draft: Draft, stop: int, touched: int
) -> list[SurfaceRow]:
    """Return the rows with a surface as the stop whose plane lies within the sag of this surface."""
    row, before, surface = rows[stop], rows[stop - 1], rows[touched]
    total_mm = before.thickness_mm + row.thickness_mm
    if not total_mm > 0.0 or surface.semi_diameter_mm == 0.0:
        return list(rows)
    depth = abs(row.thickness_mm) if touched > stop else abs(before.thickness_mm)
    side = "behind" if touched > stop else "in front of"
    draft.add_loss(
        f"{row.name}: the stop lies {depth:g} mm {side} the vertex of {surface.name} and is read as its "
        "aperture"
    )
    _shift_recorded_stop(draft, row.thickness_mm if touched > stop else -before.thickness_mm)
    kept = list(rows)
    # The stop's own semi-diameter is that of its plane; the marginal ray gives the one at the surface.
    merged = replace(surface, stop=True, glass_semi_diameter_mm=surface.semi_diameter_mm)
    if touched > stop:
        kept[stop - 1] = replace(before, thickness_mm=total_mm)
    else:
        merged = replace(merged, thickness_mm=total_mm)
    kept[touched] = merged
    del kept[stop]
    return kept


def _shift_recorded_stop(draft: Draft, shift_mm: float) -> None:
    """Move the stop along the axis in the surfaces that the finished lens is compared with."""
    k = next((i for i, surface in enumerate(draft.recorded) if surface.stop), 0)
    if k:
        before, plane = draft.recorded[k - 1 : k + 1]
        draft.recorded[k - 1 : k + 1] = [
            replace(before, distance_mm=before.distance_mm + shift_mm),
            replace(plane, distance_mm=plane.distance_mm - shift_mm),
        ]


def _extract_pose(rows: list[SurfaceRow], draft: Draft) -> tuple[list[SurfaceRow], Pose, float, float]:
    """Return the rows without coordinate breaks, the pose, the working distance and the first plane.

    The breaks represent a pose if there is one before the first surface and its inverse, at the same point,
    behind the last one; or if they place all surfaces as such a pair would.
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
        pose = _stored_pose(draft, front.axes, pivot)
        (x, y), (a, b, _) = front.axes.decenter_mm, front.axes.tilt_deg
        if pose is None:
            pose = Pose(x, y, 0.0, a, b, pivot)
        despace = float(np.asarray(pose.despace_mm))
        working_distance = rows[0].thickness_mm - pivot - despace
        stored: Any = draft.notes.get("working_distance_mm")
        if _agrees(stored, working_distance):
            working_distance = float(stored)
        first_plane = back.thickness_mm + pivot + despace - exit_z
        return [rows[0], *inner, rows[-1]], pose, working_distance, first_plane
    kept = [rows[0]]
    for row in rows[1:]:
        if row.axes is None:
            kept.append(row)
        else:
            kept[-1] = replace(kept[-1], thickness_mm=kept[-1].thickness_mm + row.thickness_mm)
    if len(kept) < 3:
        raise InputError(f"{draft.source}: no surface found between the object and the image")
    equal = _pose_of_places(rows)
    if equal is None:
        for row in rows:
            if row.axes is not None and not row.axes.is_identity:
                draft.add_loss(f"{row.name}: coordinate break that is not a pose of the whole lens")
    return kept, equal or Pose(), kept[0].thickness_mm, kept[-2].thickness_mm


def _pose_of_places(rows: Sequence[SurfaceRow]) -> Pose | None:
    """Return the pose that places all surfaces as the coordinate breaks do; None if there is none.

    The surfaces of the lens then have one axis, and the image has that of the object. The distances of the
    file must also be those along these axes, because the finished lens is compared with them.
    """
    frames, path_mm, paths_mm = [np.eye(4)], 0.0, [0.0]
    frame = np.eye(4)
    for before, row in pairwise(rows):
        step_mm = before.thickness_mm if before.thickness_mm < math.inf else 0.0
        path_mm += step_mm
        frame = frame @ _along_axis(step_mm)
        if row.axes is None:
            frames.append(frame)
            paths_mm.append(path_mm)
        else:
            frame = frame @ row.axes.matrix()
    front = frames[1]
    tilts = math.atan2(front[2, 1], front[1, 1]), math.atan2(front[0, 2], front[0, 0])
    x_mm, y_mm, _ = front[:3, 3].tolist()
    pose = Pose(x_mm, y_mm, 0.0, *(round(math.degrees(tilt), 12) for tilt in tilts))
    placed = _along_axis(paths_mm[1])
    placed[:2, 3] = x_mm, y_mm
    placed[:3, :3] = pose.transform()[0][0]
    expected = [placed @ _along_axis(path - paths_mm[1]) for path in paths_mm[1:-1]]
    tolerance_mm = TOLERANCE_MM * (1.0 + abs(path_mm))
    same = np.allclose(frames, [np.eye(4), *expected, _along_axis(path_mm)], rtol=0.0, atol=tolerance_mm)
    return pose if same else None


def _along_axis(distance_mm: float) -> NDArray[np.float64]:
    """Return the homogeneous matrix of a shift along z."""
    matrix = np.eye(4)
    matrix[2, 3] = distance_mm
    return matrix


def _is_pose(axes: CoordinateBreak) -> bool:
    """Return whether a coordinate break is a decenter followed by tilts about x and the new y."""
    a, b, c = axes.tilt_deg
    if not axes.reverse or not (a or b):
        return c == 0.0
    return c == 0.0 and not (a and b) and not any(axes.decenter_mm)


def _agrees(stored: Any, value: float) -> bool:
    """Return whether a number of a comment agrees with the value that the surfaces give."""
    if isinstance(stored, bool) or not isinstance(stored, int | float) or not abs(stored) < 1e12:
        return False
    return abs(stored - value) <= TOLERANCE_MM * (1.0 + abs(value))


def _stored_pose(draft: Draft, axes: CoordinateBreak, pivot_mm: float) -> Pose | None:
    """Return the pose in the file's comments if it agrees with the coordinate breaks, else None."""
    stored = draft.notes.get("pose")
    names = {f.name for f in fields(Pose)}
    if not isinstance(stored, dict) or set(stored) != names:
        return None
    (x, y), (a, b, _) = axes.decenter_mm, axes.tilt_deg
    found = {"decenter_x_mm": x, "decenter_y_mm": y, "tilt_x_deg": a, "tilt_y_deg": b, "pivot_z_mm": pivot_mm}
    if not all(_agrees(stored[name], value) for name, value in found.items()) or not _agrees(
        stored["despace_mm"], stored["despace_mm"] if isinstance(stored["despace_mm"], int | float) else 0.0
    ):
        return None
    return Pose(**{name: float(stored[name]) for name in names})


def _planes(draft: Draft, first_plane: float) -> tuple[float, ...] | None:
    """Return the sensor planes: the image distance, and further planes from the file's comments.

    None if the image does not lie behind the lens.
    """
    stored = draft.notes.get("plane_distances_mm")
    if isinstance(stored, list) and stored:
        if _agrees(stored[0], first_plane):
            return tuple(stored)
        if len(stored) > 1:
            draft.add_loss(
                f"sensor planes {stored}: the image now lies {first_plane:g} mm behind the last surface"
            )
    return (first_plane,) if 0.0 < first_plane < math.inf else None


def _surfaces(rows: Sequence[SurfaceRow], draft: Draft) -> list[dict[str, Any]]:
    """Return the surfaces between object and image as tables of a design file."""
    inner = rows[1:-1]
    if len(inner) > MAX_SURFACES:
        raise InputError(f"{inner[-1].location}: {len(inner)} surfaces; at most {MAX_SURFACES} are read")
    for row in inner[:-1]:
        if not 0.0 < row.thickness_mm < math.inf:
            raise InputError(
                f"{row.location}: the next surface lies {row.thickness_mm:g} mm behind {row.name}; "
                f"surfaces follow each other in a design, so the distance must be finite and 0 or more in "
                f"the file{_mirrors(draft)}"
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


def _mirrors(draft: Draft) -> str:
    """Return the mirrors that a lossy import omitted; behind them, distances have the other sign."""
    mirrors = [loss.split(":")[0] for loss in draft.dropped if ": mirror" in loss]
    return f". The file has mirrors: {', '.join(mirrors)}" if mirrors else ""


def _with_stop(
    rows: Sequence[SurfaceRow],
    draft: Draft,
    values: dict[str, Any],
    catalogs: Sequence[Path],
    requested: bool,
) -> tuple[list[SurfaceRow], bool]:
    """Set the semi-diameter of the stop; return the rows and whether it equals the marginal ray's height.

    The system aperture determines the semi-diameter: it is the height of the exact marginal ray at the stop,
    unless the file has a smaller aperture there, which clips. If the user gave a numerical aperture
    (`requested`), a stop with an aperture stays unchanged. For a system aperture "float by stop size", the
    stop determines the numerical aperture.
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
    stored = draft.notes.get("aperture")
    if semi is not None and (requested or stored == [na, semi]):
        return _resized(rows, semi), False
    system = _system(draft, rows, catalogs)
    if floating and semi is not None:
        through = None if system is None else system.sine_through_stop(distance, semi, stop)
        values["numerical_aperture"] = na if through is None else through
        return _resized(rows, semi), through is not None
    paraxial = _paraxial_height(draft, rows, distance, na, catalogs)
    exact = None if requested or system is None else system.height_at_stop(distance, na, stop)
    height = paraxial if exact is None else exact
    if not 0.0 < height < math.inf:
        return list(rows), False
    if semi is None:
        draft.add_remark(
            f"{row.name}: the stop has no aperture in the file; its semi-diameter is {height:.6g} mm, the "
            "height of the marginal ray"
        )
        return _resized(rows, height), exact is not None
    if any(abs(semi - h) <= MARGINAL_TOLERANCE * h for h in (height, paraxial)):
        return list(rows), abs(semi - height) <= MARGINAL_TOLERANCE * height
    if semi > height:
        draft.add_remark(
            f"{row.name}: the file's stop of {semi:.6g} mm exceeds the system aperture "
            f"({_aperture_text(draft)}); its semi-diameter is {height:.6g} mm, the height of the marginal ray"
        )
        return _resized(rows, height), exact is not None
    draft.add_remark(
        f"{row.name}: the system aperture ({_aperture_text(draft)}) needs {height:.6g} mm at the stop, "
        f"whose aperture of {semi:.6g} mm clips it"
    )
    return list(rows), False


def _is_number(value: Any, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low < value < high


def _aperture_text(draft: Draft) -> str:
    """Return the file's system aperture in words."""
    names = {
        "object_na": "object NA",
        "image_na": "image NA",
        "pupil_diameter_mm": "entrance pupil diameter, mm:",
        "image_f_number": "image F-number",
        "working_f_number": "working F-number",
    }
    kind, value = draft.aperture or ("", 0.0)
    return f"{names.get(kind, 'aperture')} {value:g}"


def _resized(rows: Sequence[SurfaceRow], semi_diameter_mm: float | None) -> list[SurfaceRow]:
    """Return the rows with another semi-diameter of the stop."""
    i = 1 + _stop(rows)
    return [*rows[:i], replace(rows[i], semi_diameter_mm=semi_diameter_mm), *rows[i + 1 :]]


def _system(draft: Draft, rows: Sequence[SurfaceRow], catalogs: Sequence[Path]) -> MeridionalSystem | None:
    """Return the surfaces for exact rays; None if one of them is not valid."""
    inner = rows[1:-1]
    try:
        shapes = tuple(
            Surface.model_validate({"radius_mm": row.radius_mm, "conic": row.conic, **row.shape}).shape
            for row in inner
        )
    except ValueError:  # reported when the lens is validated
        return None
    indices = [1.0, *(_index(draft, row, catalogs) for row in inner)]
    return MeridionalSystem(shapes, tuple(row.thickness_mm for row in inner[:-1]), tuple(indices))


def _index(draft: Draft, row: SurfaceRow, catalogs: Sequence[Path]) -> float:
    """Return the index behind a surface at the first wavelength."""
    if row.material is None:
        return 1.0
    try:
        return refractive_index(row.material, draft.wavelengths_um[0], catalogs)
    except MaterialError as error:
        raise MaterialError(f"{row.location}: {error}") from error


def _paraxial_height(
    draft: Draft, rows: Sequence[SurfaceRow], distance: float, na: float, catalogs: Sequence[Path]
) -> float:
    """Return the height of the paraxial marginal ray at the stop in mm."""
    kind, value = draft.aperture or ("", 0.0)
    at_stop, _ = _two_rays(draft, rows, distance, catalogs)
    if kind == "pupil_diameter_mm":
        return abs(float(0.5 * value * at_stop[1]))
    return abs(float(na / math.sqrt(1.0 - na * na) * at_stop[0]))


def _remark_automatic(rows: Sequence[SurfaceRow], draft: Draft) -> None:
    """Add a remark on semi-diameters that the other program computed; they are not apertures."""
    found = [
        f"{row.name} {row.automatic_mm:.6g} mm"
        for row in rows[1:-1]
        if row.automatic_mm is not None and row.semi_diameter_mm is None
    ]
    if found:
        draft.add_remark(f"automatic semi-diameters do not clip and were ignored: {', '.join(found)}")


def _stop(rows: Sequence[SurfaceRow]) -> int:
    """Return the index of the stop among the surfaces between object and image."""
    return next((i for i, row in enumerate(rows[1:-1]) if row.stop), 0)


def _numerical_aperture(
    draft: Draft,
    rows: Sequence[SurfaceRow],
    working_distance_mm: float,
    catalogs: Sequence[Path],
) -> float | None:
    """Return the sine of the marginal ray's angle at the object, converted paraxially from the aperture."""
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
    draft: Draft, rows: Sequence[SurfaceRow], working_distance_mm: float, catalogs: Sequence[Path]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return heights at the stop, and slopes behind the lens, of two paraxial rays.

    One starts at the axial object point with unit slope. The other is parallel to the axis at unit height.
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
