"""Nonuniform Fourier transform of one tile of the whole field, all terms at once, beside FINUFFT's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Row, interleaved, print_table
from wavesim.runtime.fourier.nonuniform import Precision, fourier_plan
from wavesim.runtime.fourier.terms import TermsTransform

SAMPLES, TERMS, ERROR = 294, (1, 4, 8), 5e-4
ACROSS, REACH = 499, 2.6
"""Samples of the tile's own grid along a side, and the angle of its footprint's edge, as at error 0.01."""

ROUNDS = 15
FASTER = {4: 3.0, 8: 3.0}
"""Over FINUFFT, at least."""


def main() -> None:
    """Measure and print, in one thread."""
    points = footprint()
    for terms in TERMS:
        for kind in (2, 1):
            print_table(
                f"Type {kind}, {terms} terms of {SAMPLES} x {SAMPLES} modes to {len(points[0])} points",
                compared(kind, terms, points),
            )


def footprint() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Angles of points row by row within a disc, a little bent as behind a lens."""
    along = np.linspace(-1.0, 1.0, ACROSS)
    y, x = np.meshgrid(along, along, indexing="ij")
    inside = y**2 + x**2 < 1.0
    bent = 1.0 + 0.03 * (y + x)[inside]
    rows, columns = ((REACH * a[inside] * bent).astype(np.float32) for a in (y, x))
    return rows, columns


def compared(kind: int, terms: int, points: tuple[NDArray[np.float32], ...]) -> list[Row]:
    """Processor time and error of both."""
    shape, rng = (terms, SAMPLES, SAMPLES), np.random.default_rng(1)
    size = shape if kind == 2 else (terms, len(points[0]))
    data = (rng.normal(size=size) + 1j * rng.normal(size=size)).astype(np.complex64)
    data = data if terms > 1 else data[0]
    single, double = (Precision(np.dtype(t), e, e) for t, e in ((np.complex64, ERROR), (np.complex128, 1e-9)))
    exactly = fourier_plan(kind, shape, double)
    exactly.setpts(*(a.astype(float) for a in points))
    exact = exactly.execute(data.astype(complex))
    plans = {"FINUFFT": fourier_plan(kind, shape, single), "here": TermsTransform(kind, shape, ERROR)}

    def use(name: str) -> NDArray[np.complex64]:
        plans[name].setpts(*points)
        return np.asarray(plans[name].execute(data))

    times = interleaved({"FINUFFT": lambda: use("FINUFFT"), "here": lambda: use("here")}, ROUNDS)
    least = {name: min(timing.cpu) for name, timing in times.items()}
    rows = [Row(f"{name}, processor time", 1e3 * least[name], "ms") for name in plans]
    rows.append(Row("times as fast", least["FINUFFT"] / least["here"], at_least=FASTER.get(terms)))
    return rows + [
        Row(
            f"{name}, relative error",
            float(np.linalg.norm(use(name) - exact) / np.linalg.norm(exact)),
            at_most=ERROR,
        )
        for name in plans
    ]


if __name__ == "__main__":
    main()
