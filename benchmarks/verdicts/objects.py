"""Objects of the benches: those of `wavesim image`, and some that it does not have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field, Grid
from wavesim.targets.patch import Patch, make_target

Array = NDArray[np.floating[Any]]

FINENESS = 4
"""Points along each side of a sample, over whose values a sample's transmission is the mean."""

LETTERS = {
    "A": (".###.", "#...#", "#...#", "#####", "#...#", "#...#", "#...#"),
    "E": ("#####", "#....", "#....", "####.", "#....", "#....", "#####"),
    "F": ("#####", "#....", "#....", "####.", "#....", "#....", "#...."),
    "L": ("#....", "#....", "#....", "#....", "#....", "#....", "#####"),
    "N": ("#...#", "##..#", "#.#.#", "#..##", "#...#", "#...#", "#...#"),
    "R": ("####.", "#...#", "#...#", "####.", "#.#..", "#..#.", "#...#"),
    "S": (".####", "#....", "#....", ".###.", "....#", "....#", "####."),
    "T": ("#####", "..#..", "..#..", "..#..", "..#..", "..#..", "..#.."),
}
WORDS = "TRANSFERLENSES"
STROKE_UM = 0.8
"""Width of a letter's strokes."""

BARS_UM = (0.9, 1.2, 1.6)
CELL_UM = 6.0
"""Widths of the dense chart's bars, and the side of a cell with bars of one width and orientation."""


def make_object(name: str, patch: Patch, numerical_aperture: float, seed: int) -> Field:
    """Return the transmission of an object on a patch.

    Parameters
    ----------
    name
        One of `OBJECTS`, or an object of :func:`wavesim.targets.patch.make_target`; "usaf dark" and
        "star dark" have a dark ground.
    patch
        The samples of the object plane.
    numerical_aperture
        For the band limit of tissue.
    seed
        For objects of random shape.
    """
    if name in OBJECTS:
        values = np.asarray(OBJECTS[name](patch.grid, np.random.default_rng(seed)), np.complex64)
        return Field(patch.grid, values, patch.wavelength_um)
    kind, _, ground = name.partition(" ")
    made = make_target(
        patch,
        kind,
        "dark" if ground == "dark" else "bright",
        numerical_aperture=numerical_aperture,
        seed=seed,
    )
    return made.transmission


def with_stop(transmission: Field, x_um: float, y_um: float, diameter_um: float) -> Field:
    """Return an object of which a field stop lets through a disc about a point."""
    x, y = _fine(transmission.grid)
    disc = _mean((x - x_um) ** 2 + (y - y_um) ** 2 <= (0.5 * diameter_um) ** 2)
    return transmission.with_values((transmission.values * disc).astype(np.complex64))


def _fine(grid: Grid) -> tuple[Array, Array]:
    """Return x as a row and y as a column, in um, of the points within the samples."""
    steps = (np.arange(FINENESS) + 0.5) / FINENESS - 0.5
    x, y = (1e3 * (at[:, None] + steps * grid.pitch_mm).ravel() for at in (grid.x_mm, grid.y_mm))
    return x[None, :], y[:, None]


def _mean(values: Any) -> Array:
    """Return the mean over each sample."""
    rows, columns = (count // FINENESS for count in values.shape)
    return np.asarray(values, float).reshape(rows, FINENESS, columns, FINENESS).mean((1, 3))


def _text(grid: Grid, _rng: np.random.Generator) -> Array:
    """Opaque letters in lines on a clear ground, all over the patch."""
    return 1.0 - _mean(_printed(*_fine(grid), STROKE_UM)[0])


def _letters(grid: Grid, _rng: np.random.Generator) -> Array:
    """Opaque letters in the middle line alone, with strokes of twice the width."""
    printed, line = _printed(*_fine(grid), 2.0 * STROKE_UM)
    return 1.0 - _mean(printed & (line == 0))


def _printed(x: Array, y: Array, stroke_um: float) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Return where letters are printed, and the number of the line, 0 in the middle."""
    column, row = (np.floor(at / stroke_um + 0.5 * high).astype(int) for at, high in ((x, 6), (y, 7)))
    letter = (column // 6 + 5 * (row // 9)) % len(WORDS)
    shapes = np.array([[[dot == "#" for dot in f"{line}."] for line in LETTERS[one]] for one in WORDS])
    printed = (row % 9 < 7) & shapes[letter, np.minimum(row % 9, 6), column % 6]
    return printed, row // 9


def _dense(grid: Grid, rng: np.random.Generator) -> Array:
    """Bars of several widths along x and y all over the patch, opaque on a clear ground."""
    x, y = _fine(grid)
    i, j = (np.floor(at / CELL_UM).astype(int) for at in (x, y))
    i, j = i - i.min(), j - j.min()
    cells = (int(j.max()) + 1, int(i.max()) + 1)
    width = rng.choice(BARS_UM, cells)[j, i]
    along = np.where(rng.integers(0, 2, cells)[j, i] == 1, x, y) % CELL_UM
    return 1.0 - _mean(along % (2.0 * width) < width)


def _sparse(grid: Grid, rng: np.random.Generator) -> Array:
    """Eight small opaque discs on a clear ground."""
    x, y = _fine(grid)
    reach = 0.6 * 1e3 * min(grid.half_widths_mm)
    covered = np.zeros((y.size, x.size), bool)
    for _ in range(8):
        (at_x, at_y), radius = rng.uniform(-reach, reach, 2), rng.uniform(0.6, 1.5)
        covered |= (x - at_x) ** 2 + (y - at_y) ** 2 <= radius**2
    return 1.0 - _mean(covered)


def _phantom(grid: Grid, rng: np.random.Generator) -> Any:
    """Soft absorbing spots, and soft phase spots in other places."""
    x, y = 1e3 * grid.x_mm[None, :], 1e3 * grid.y_mm[:, None]
    reach = 0.7 * 1e3 * min(grid.half_widths_mm)
    absorption, phase = np.zeros(grid.shape), np.zeros(grid.shape)
    for total, strength in ((absorption, 0.8), (phase, 1.2)):
        for _ in range(25):
            (at_x, at_y), width = rng.uniform(-reach, reach, 2), rng.uniform(0.8, 3.0)
            spot = np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / width**2)
            np.maximum(total, strength * rng.uniform(0.3, 1.0) * spot, out=total)
    return np.exp(-absorption + 1j * phase)


OBJECTS: Mapping[str, Callable[[Grid, np.random.Generator], Any]] = {
    "text": _text,
    "letters": _letters,
    "dense": _dense,
    "sparse": _sparse,
    "phantom": _phantom,
}
