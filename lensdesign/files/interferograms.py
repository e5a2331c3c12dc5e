"""Interferograms: maps of the height of a made surface, and the sag error that they show.

The reader supports Zygo's binary files: MetroPro ``.dat`` through prysm, and Mx ``.datx``. A map shows the
surface as the camera of the instrument sees it: the first row is at the top, and heights are positive towards
the instrument. The instrument looks at a front surface along +z, and at a back surface along -z; the top of
its picture is +y. A front is therefore seen mirrored, and its heights are opposite to sag errors.

Piston and tilt of a map depend on the alignment in the instrument and are removed. So is power (r^2), unless
the radius was measured with the map: the distance from the reference determines it.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.input_files import TABLE_BYTES, check_input
from lensdesign.errors import InputError
from lensdesign.files.zygo_datx import read_datx
from lensdesign.lens.height_maps import (
    bridge_dropouts,
    implausible_heights,
    main_area,
    validate_heights,
    validate_spacing,
)
from lensdesign.lens.surface_figure import FEWEST_POINTS

Side = Literal["front", "back"]
"""Side of the glass on which a surface lies."""

DAT_MAGIC = (b"\x88\x1b\x03\x6f", b"\x88\x1b\x03\x70", b"\x88\x1b\x03\x71")
"""First bytes of MetroPro files."""

UNREADABLE = (OSError, ImportError, ValueError, TypeError, AttributeError, LookupError, RuntimeError)
"""Exceptions by which prysm and h5py end in damaged files."""

HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
"""First bytes of Mx files, which are HDF5."""


@dataclass(frozen=True, eq=False)
class Interferogram:
    """Map of the height of a surface, as the instrument shows it.

    Attributes
    ----------
    height_mm : ndarray, shape (rows, columns)
        Height in mm, positive towards the instrument; NaN where it was not measured. The first row is at the
        top.
    spacing_mm : float
        Distance between neighbouring points on the surface in mm.
    """

    height_mm: Array
    spacing_mm: float


@dataclass(frozen=True, eq=False)
class FigureMap:
    """Sag error of a surface, as a grid file contains it (:mod:`lensdesign.files.surface_figures`).

    Attributes
    ----------
    sag_error_mm : ndarray, shape (rows, columns)
        Sag error in mm, positive along +z; NaN where it was not measured. y increases with the row, x with
        the column. The middle of the grid is the middle of the measured area.
    spacing_mm : float
        Distance between neighbouring points in mm.
    semi_diameter_mm : float
        Radius of the largest disc about the middle in which every point was measured or bridged.
    tilt_deg : (x, y)
        Removed slopes along x and y, as angles.
    power_um : float
        Power (r^2) within the semi-diameter, as the sag error in um that it causes at its rim.
    pv_um, rms_um : float
        Peak to valley and root mean square of the sag error within the semi-diameter.
    bridged_points, ignored_points : int
        Number of points without data whose sag error follows from their neighbours, and of points whose
        height is so far from all others that it was ignored.
    """

    sag_error_mm: Array
    spacing_mm: float
    semi_diameter_mm: float
    tilt_deg: tuple[float, float]
    power_um: float
    pv_um: float
    rms_um: float
    bridged_points: int
    ignored_points: int


def read_interferogram(path: str | os.PathLike[str], spacing_mm: float | None = None) -> Interferogram:
    """Read a map of a surface's height from a Zygo file.

    Parameters
    ----------
    path
        A file of MetroPro (``.dat``) or Mx (``.datx``).
    spacing_mm
        Distance between neighbouring points on the surface; default: that of the file.

    Raises
    ------
    InputError
        If the file cannot be read, is of another kind, refers to other files, states no spacing and none is
        given, or its spacing or heights are outside the range of a surface.
    """
    check_input(path, TABLE_BYTES)
    try:
        with Path(path).open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if not start.startswith((*DAT_MAGIC, HDF5_MAGIC)):
        raise InputError(f"{path}: no Zygo file (.dat of MetroPro or .datx of Mx)")
    try:
        height_mm, stated_mm = read_datx(path) if start == HDF5_MAGIC else _read_dat(path)
    except ModuleNotFoundError as error:
        raise InputError(
            f"interferograms need an extra: pip install 'transferlens[interferograms]' ({error})"
        ) from None
    except InputError:
        raise
    except (*UNREADABLE, struct.error) as error:
        raise InputError(f"{path}: cannot be read as a Zygo file; is it cut short? ({error})") from error
    used_mm = stated_mm if spacing_mm is None else spacing_mm
    if used_mm is None:
        raise InputError(f"{path}: states no distance between its points; give spacing_mm")
    validate_spacing(used_mm, f"{path}: distance between points" if spacing_mm is None else "spacing_mm")
    if not np.any(np.isfinite(height_mm)):
        raise InputError(f"{path}: has no measured points")
    validate_heights(height_mm, str(path))
    return Interferogram(height_mm, used_mm)


def _read_dat(path: str | os.PathLike[str]) -> tuple[Array, float | None]:
    """Return the heights in mm of a file of MetroPro, and the distance between its points."""
    from prysm.io import read_zygo_dat

    with np.errstate(all="ignore"):
        found = read_zygo_dat(path)
    spacing_mm = 1e3 * float(found["meta"]["lateral_resolution"])
    return 1e-6 * np.asarray(found["phase"], float), spacing_mm if spacing_mm > 0.0 else None


def figure_map(interferogram: Interferogram, side: Side, *, keep_power: bool = False) -> FigureMap:
    """Return the sag error that an interferogram shows, about the middle of the measured area.

    Isolated dropouts are bridged from their neighbours, and heights far from all others count as dropouts.
    Tilt and power are fitted to all points of the disc about the middle that were measured or bridged.

    Parameters
    ----------
    interferogram
        Map of the height of the surface.
    side
        Whether the surface is the front or the back of its glass.
    keep_power
        Whether power is an error of the surface. By default it is removed, like piston and tilt.

    Raises
    ------
    InputError
        If an area without data lies in the middle, or the measured area is too small.
    """
    spacing = interferogram.spacing_mm
    height = interferogram.height_mm
    ignored = implausible_heights(height)
    height = np.where(ignored, np.nan, height)
    measured = main_area(height)
    rows, columns = (np.flatnonzero(measured.any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    bridged = bridge_dropouts(np.where(measured, height, np.nan)[box])
    # The first row is at the top. An instrument that looks along +z has +x on its left.
    turn = np.s_[::-1] if side == "back" else np.s_[::-1, ::-1]
    sag = (1.0 if side == "back" else -1.0) * bridged.height_mm[turn]
    y, x = (spacing * (np.arange(n) - 0.5 * (n - 1)) for n in sag.shape)
    radial_height = np.hypot(x, y[:, None])
    missing = np.where(np.isfinite(sag), np.inf, radial_height)
    whole_mm = min(float(x[-1]), float(y[-1]))
    semi_mm = min(float(missing.min()) - spacing, whole_mm)
    if semi_mm < 0.5 * FEWEST_POINTS * spacing:
        row, column = np.unravel_index(int(np.argmin(missing)), missing.shape)
        raise InputError(
            "areas without data in the middle of the map: every point within some distance of the middle "
            f"of the measured area must be measured, over at least {FEWEST_POINTS} points. The area about "
            f"x = {x[column]:.3g} mm, y = {y[row]:.3g} mm is too large to be bridged"
        )
    across, down = (np.broadcast_to(one, sag.shape) for one in (x, y[:, None]))
    terms = np.stack([np.ones(sag.shape), across, down, radial_height**2], axis=-1)
    fitted = (radial_height <= max(semi_mm, whole_mm - spacing)) & np.isfinite(sag)
    coefficients = np.linalg.lstsq(terms[fitted], sag[fitted], rcond=None)[0]
    removed = coefficients * [1.0, 1.0, 1.0, not keep_power]
    sag = sag - terms @ removed
    within = 1e3 * sag[radial_height <= semi_mm]
    tilt_x, tilt_y = np.degrees(np.arctan(coefficients[1:3])).tolist()
    return FigureMap(
        sag,
        spacing,
        semi_mm,
        (tilt_x, tilt_y),
        1e3 * float(coefficients[3]) * semi_mm**2,
        float(np.ptp(within)),
        float(np.std(within)),
        int(np.count_nonzero(bridged.bridged)),
        int(np.count_nonzero(ignored)),
    )
