"""Fourier transforms of a sensor's plane along its rows, then along its columns and back, beside SciPy's."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from benchmarks.timing import Row, interleaved, print_table
from wavesim.runtime.fourier.lanes import LANES
from wavesim.runtime.fourier.panels import Panels

SIDES = (6144, 7000)
"""A number whose factors are small, and one that takes a 7."""

ROUNDS, AT_ONCE = 5, 1024
"""Rows and columns of the plane that are transformed."""

FASTER = {"rows": 0.7, "columns": 2.3, "both": 1.4}
"""Over SciPy, at least; rows are gathered out of panels and put back."""


def main() -> None:
    """Measure and print, in one thread."""
    for side in SIDES:
        title = f"{AT_ONCE} rows and columns of {side}^2 samples, complex64, {LANES} at a time, one thread"
        print_table(title, compared(side))


def compared(side: int) -> list[Row]:
    """Processor time of a sample, of either, and the errors of one row."""
    rng = np.random.default_rng(2)
    plane = rng.standard_normal((side, 2 * side), np.float32).view(np.complex64)
    panels, room = Panels((side, side), np.complex64), np.empty((LANES, side), np.complex64)
    for first in range(0, side, LANES):
        panels.put_rows(plane[first : first + LANES], first)
    work = {
        "rows, SciPy": partial(rows_by_scipy, plane),
        "rows, here": partial(rows_here, panels, room),
        "columns, SciPy": partial(columns_by_scipy, plane),
        "columns, here": partial(columns_here, panels),
    }
    row = plane[side // 2].copy()
    exact, found = np.fft.fft(row.astype(complex)), error_here(row)
    times = interleaved(work, ROUNDS)
    took = {name: 1e9 * min(timing.cpu) / (2 * AT_ONCE * side) for name, timing in times.items()}
    rows = [Row(f"{name}, there and back: a sample and transform", took[name], "ns") for name in work]
    for who in ("SciPy", "here"):
        took[f"both, {who}"] = took[f"rows, {who}"] + took[f"columns, {who}"]
    for axis, least in FASTER.items():
        ratio = took[f"{axis}, SciPy"] / took[f"{axis}, here"]
        rows.append(Row(f"{axis}: times as fast", ratio, at_least=least))
    scipys = np.asarray(scipy.fft.fft(row))
    return rows + [
        Row(f"relative error of a row, {name}", float(np.linalg.norm(one - exact) / np.linalg.norm(exact)))
        for name, one in (("SciPy", scipys), ("here", found))
    ]


def rows_by_scipy(plane: NDArray[Any]) -> None:
    """There and back, some rows at a time."""
    for first in range(0, AT_ONCE, LANES):
        part = plane[first : first + LANES]
        plane[first : first + LANES] = scipy.fft.ifft(scipy.fft.fft(part, axis=1), axis=1, overwrite_x=True)


def rows_here(panels: Panels, room: NDArray[Any]) -> None:
    """The same, out of panels and into them; divided by the number of samples."""
    for first in range(0, AT_ONCE, LANES):
        rows = panels.take_rows(first, room)
        numbers = rows.view(np.float32)
        numbers *= np.float32(1.0 / panels.shape[1])
        panels.put_rows(rows, first)


def columns_by_scipy(plane: NDArray[Any]) -> None:
    """There and back, some columns at a time."""
    for first in range(0, AT_ONCE, LANES):
        part = plane[:, first : first + LANES]
        plane[:, first : first + LANES] = scipy.fft.ifft(
            scipy.fft.fft(part, axis=0), axis=0, overwrite_x=True
        )


def columns_here(panels: Panels) -> None:
    """The same; divided by the number of samples."""
    for panel in panels.values[: AT_ONCE // LANES]:
        panels.along_columns(panel, panel, inverse=False)
        panels.along_columns(panel, panel, inverse=True)
        panel *= np.float32(1.0 / panels.shape[0])


def error_here(row: NDArray[Any]) -> NDArray[Any]:
    """One row's transform."""
    panels = Panels((1, len(row)), row.dtype)
    panels.put_rows(row[None], 0)
    return np.asarray((panels.values[:, 0, 0] + 1j * panels.values[:, 0, 1]).ravel()[: len(row)])


if __name__ == "__main__":
    main()
