"""Lens files of vendors in a folder: how many are read, and why the others are refused.

``python -m benchmarks.lens_files FOLDER [AGF ...]`` imports every file of the supported formats below the
folder, with the glass catalogues, and with values for what the files lack (object, field, sensor). It prints
the number of files by format, and the reasons of refusals, each with one example. A file that fails with
anything but a message is a defect; the status is then 1. If Optiland is installed, it reads the same .zmx
files. Rays through the lenses whose indices agree with ours should agree within 1 nm; others are listed.
Optiland 0.6.3 does not convert lengths in inches, cm or m.
"""

from __future__ import annotations

import re
import sys
import traceback
import warnings
from collections import Counter
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.others import HOW_TO_GET
from lensdesign import InputError, Lens, MaterialError, trace
from lensdesign.files.draft import Imported, LossyImportError, Supplement
from lensdesign.files.formats import read_lens_file
from lensdesign.stock.vendor_files import find_vendor_files

Array = NDArray[np.float64]

LACKING = {
    "working_distance_mm": 1000.0,
    "field_diameter_mm": 1.0,
    "numerical_aperture": 1e-3,
    "plane_distances_mm": (50.0,),
}
"""Values for what a file lacks; they do not change the lens."""

TOLERANCE_MM = 1e-6
INDEX_TOLERANCE = 1e-9
EXAMPLES = 40


def read(path: Path, catalogs: tuple[Path, ...]) -> Imported:
    """Read a file, completed with the values that its message names."""
    given: dict[str, Any] = {"pixel_pitch_um": 3.0, "pixels": (1000, 1000), "glass_catalogs": catalogs}
    while True:
        try:
            return read_lens_file(path, Supplement(**given))
        except InputError as error:
            missing = re.search(r"the file lacks (.*?)(?: \(|; give)", str(error))
            if missing is None or set(missing[1].split(", ")) & set(given):
                raise
            given |= {name: LACKING[name] for name in missing[1].split(", ")}


def reasons(error: Exception, path: Path) -> set[str]:
    """Return the reasons of a refusal without names, numbers and quotations, so that they can be counted."""
    lines = error.dropped if isinstance(error, LossyImportError) else (str(error).replace(str(path), "FILE"),)
    plain = (re.sub(r"'[^']*'", "'...'", line.split(". ")[0].split("; did you")[0]) for line in lines)
    return {re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "N", text) for text in plain}


def refracting_range(indices: Any) -> tuple[int, int]:
    """Return the positions of the first and the last surface that refract."""
    bends = [abs(a - b) > INDEX_TOLERANCE for a, b in pairwise(indices)]
    return bends.index(True), len(bends) - 1 - bends[::-1].index(True)


def rays(lens: Lens, semi_mm: float) -> tuple[Array, Array]:
    """Return a fan along y, and a skew fan, that start in front of the lens; z counts from its front."""
    heights = np.linspace(-0.7, 0.7, 9) * semi_mm
    straight = np.column_stack([0.0 * heights, heights, 0.0 * heights])
    skew = np.column_stack([0.3 * semi_mm + 0.0 * heights, heights, 0.0 * heights])
    slopes = np.array([[0.0, 0.0, 1.0], [0.02, 0.03, 1.0]])
    directions = np.repeat(slopes / np.linalg.norm(slopes, axis=1, keepdims=True), 9, axis=0)
    origins = np.vstack([straight, skew])
    return origins - directions / directions[:, 2:] * max(5.0, semi_mm), directions


