"""Objects at three wavelengths at once, and heights of a film from two wavelengths.

    python -m benchmarks.colours [objects|planes|heights] [-o FOLDER]

Frames are those of the 1/64 twin, of a field stop of 24 or 30 um: 12 bits, a full well of 10,000 electrons
and 8,000 in the brightest pixel, read noise of 2 electrons, exposures of 1, 30 and 1000 times. They are made
with an engine of a tenth of the error, on a grid of more samples, with another model of the pixels than that
of the reconstruction. The objects of the wavelengths are independent of each other: two kinds of tissue, and
a star. With -o, pictures of results are written.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import FoundColours, Frame, image, reconstruct_colours
from wavesim.fields.field import Field
from wavesim.plots.frames import save
from wavesim.reconstruction.colour_figures import colours_figure, heights_figure
from wavesim.targets.colours import film
from wavesim.targets.patch import Patch, make_target, object_patch

WAVELENGTHS_UM = (0.45, 0.532, 0.635)
EXPOSURES = (1.0, 30.0, 1000.0)
FINE, COARSE = {"engine": "eikonal", "error": 0.005}, {"engine": "eikonal", "error": 0.05}
NEAREST_MM, FARTHEST_MM = 0.03125, 0.34375
LENS = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1 / 64)
STEP_REGION_MM, GROUND_MM = (0.002, -0.0025, 0.006, 0.004), (-0.008, 0.004, 0.006, 0.006)


def main() -> None:
    """Measure and print."""
    words = sys.argv[1:]
    folder = Path(words[words.index("-o") + 1]) if "-o" in words else None
    chosen = [name for name in ("objects", "planes", "heights") if name in words]
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    if not chosen or "objects" in chosen:
        print_table("three wavelengths at once: smallest correlation of a wavelength", _objects(folder))
    if not chosen or "planes" in chosen:
        print_table("smallest correlation of a wavelength with other numbers of planes", _other_planes())
    if not chosen or "heights" in chosen:
        print_table("step of a film, from 0.532 and 0.635 um, four planes each", _heights(folder))


def _planes(count: int) -> tuple[float, ...]:
    return tuple(float(one) for one in np.linspace(NEAREST_MM, FARTHEST_MM, count))


def _object(patch: Patch, kind: str) -> list[Field]:
    """Return independent objects at the wavelengths."""
    fields = []
    for name, seed, wavelength in zip(("tissue", "star", "tissue"), (1, 0, 2), WAVELENGTHS_UM, strict=True):
        aperture = LENS.object.numerical_aperture
        made = make_target(patch, name, numerical_aperture=aperture, seed=seed).transmission
        values = np.abs(made.values) if kind == "amplitude" else made.values
        fields.append(Field(patch.grid, values.astype(np.complex64), wavelength))
    return fields


def at_once(filters: str, kind: str, planes: int, seed: int = 0, patch_mm: float = 0.024) -> FoundColours:
    """Return what frames of three wavelengths at once give."""
    patch = object_patch(LENS, patch_mm, wavelength_um=min(WAVELENGTHS_UM))
    taken = image(
        LENS,
        _object(patch, kind),
        wavelengths_um=WAVELENGTHS_UM,
        colour_filters=filters,
        field_stop_mm=patch_mm,
        planes_mm=_planes(planes),
        exposures=EXPOSURES,
        seed=seed,
        **FINE,
    )
    start = {"start": "amplitude", "iterations": 250} if kind == "complex" else {}
    return reconstruct_colours(
        LENS, taken.frames, kind=kind, patch_mm=patch_mm, truth=taken.coloured, **COARSE, **start
    )


def _row(filters: str, kind: str, planes: int, target: float | None, folder: Path | None = None) -> Row:
    begin = time.perf_counter()
    found = at_once(filters, kind, planes)
    correlations = [one["object_correlation"] or 0.0 for one in found.truth]
    print(
        f"{filters} {kind} {planes} planes: correlations {', '.join(f'{one:.4f}' for one in correlations)}, "
        f"{found.over_noise:.2f} times the noise, {found.oversampling.ratio:.3g} measurements for each "
        f"unknown, {len(found.misfit)} iterations, {time.perf_counter() - begin:.0f} s",
        flush=True,
    )
    if folder is not None:
        truth = _object(found.patch, kind)
        drawn = colours_figure(
            found.transmissions, found.patch.inside, f"{filters}, {planes} planes", truth=truth
        )
        save(drawn, folder / f"{filters}_{kind}.png")
    return Row(f"{filters}, {kind}, {planes} planes", min(correlations), at_least=target)


def _objects(folder: Path | None) -> list[Row]:
    return [
        _row("monochrome", "amplitude", 4, 0.90, folder),
        _row("bayer", "amplitude", 4, 0.95, folder),
        _row("monochrome", "complex", 4, 0.90, folder),
        _row("bayer", "complex", 4, 0.95, folder),
    ]


def _other_planes() -> list[Row]:
    cases = (("amplitude", (1, 2, 3)), ("complex", (1, 2, 8, 12, 20)))
    return [
        _row(filters, kind, planes, None)
        for kind, counts in cases
        for planes in counts
        for filters in ("monochrome", "bayer")
    ]


def step_frames(step_um: float, wavelengths_um: Sequence[float], seed: int) -> tuple[Frame, ...]:
    """Return frames of a film with a step, one wavelength after the other."""
    patch = object_patch(LENS, 0.03, wavelength_um=min(wavelengths_um))
    x, y, width, height = 0.002, -0.0025, 0.008, 0.006
    shape = (np.abs(patch.grid.x_mm - x)[None, :] < 0.5 * width) & (
        np.abs(patch.grid.y_mm - y)[:, None] < 0.5 * height
    )
    frames = list[Frame]()
    for index, wavelength in enumerate(wavelengths_um):
        object_ = film(Field(patch.grid, shape.astype(float), wavelength), step_um, 1.5, wavelength)
        taken = image(
            LENS,
            object_,
            field_stop_mm=0.03,
            planes_mm=_planes(4),
            pixels=108,
            exposures=EXPOSURES,
            seed=100 * seed + index,
            **FINE,
        )
        frames += taken.frames
    return tuple(frames)


def step_found(frames: Sequence[Frame], kind: str = "complex") -> FoundColours:
    """Return the heights that frames of a step give."""
    return reconstruct_colours(
        LENS, frames, kind=kind, patch_mm=0.03, film_index=1.5, heights_um=(-1.0, 3.0), **COARSE
    )


def _heights(folder: Path | None) -> list[Row]:
    errors, scores = [], []
    for seed in range(10):
        found = step_found(step_frames(0.3, (0.532, 0.635), seed))
        step = found.height_between(STEP_REGION_MM, GROUND_MM)
        errors.append(1e3 * (step.height_um - 0.3))
        scores.append((step.height_um - 0.3) / step.deviation_um)
        print(f"seed {seed}: {1e3 * step.height_um:.2f} +- {1e3 * step.deviation_um:.2f} nm", flush=True)
        if folder is not None and seed == 0:
            assert found.heights is not None
            drawn = heights_figure(
                found.heights, found.transmissions[0], found.patch.inside, "step of 300 nm"
            )
            save(drawn, folder / "step.png")
    rows = [
        Row("largest error of a step of 300 nm, 10 seeds", max(map(abs, errors)), "nm", at_most=5.0),
        Row("mean error", float(np.mean(errors)), "nm"),
        Row("scatter of the seeds", float(np.std(errors, ddof=1)), "nm"),
        Row("error over stated deviation, rms", float(np.sqrt(np.mean(np.square(scores)))), at_most=1.5),
        Row("error over stated deviation, largest", float(np.max(np.abs(scores))), at_most=3.0),
    ]
    for kind in ("complex", "thickness"):
        found = step_found(step_frames(2.3, (0.532, 0.635), 0), kind)
        step = found.height_between(STEP_REGION_MM, GROUND_MM)
        rows.append(Row(f"step of 2300 nm, {kind}", 1e3 * step.height_um, "nm"))
        rows.append(Row("  stated deviation", 1e3 * step.deviation_um, "nm"))
    return rows


if __name__ == "__main__":
    main()
