"""Layers of an object: correlation against the oversampling ratio, and against the distance of the layers.

Frames are made with other models than those that reconstruct: an independent padded angular spectrum between
the layers, a finer eikonal engine on finer samples, an exact angular spectrum in double precision between the
planes, means of sub-samples on the pixels, Poisson and normal noise, and rounding to 12 bits. Every plane is
recorded with three exposures.

Two sorts of layers are tried: `sparse` ones have discs on a bright ground, and `dense` ones have random
values everywhere, band-limited to two thirds of what the lens transmits. Correlations are those of
`reconstruct_layers`, both sides as the lens transmits them.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.independent_frames import independent_frames, independent_intensities
from benchmarks.timing import DESIGNS
from lensdesign import Lens, load_design, scaled
from lensdesign.analysis.oversampling import ObjectKind
from wavesim.fields.field import Field
from wavesim.plots.frames import save
from wavesim.plots.objects import layers_figure
from wavesim.reconstruction.layer_reconstruction import FoundLayers, reconstruct_layers
from wavesim.scene.settings import PatchSettings
from wavesim.sensor.frames import Frame
from wavesim.sensor.pixels.maps import PixelMaps
from wavesim.targets.patch import Patch, lit, object_patch

TWIN, PATCH_MM, STOP_MM = 64, 0.03, 0.024
"""Inverse scale of the paper's lens, side of the patch, and diameter of the field stop."""

EXPOSURES = (1.0, 30.0, 1000.0)
PADDED = 512
"""Samples of the padded window between the layers."""

BANDS_PER_UM = ((0.03, 0.06), (0.06, 0.12), (0.12, 0.25), (0.25, 0.5), (0.5, 0.94))
"""Bands of spatial frequency in which layers are compared."""


class Case(NamedTuple):
    """Layers of a kind and a sort, the number of planes that record them, and the fraction of used pixels."""

    kind: ObjectKind
    sort: str
    layers_um: tuple[float, ...]
    planes: int
    stop_mm: float = STOP_MM
    used_pixels: float = 1.0


TWO_UM, THREE_UM = (-20.0, 0.0), (-40.0, -20.0, 0.0)

RATIO_CASES = tuple(
    Case(kind, sort, layers_um, planes)
    for kind, sort, layers_um, plane_counts in (
        ("amplitude", "dense", TWO_UM, (1, 2, 4)),
        ("phase", "dense", TWO_UM, (1, 2, 4)),
        ("amplitude", "sparse", TWO_UM, (1, 2)),
        ("phase", "sparse", TWO_UM, (1, 2)),
        ("amplitude", "dense", THREE_UM, (4,)),
        ("amplitude", "sparse", THREE_UM, (4,)),
        ("complex", "dense", TWO_UM, (4,)),
        ("complex", "sparse", TWO_UM, (4,)),
    )
    for planes in plane_counts
) + tuple(Case("amplitude", "dense", TWO_UM, 2, used_pixels=used) for used in (0.5, 0.4))
DISTANCE_CASES = tuple(Case("amplitude", "sparse", (-um, 0.0), 2) for um in (4.0, 8.0, 16.0, 20.0, 32.0))