def difference_mm(path: Path, found: Imported) -> float | None:
    """Return the distance of Optiland's rays from ours behind the lens; None if its indices differ."""
    lens, wavelength = found.lens, found.lens.wavelengths_um[0]
    ours = [float(n) for n in lens.indices(wavelength)]
    first, last = refracting_range(ours)
    z = np.concatenate([[0.0], np.cumsum([s.thickness_mm for s in lens.surfaces[:-1]])])
    semi = found.semi_diameters_mm[first] or lens.stop_semi_diameter_mm
    origins, directions = rays(lens, semi)
    plane = float(z[last] - z[first]) + 4.0 * semi
    front = [0.0, 0.0, z[first]]
    traced = trace(lens, origins + front, directions, wavelength, plane_z_mm=plane + z[first], clip=False)

    optic: Any = import_module("optiland.fileio").load_zemax_file(str(path))
    surfaces = optic.surface_group.surfaces
    theirs = [float(np.ravel(s.material_post.n(wavelength))[0]) for s in surfaces]
    start, end = (1 + i for i in refracting_range(theirs))
    media = ours[first : last + 2], theirs[start - 1 : end + 1]
    if len(media[0]) != len(media[1]) or not np.allclose(*media, rtol=0.0, atol=INDEX_TOLERANCE):
        return None
    starts = np.add(origins, [0.0, 0.0, _z(surfaces[start])])
    beam = import_module("optiland.rays").RealRays(
        *np.ascontiguousarray(starts.T),
        *np.ascontiguousarray(directions.T),
        np.ones(len(origins)),
        np.full(len(origins), wavelength),
    )
    for surface in surfaces[start : end + 1]:
        surface.aperture = None
        surface.trace(beam)
    points = np.column_stack([beam.x, beam.y, beam.z - _z(surfaces[start])])
    slopes = np.column_stack([beam.L, beam.M, beam.N])
    points += ((plane - points[:, 2]) / slopes[:, 2])[:, np.newaxis] * slopes
    passes = traced.status == 0
    return float(np.max(np.abs(points - traced.position + front)[passes], initial=0.0))


def _z(surface: Any) -> float:
    return float(np.ravel(surface.geometry.cs.z)[0])


def compare(paths: dict[Path, Imported]) -> None:
    """Print how far rays of Optiland lie from ours, and list the files with other rays."""
    if find_spec("optiland") is None:
        print(f"left out: optiland is missing; {HOW_TO_GET}")
        return
    differences: dict[Path, float] = {}
    unread, other_indices = 0, 0
    for path, found in paths.items():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                distance = difference_mm(path, found)
        except Exception:  # whatever the other program's reader raises
            unread += 1
            continue
        if distance is None:
            other_indices += 1
        else:
            differences[path] = distance
    parted = {path: d for path, d in differences.items() if not d <= TOLERANCE_MM}
    within = max((d for path, d in differences.items() if path not in parted), default=0.0)
    print(
        f"Optiland: {len(differences) - len(parted)} files with the same rays within {within:.2g} mm; "
        f"{other_indices} with other indices, {unread} not read"
    )
    for path, distance in parted.items():
        print(f"  other rays by {distance:.3g} mm: {path}")


def main() -> int:
    """Print the table and the comparison; 1 if a file failed without a message."""
    if len(sys.argv) < 2:
        print("left out: no folder of lens files given (python -m benchmarks.lens_files FOLDER [AGF ...])")
        return 0
    folder, *catalogs = map(Path, sys.argv[1:])
    outcomes: Counter[tuple[str, str]] = Counter()
    counts: Counter[str] = Counter()
    examples: dict[str, Path] = {}
    found: dict[Path, Imported] = {}
    failed = 0
    for path in find_vendor_files(folder)[0]:
        suffix = path.suffix.lower()
        try:
            found[path] = read(path, tuple(catalogs))
            outcomes[suffix, "read"] += 1
        except (InputError, MaterialError) as error:
            outcomes[suffix, "refused"] += 1
            for reason in reasons(error, path):
                counts[reason] += 1
                examples.setdefault(reason, path)
        except Exception:
            failed += 1
            outcomes[suffix, "failed"] += 1
            print(f"failed: {path}\n{traceback.format_exc()}")
    for (suffix, outcome), count in sorted(outcomes.items()):
        print(f"{suffix} {outcome}: {count}")
    for reason, count in counts.most_common(EXAMPLES):
        print(f"{count:5d}  {reason}  (as {examples[reason].relative_to(folder)})")
    zemax = {path: item for path, item in found.items() if path.suffix.lower() == ".zmx" and _refracts(item)}
    compare(zemax)
    return int(failed > 0)


def _refracts(found: Imported) -> bool:
    return len({float(n) for n in found.lens.indices(found.lens.wavelengths_um[0])}) > 1


if __name__ == "__main__":
    sys.exit(main())
