"""Index and search of 10,000 vendors' lens files: generated singlets, cemented doublets and damaged files."""

from __future__ import annotations

import argparse
import math
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import StockSettings, find_stock_lenses, index_stock, load_specification
from lensdesign.optimization.specification_check import check_against

GLASSES = {"N-BK7": 1.5168, "N-SF11": 1.7847, "N-LASF9": 1.8503, "N-BAF10": 1.6700, "N-SF5": 1.6727}
DAMAGED = 0.02
"""Fraction of the files that are cut short."""


def main() -> None:
    """Generate the files, and measure the first index, an index without changes, and searches."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_vendor_files(folder, options.files)
        start = time.perf_counter()
        index = index_stock(folder, workers=options.workers)
        rows.append(Row(f"first index of {options.files} files", time.perf_counter() - start, "s"))
        rows.append(Row("files with a lens", len(index.lenses)))
        start = time.perf_counter()
        index = index_stock(folder, workers=options.workers)
        rows.append(Row("index without changes", time.perf_counter() - start, "s"))
        for spec in ("stock_pair_spec", "feasible_singlet_spec"):
            specification = load_specification(DESIGNS / f"{spec}.toml")
            start = time.perf_counter()
            found = find_stock_lenses(index, specification, StockSettings(), options.workers)
            seconds = time.perf_counter() - start
            rows.append(Row(f"search, {spec}", seconds, "s", at_most=60.0))
            rows.append(Row("  lenses that meet it", len(found.matches)))
            if any(not check_against(one.lens, specification).feasible for one in found.matches):
                raise SystemExit("void: a kept lens does not meet the specification")
            if found.matches:
                rows.append(Row("  smallest spread", found.matches[0].report.max_spread_deg, "deg"))
    print_table(f"{options.files} generated lens files, {options.workers} processes", rows)


def write_vendor_files(folder: Path, count: int, seed: int = 0) -> None:
    """Write lens files as vendors have them, in folders of 500 files."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        path = folder / f"series_{number // 500:02d}" / f"lens_{number:05d}.zmx"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = zmx_text(f"LENS {number}", *random_lens(rng))
        if rng.random() < DAMAGED:
            text = text[: rng.integers(50, len(text) // 2)]
        path.write_bytes(text.encode("utf-16"))


def random_lens(rng: np.random.Generator) -> tuple[float, list[tuple[float, float, str]]]:
    """Return clear semi-diameter, and curvature, distance and glass of each surface of a lens."""
    semi_mm = float(rng.choice([2.5, 5.0, 6.0, 9.0, 11.43, 12.7, 15.0, 19.0, 25.0]))
    focal_mm = float(np.exp(rng.uniform(math.log(1.2 * 2.0 * semi_mm), math.log(60.0 * semi_mm))))
    if rng.random() < 0.25:
        focal_mm = -focal_mm
    glass = str(rng.choice(list(GLASSES)))
    bending = float(rng.choice([0.0, 1.0, rng.uniform(-1.5, 1.5)]))  # biconvex, plano-convex, anything
    total = 1.0 / focal_mm / (GLASSES[glass] - 1.0)
    curvatures = [0.5 * total * (1.0 + bending), 0.5 * total * (bending - 1.0)]
    sags = [c * semi_mm**2 / (1.0 + math.sqrt(max(0.05, 1.0 - (c * semi_mm) ** 2))) for c in curvatures]
    thickness_mm = max(1.5, 2.0 + sags[0] - sags[1]) if focal_mm > 0.0 else 2.5
    surfaces = [(curvatures[0], thickness_mm, glass), (curvatures[1], abs(focal_mm), "")]
    if focal_mm > 0.0 and rng.random() < 0.2:  # cemented behind
        surfaces = [(curvatures[0], thickness_mm, glass), (curvatures[1], 2.5, "N-SF5")]
        surfaces.append((-0.1 * curvatures[0], focal_mm, ""))
    return semi_mm, surfaces


def zmx_text(name: str, semi_mm: float, surfaces: list[tuple[float, float, str]]) -> str:
    """Return a Zemax file with the object at infinity."""
    lines = ["VERS 171115", "MODE SEQ", f"NAME {name}", "UNIT MM X W X CM MR CPMM", f"ENPD {2.0 * semi_mm}"]
    lines += ["GCAT SCHOTT MISC", "FTYP 0 0 1 1 0 0 0 1", "XFLN 0", "YFLN 0", "WAVM 1 0.5876 1", "PWAV 1"]
    lines += ["SURF 0", "  CURV 0.0", "  DISZ INFINITY"]
    for number, (curvature, distance_mm, glass) in enumerate(surfaces, start=1):
        lines += [f"SURF {number}", *(["  STOP"] if number == 1 else []), "  TYPE STANDARD"]
        lines += [f"  CURV {curvature!r} 0 0 0 0", f"  DISZ {distance_mm!r}"]
        lines += [f"  GLAS {glass} 0 0 1.5 50 0 0 0 0 0 0"] if glass else []
        lines += [f'  DIAM {semi_mm!r} 1 0 0 1 ""']
    lines += [f"SURF {len(surfaces) + 1}", "  CURV 0.0", "  DISZ 0"]
    return "\r\n".join([*lines, "TOL TOFF   0   0", "MNUM 1 1", ""])


if __name__ == "__main__":
    main()
