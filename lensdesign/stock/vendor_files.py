"""Reading of one vendor's lens file as a stock lens: a single lens, or a cemented group.

A vendor's file describes the lens in the vendor's own light: object at infinity, some field angles, a stop
in front. A search needs only the glass. The object, the field and the aperture of the file are therefore
replaced before the file is imported, so that the import with all its checks works on any such file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from lensdesign.common.text import printable_name
from lensdesign.errors import InputError
from lensdesign.files.draft import LossyImportError, Supplement
from lensdesign.files.formats import LENS_FORMATS, read_lens_file
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface

# Losses that do not change the glass: the light and the stop that the vendor assumed.
_NOT_OF_THE_GLASS = re.compile(
    r"vignetting factors|telecentric object space|surface \d+: the stop touches surface \d+ "
)


def find_vendor_files(folder: Path) -> tuple[list[Path], list[tuple[str, str]]]:
    """Return all lens files below a folder, and what cannot be read with the reasons.

    Symbolic links to folders are not followed, so that the walk ends. Files whose names are not UTF-8 cannot
    be named in designs and tables, so they are among the faults.
    """
    found: list[Path] = []
    faults: list[tuple[str, str]] = []
    waiting = [str(folder)]
    while waiting:  # without recursion: there may be more folders in each other than Python allows calls
        parent = waiting.pop()
        try:
            with os.scandir(parent) as entries:
                for entry in entries:
                    if entry.is_dir(follow_symlinks=False):
                        waiting.append(entry.path)
                    elif os.path.splitext(entry.name)[1].lower() in LENS_FORMATS:
                        found.append(Path(entry.path))
        except OSError as error:
            name = Path(parent).relative_to(folder).as_posix()
            faults.append((printable_name(name), f"cannot read the folder: {error.strerror}"))
    readable = []
    for path in found:
        name = path.relative_to(folder).as_posix()
        if printable_name(name) == name:
            readable.append(path)
        else:
            faults.append((printable_name(name), "its name is not UTF-8; rename the file or its folder"))
    return sorted(readable), sorted(faults)


def read_stock_lens(path: Path, catalogs: Sequence[Path] = ()) -> tuple[str, tuple[Surface, ...]]:
    """Return the title and the surfaces of the only lens in a vendor's file.

    Parameters
    ----------
    path
        The file.
    catalogs
        Glass catalogues (AGF) that are searched first.

    Returns
    -------
    title : str
        Title in the file; the name of the file if it has none.
    surfaces : tuple of Surface
        Surfaces of the glass, front to back, each with the clear semi-diameter that the file states.

    Raises
    ------
    InputError
        If the file is not understood, or does not contain exactly one lens with known clear semi-diameters.
    """
    # Values of a design that no vendor's file has. They have no effect on the glass: a narrow beam from afar
    # passes every lens.
    supplement = Supplement(
        working_distance_mm=1e4,
        field_diameter_mm=1.0,
        numerical_aperture=1e-5,
        pixel_pitch_um=1.0,
        pixels=(1, 1),
        plane_distances_mm=(1.0,),
        glass_catalogs=tuple(catalogs),
    )
    try:
        found = read_lens_file(path, supplement)
    except LossyImportError as error:
        losses = [loss for loss in error.dropped if not _NOT_OF_THE_GLASS.match(loss)]
        if losses:
            raise LossyImportError(str(path), losses) from None
        found = read_lens_file(path, supplement, lossy=True)
    first, last = _glass_range(found.lens, path)
    surfaces = found.lens.surfaces[first : last + 1]
    semis = found.semi_diameters_mm[first : last + 1]
    for number, semi in enumerate(semis, start=1):
        if semi is None:
            raise InputError(
                f"{path}: the file states no semi-diameter of surface {number} of the glass; add it (DIAM, "
                "CLAP, CIR or AP CHK)"
            )
    sized = [
        surface.replaced(semi_diameter_mm=semi, stop=False)
        for surface, semi in zip(surfaces, semis, strict=True)
    ]
    sized[-1] = sized[-1].replaced(thickness_mm=None)
    return found.lens.title or path.stem, tuple(sized)


def _glass_range(lens: Lens, path: Path) -> tuple[int, int]:
    """Return the indices of the first and the last surface of the only glass between planes in air."""
    glass = [i for i, surface in enumerate(lens.surfaces) if not is_gap(surface.material)]
    if not glass:
        raise InputError(f"{path}: contains no glass")
    first, last = glass[0], glass[-1] + 1
    if last == len(lens.surfaces):
        raise InputError(f"{path}: the image lies in the glass; the last surface of the lens is missing")
    if len(glass) != last - first:
        groups = 1 + sum(b != a + 1 for a, b in pairwise(glass))
        raise InputError(
            f"{path}: {groups} lenses with air between them; only single lenses and cemented groups are "
            "searched"
        )
    bent = [i for i, s in enumerate(lens.surfaces) if not first <= i <= last and s.kind != "plane"]
    if bent:
        raise InputError(f"{path}: surface {bent[0] + 1} of the file is curved, but has no glass")
    return first, last


def surface_tables(surfaces: Sequence[Surface]) -> list[dict[str, Any]]:
    """Return surfaces as tables of a design file."""
    return [
        surface.model_dump(mode="json", by_alias=True, exclude_defaults=True, exclude_none=True)
        for surface in surfaces
    ]
