"""Files of a search for stock lenses: a design for each lens, a table of them, and a list of unused files."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.input_files import CATALOG_BYTES, read_input
from lensdesign.common.text import finite_or_none, safe_cell
from lensdesign.files.design import save_design
from lensdesign.lens.lens import Lens
from lensdesign.stock.search import StockMatch, StockResult

TABLE, LEFT_OUT, NEAREST = "stock.csv", "left_out.csv", "nearest.toml"
_DESIGN = re.compile(r"stock_\d+\.toml")


@dataclass(frozen=True)
class StockFiles:
    """Files that a search has written.

    Attributes
    ----------
    designs : tuple of Path
        Designs in the order of the matches; or that of the nearest miss alone.
    table : Path
        Table of the designs.
    left_out : Path or None
        List of the files that were not used, with the reasons; None if all were used.
    """

    designs: tuple[Path, ...]
    table: Path
    left_out: Path | None


def write_stock_files(result: StockResult, folder: Path) -> StockFiles:
    """Write the designs and tables of a search to a folder; files of an earlier search are replaced.

    Glass catalogues that a lens needs are copied to the folder, so that the designs can be read anywhere.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shown = result.matches or ((result.nearest,) if result.nearest else ())
    names = [f"stock_{i:02d}.toml" for i in range(1, len(result.matches) + 1)] or [NEAREST] * len(shown)
    designs = tuple(folder / name for name in names)
    for match, path in zip(shown, designs, strict=True):
        save_design(_with_copied_catalogs(match.lens, folder), path)
    for old in folder.iterdir():
        if (_DESIGN.fullmatch(old.name) or old.name == NEAREST) and old not in designs:
            old.unlink()
    rows = [stock_row(match, path.name) for match, path in zip(shown, designs, strict=True)]
    _write_csv(folder / TABLE, list(rows[0]) if rows else ["design"], (row.values() for row in rows))
    left_out = folder / LEFT_OUT
    if result.left_out:
        _write_csv(left_out, ["file", "reason"], sorted(result.left_out.items()))
    else:
        left_out.unlink(missing_ok=True)
    return StockFiles(designs, folder / TABLE, left_out if result.left_out else None)


def stock_row(match: StockMatch, design: str) -> dict[str, Any]:
    """Return the values of a lens for a table, by the names of the columns."""
    parts = match.arrangement.parts
    lens, report, built = match.lens, match.report, match.built
    return {
        "design": design,
        "lenses": match.arrangement.name,
        "files": "; ".join(part.lens.files[0] for part in parts),
        "equal_files": "; ".join(name for part in parts for name in part.lens.files[1:]),
        "spread_deg": report.max_spread_deg,
        "track_mm": lens.track_mm,
        "working_distance_mm": lens.object.working_distance_mm,
        "spacing_mm": match.spacing_mm,
        "thickness_mm": lens.exit_vertex_z_mm,
        "efl_mm": report.efl_mm,
        "footprint_radius_mm": max(report.footprint_radius_mm),
        "meets_specification": report.feasible,
        "predicted_yield": None if match.predicted_yield is None else finite_or_none(match.predicted_yield),
        "yield": None if built is None else built.good,
        "yield_low": None if built is None else built.low,
        "yield_high": None if built is None else built.high,
    }


def _with_copied_catalogs(lens: Lens, folder: Path) -> Lens:
    copies = []
    for catalog in lens.glass_catalogs:
        copy = folder.resolve() / catalog.name
        if copy != catalog:
            data = read_input(catalog, CATALOG_BYTES)
            with atomic_path(copy) as temporary:
                temporary.write_bytes(data)
        copies.append(copy)
    return lens.replaced(glass_catalogs=tuple(copies)) if copies else lens


def _write_csv(path: Path, heads: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(heads)
        for row in rows:
            table.writerow([_cell(value) for value in row])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return f"{value:.9g}" if isinstance(value, float) else safe_cell(str(value))