@cache
def bench(stop_mm: float) -> tuple[Lens, Patch]:
    """Return the twin and the patch of its object."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / TWIN)
    return lens, object_patch(lens, PATCH_MM, stop_mm)


def true_layer(patch: Patch, kind: ObjectKind, sort: str, seed: int) -> NDArray[np.complexfloating]:
    """Return a layer with values from 0 to 1, or phases up to 1.5 rad, or both."""
    rng, grid = np.random.default_rng(seed), patch.grid
    if sort == "sparse":
        depth = np.zeros(grid.shape)
        for _ in range(14):
            x, y = 0.42 * patch.field_stop_mm * rng.uniform(-1.0, 1.0, 2)
            disc = np.hypot(grid.x_mm - x, grid.y_mm[:, None] - y) < rng.uniform(6e-4, 2e-3)
            depth[disc] = rng.uniform(0.4, 1.0)
        amplitude, phase = 1.0 - depth, 1.5 * depth
    else:
        frequency = np.fft.fftfreq(grid.shape[0], 1e3 * grid.pitch_mm)
        low = np.hypot(frequency[:, None], frequency) < 0.6
        random = [np.fft.ifft2(np.fft.fft2(rng.standard_normal(grid.shape)) * low).real for _ in range(2)]
        amplitude, phase = (one / one.std() for one in random)
        amplitude, phase = np.clip(0.6 + 0.2 * amplitude, 0.0, 1.0), 0.5 * phase
    values = {"amplitude": amplitude, "phase": np.exp(1j * phase), "complex": amplitude * np.exp(1j * phase)}
    return np.asarray(values[kind], complex)


def field_behind(patch: Patch, layers_um: Sequence[float], layers: Sequence[NDArray]) -> Field:
    """Return the field behind the layers in the object plane, by a padded angular spectrum."""
    rows, columns = patch.grid.shape
    frequency = np.fft.fftfreq(PADDED, 1e3 * patch.grid.pitch_mm)
    axial_squared = patch.wavelength_um**-2 - frequency[:, None] ** 2 - frequency**2
    axial = np.sqrt(np.maximum(axial_squared, 0.0))
    stop = lit(patch, PatchSettings()).values.real.astype(float)
    field = np.ones(patch.grid.shape, complex)
    for layer, start_um, end_um in zip(layers, layers_um, [*layers_um[1:], 0.0], strict=True):
        padded = np.zeros((PADDED, PADDED), complex)
        padded[:rows, :columns] = field * layer * stop
        factor = np.where(axial_squared > 0.0, np.exp(2j * np.pi * axial * (end_um - start_um)), 0.0)
        field = np.fft.ifft2(np.fft.fft2(padded) * factor)[:rows, :columns]
    return Field(patch.grid, field, patch.wavelength_um)


def recorded_frames(
    lens: Lens, patch: Patch, behind: Field, planes_mm: Sequence[float], seed: int
) -> list[Frame]:
    """Return frames of the field behind an object, with noise."""
    intensities = independent_intensities(lens, patch, behind, planes_mm, error=0.005)
    return independent_frames(
        lens, patch.wavelength_um, planes_mm, intensities, exposures=EXPOSURES, seed=seed
    )


def outcome(case: Case, seed: int = 0) -> tuple[FoundLayers, list[NDArray]]:
    """Record and reconstruct the layers of a case; returns the result and the true layers."""
    lens, patch = bench(case.stop_mm)
    near, far = lens.sensor.plane_distances_mm
    planes_mm = [0.5 * (near + far)] if case.planes == 1 else np.linspace(near, far, case.planes).tolist()
    layers = [
        true_layer(patch, case.kind, case.sort, 10 * seed + index)
        for index in range(1, len(case.layers_um) + 1)
    ]
    frames = recorded_frames(lens, patch, field_behind(patch, case.layers_um, layers), planes_mm, seed)
    if case.used_pixels < 1.0:
        rng = np.random.default_rng(seed)
        shape = frames[0].counts.shape
        masks = {plane: PixelMaps(bad=rng.random(shape) >= case.used_pixels) for plane in planes_mm}
        frames = [replace(frame, maps=masks[frame.settings.plane_distance_mm]) for frame in frames]
    true = [Field(patch.grid, layer * patch.inside, patch.wavelength_um) for layer in layers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = reconstruct_layers(
            lens,
            frames,
            case.layers_um,
            kind=case.kind,
            patch_mm=PATCH_MM,
            field_stop_mm=case.stop_mm,
            engine="eikonal",
            error=0.02,
            truth=true,
            undetermined=True,
        )
    return found, layers


def correlation_in_band(
    found: NDArray, true: NDArray, inside: NDArray, pitch_um: float, band: tuple
) -> float:
    """Return the correlation of two layers within a band of spatial frequencies, without their means."""
    frequency = np.fft.fftfreq(found.shape[0], pitch_um)
    radius = np.hypot(frequency[:, None], frequency)
    chosen = (radius >= band[0]) & (radius < band[1])
    parts = []
    for values in (found, true):
        varying = np.where(inside, values - values[inside].mean(), 0.0)
        parts.append(np.fft.ifft2(np.fft.fft2(varying) * chosen)[inside])
    return float(abs(np.vdot(*parts)) / (np.linalg.norm(parts[0]) * np.linalg.norm(parts[1])))


def _row(case: Case, found: FoundLayers, seconds: float) -> str:
    correlations = ", ".join(f"{one['object_correlation']:.3f}" for one in found.truth)
    layers = ", ".join(f"{one:g}" for one in case.layers_um)
    values = (
        case.kind,
        case.sort,
        layers,
        case.planes,
        f"{case.used_pixels:g}",
        f"{found.oversampling.ratio:.2f}",
        correlations,
        f"{found.verdict.over_noise:.2f}",
        len(found.curve),
        f"{seconds:.0f}",
    )
    return f"| {' | '.join(map(str, values))} |"


def draw(output: Path) -> None:
    """Draw two sparse amplitude layers, found from two planes, next to the true ones."""
    case = next(case for case in RATIO_CASES if case[:2] == ("amplitude", "sparse") and case.planes == 2)
    found, layers = outcome(case)
    true = [one.with_values(layer) for one, layer in zip(found.transmissions, layers, strict=True)]
    save(layers_figure(case.layers_um, found.transmissions, found.inside, truth=true), output, dpi=100)


def main() -> None:
    """Print both tables, or draw a picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="words of cases, such as dense,phase,2 planes")
    parser.add_argument("-o", "--output", type=Path, help="draw two sparse amplitude layers, nothing else")
    given = parser.parse_args()
    if given.output is not None:
        draw(given.output)
        return
    chosen = [word for word in given.only.split(",") if word]
    columns = ("kind", "sort", "layers (µm)", "planes", "used pixels", "ratio", "correlations", "over noise")
    print("| " + " | ".join((*columns, "iterations", "seconds")) + " |")
    print("| --- |" + " --- |" * (len(columns) + 1))
    for case in RATIO_CASES:
        names = {
            case.kind,
            case.sort,
            f"{len(case.layers_um)} layers",
            f"{case.planes} planes",
            f"{case.used_pixels:g} used",
        }
        if set(chosen) <= names:
            begun = perf_counter()
            found, _ = outcome(case)
            print(_row(case, found, perf_counter() - begun), flush=True)
    if chosen and chosen != ["distances"]:
        return
    print("\ncorrelation by spatial frequency (per µm), first and second layer")
    print("| distance (µm) | whole | " + " | ".join(f"{a:g} to {b:g}" for a, b in BANDS_PER_UM) + " |")
    print("| --- | --- |" + " --- |" * len(BANDS_PER_UM))
    for case in DISTANCE_CASES:
        found, layers = outcome(case)
        whole = ", ".join(f"{one['object_correlation']:.3f}" for one in found.truth)
        pitch_um = 1e3 * found.patch.grid.pitch_mm
        bands = " | ".join(
            ", ".join(
                f"{correlation_in_band(one.values, layer, found.inside, pitch_um, band):.3f}"
                for one, layer in zip(found.transmissions, layers, strict=True)
            )
            for band in BANDS_PER_UM
        )
        print(f"| {-case.layers_um[0]:g} | {whole} | {bands} |", flush=True)


if __name__ == "__main__":
    main()
