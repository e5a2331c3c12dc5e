"""Written Zemax and CODE V files, read by Optiland and ray-optics: the same rays through their lens and ours.

A cone of rays goes from the object through the design, and through what the other program makes of the file;
this says by how much they part at the first sensor plane. Left out is what those readers pass over or take
otherwise. Optiland (0.6.3): the order flag of coordinate breaks (a pose is a decenter or one tilt there),
CODE V's REV and its asphere terms, and model glasses without dispersion. ray-optics (0.9.8): coordinate
breaks of Zemax files, which it takes for decenters of CODE V, so that tilts turn the other way and the order
flag undoes them once more; its reading of CODE V's is compared with all parts of a pose at once.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import chdir
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.others import HOW_TO_GET
from lensdesign import Lens, Pose, load_design, trace
from lensdesign.files.codev import write_seq
from lensdesign.files.zemax import write_zmx

Array = NDArray[np.float64]

DESIGN = Path(__file__).parent.parent / "designs" / "paper_singlet.toml"
TOLERANCE_MM = 1e-9
RAYS = 1000


def ray_cone(lens: Lens) -> tuple[Array, Array]:
    """Rays from the axis of the object, and from the edge of the field, well within the aperture."""
    rng = np.random.default_rng(1)
    slopes = rng.uniform(-0.1, 0.1, (RAYS, 2))
    heights = np.where(np.arange(RAYS) % 2, lens.half_field_mm, 0.0)
    origins = np.column_stack([np.zeros(RAYS), heights, np.full(RAYS, lens.object_z_mm)])
    directions = np.column_stack([slopes, np.ones(RAYS)])
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def optiland_hits(path: Path, lens: Lens, origins: Array, directions: Array) -> Array:
    """Where Optiland's reading of a file has the rays end; shape (rays, 2)."""
    fileio = import_module("optiland.fileio")
    load = fileio.load_zemax_file if path.suffix == ".zmx" else fileio.load_codev_file
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optic: Any = load(str(path))
        columns = [np.ascontiguousarray(column) for column in (*origins.T, *directions.T)]
        columns += [np.ones(RAYS), np.full(RAYS, lens.wavelengths_um[0])]
        rays = import_module("optiland.rays").RealRays(*columns)
        # In a file with a pose Optiland puts the object at 0, in one without the front vertex.
        start = float(np.ravel(optic.surfaces[0].geometry.cs.position_in_gcs[2])[0])
        rays.z = rays.z - lens.object_z_mm + start
        optic.surfaces.trace(rays, skip=1)
    return np.column_stack([rays.x, rays.y])


def ray_optics_hits(path: Path, lens: Lens, origins: Array, directions: Array) -> Array:
    """Where ray-optics' reading of a file has the rays end, traced one by one; shape (rays, 2)."""
    # It leaves logs in the working folder.
    with warnings.catch_warnings(), chdir(path.parent):
        warnings.simplefilter("ignore")
        model: Any = import_module("rayoptics.gui.appcmds").open_model(path)
        one: Any = import_module("rayoptics.raytr.raytrace").trace
        wavelength_nm = 1e3 * lens.wavelengths_um[0]
        starts = origins * [1.0, 1.0, 0.0]  # from the vertex of the object
        rays = (one(model.seq_model, a, b, wavelength_nm)[0] for a, b in zip(starts, directions, strict=True))
        return np.array([ray[-1][0][:2] for ray in rays])


POSES = {
    "nominal": Pose(),
    "decentered": Pose(decenter_x_mm=0.1, decenter_y_mm=-0.2, despace_mm=0.05),
    "tilted about x": Pose(tilt_x_deg=0.5, pivot_z_mm=4.0),
    "tilted about y": Pose(tilt_y_deg=-0.7, pivot_z_mm=4.0),
    "decentered and tilted": Pose(0.1, -0.2, 0.05, 0.5, -0.7, 4.0),
}
NOMINAL = ("nominal",)
SIMPLE = tuple(POSES)[:-1]

Hits = Callable[[Path, Lens, Array, Array], Array]
PROGRAMS: dict[str, tuple[str, Hits, dict[str, tuple[str, ...]]]] = {
    "optiland": ("Optiland", optiland_hits, {".zmx": SIMPLE, ".seq": NOMINAL}),
    "rayoptics": ("ray-optics", ray_optics_hits, {".zmx": NOMINAL, ".seq": tuple(POSES)}),
}
"""By their packages: their names, how they trace, and the poses that they read as they are meant."""


def difference_mm(lens: Lens, pose: Pose, path: Path, hits: Hits) -> float:
    """Largest distance between our rays and those of another program at the first sensor plane."""
    (write_zmx if path.suffix == ".zmx" else write_seq)(lens, path, pose)
    origins, directions = ray_cone(lens)
    wavelength, plane = lens.wavelengths_um[0], lens.sensor_z_mm[0]
    ours = trace(lens, origins, directions, wavelength, pose, plane, clip=False).position[:, :2]
    return float(np.max(np.abs(hits(path, lens, origins, directions) - ours)))


def main() -> int:
    """Print, for each program, format and pose, by how much the rays part; 1 if that is too much."""
    lens = load_design(DESIGN)
    differences = [0.0]
    for package, (program, hits, formats) in PROGRAMS.items():
        if find_spec(package) is None:
            print(f"left out: {package} is missing; {HOW_TO_GET}")
            continue
        with tempfile.TemporaryDirectory() as folder:
            for suffix, names in formats.items():
                for name in names:
                    path = Path(folder) / f"lens{suffix}"
                    differences.append(difference_mm(lens, POSES[name], path, hits))
                    print(f"{program}, {suffix}, {name}: {RAYS} rays end within {differences[-1]:.2g} mm")
    return int(not max(differences) <= TOLERANCE_MM)


if __name__ == "__main__":
    sys.exit(main())
