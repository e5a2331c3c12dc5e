"""Charts and photographs on perfect benches: the amplitude object that comes back, and the verdict.

Twelve charts and twelve standard grey pictures of scikit-image are imaged on a twin of the paper's lens and
reconstructed from the frames with the default settings. A perfect bench must end with 0. The clipped fraction
is that of the samples within the field stop with a transmission of 1 (true object in brackets). With --frames
the frames stay in a folder. This file also runs as a script against another version of the toolkit, from the
same folder of frames::

    PYTHONPATH=OTHER python benchmarks/perfect_benches.py --frames FOLDER
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

CHARTS = (
    "usaf",
    "usaf dark",
    "star",
    "star dark",
    "text",
    "letters",
    "dense",
    "sparse",
    "F",
    "grating",
    "checks",
    "steps",
)
"""Names of the charts: built-in ones, those of the verdicts' benchmark, and four more."""

PICTURES = (
    "astronaut",
    "brick",
    "camera",
    "cat",
    "clock",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "moon",
    "page",
    "text picture",
)
"""Names of the photographs."""

FRAME_SETTINGS = (
    "pixel_pitch_um",
    "plane_distance_mm",
    "wavelength_um",
    "exposure",
    "bits",
    "offset_counts",
    "gain_electrons_per_count",
    "read_noise_electrons",
)
"""Settings of frames that all versions know."""

BENCHES = {"1/32": (1 / 32, 0.05), "1/16": (1 / 16, 0.19)}
"""Size of the lens over that of the paper's, and side of the patch.

The larger bench is that of the demo. On the smaller one, planes have little diversity.
"""


def picture(name: str) -> np.ndarray:
    """Return a grey picture of scikit-image with values from 0 to 1."""
    from skimage import color, data

    values = getattr(data, {"text picture": "text"}.get(name, name))()
    return np.asarray(color.rgb2gray(values) if values.ndim == 3 else values / 255.0, float)


def chart(name: str, patch: Any, patch_mm: float, numerical_aperture: float) -> np.ndarray:
    """Return the transmission of a chart on the samples of a patch."""
    from benchmarks.verdicts.objects import make_object

    half_mm = 0.5 * patch_mm
    y, x = patch.grid.y_mm[:, None] / half_mm, patch.grid.x_mm / half_mm
    if name == "F":
        stem = (abs(x + 0.2) < 0.08) & (abs(y) < 0.5)
        upper, lower = (abs(y - 0.42) < 0.08) & (x < 0.35), (abs(y) < 0.08) & (x < 0.2)
        return np.where(stem | (x > -0.2) & (upper | lower), 1.0, 0.0)
    if name == "grating":
        return 0.5 + 0.5 * np.sign(np.sin(2.0 * np.pi * 9.0 * (x + 0.3 * y)))
    if name == "checks":
        return 1.0 * ((np.floor(6.0 * x) + np.floor(6.0 * y)) % 2 == 0)
    if name == "steps":
        return np.clip(np.floor(4.0 * (x + 1.0)) / 7.0, 0.0, 1.0) * np.ones_like(y)
    return np.asarray(make_object(name, patch, numerical_aperture, 0).values)


def make_frames(folder: Path, name: str, seed: int, bench: str) -> None:
    """Record and write the frames of an object, and the object itself."""

    from skimage.transform import resize

    from benchmarks.timing import DESIGNS
    from lensdesign import load_design, save_design, scaled
    from wavesim import Field, image
    from wavesim.fields.files import write_field
    from wavesim.scene.settings import PatchSettings
    from wavesim.targets.patch import OBJECT_FILE, lit_patch

    folder.mkdir(parents=True, exist_ok=True)
    scale, patch_mm = BENCHES[bench]
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), scale)
    patch, _ = lit_patch(lens, PatchSettings(patch_mm=patch_mm), lens.wavelengths_um[0])
    if name in PICTURES:
        values = picture(name)
        side = min(values.shape)
        top, left = ((length - side) // 2 for length in values.shape)
        values = values[top : top + side, left : left + side]
        values = resize(values, patch.grid.shape, anti_aliasing=True)[::-1]
    else:
        values = chart(name, patch, patch_mm, lens.object.numerical_aperture)
    thing = Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)
    imaged = image(lens, thing, field_stop_mm=patch.field_stop_mm, seed=seed)
    for number, frame in enumerate(imaged.frames, start=1):
        np.savez(folder / f"frame_{number}.npz", counts=frame.counts)
        values = {name: getattr(frame.settings, name) for name in FRAME_SETTINGS}
        (folder / f"frame_{number}.json").write_text(json.dumps(values))
    write_field(thing, folder / OBJECT_FILE, field_stop_mm=patch.field_stop_mm)
    save_design(lens, folder / "lens.toml")


def result(folder: Path, name: str, seed: int, bench: str) -> dict[str, Any]:
    """Reconstruct frames with default settings, and return the figures of the result."""
    from lensdesign import load_design
    from wavesim import Frame, FrameSettings, reconstruct_frames

    lens = load_design(folder / "lens.toml")
    frames = [
        Frame(np.load(path)["counts"], FrameSettings(**json.loads(path.with_suffix(".json").read_text())))
        for path in sorted(folder.glob("frame_*.npz"))
    ]
    begun = process_time()
    found = reconstruct_frames(lens, frames, kind="amplitude", patch_mm=BENCHES[bench][1], truth=folder)
    seconds = process_time() - begun
    amplitude, true = (np.abs(field.values[found.inside]) for field in (found.transmission, found.true))
    return {
        "name": name,
        "seed": seed,
        "correlation": found.truth["object_correlation"],
        "ssim": found.truth["ssim"],
        "psnr_db": found.truth["psnr_db"],
        "status": 0 if found.verdict.explained else 1,
        "cause": found.verdict.cause,
        "words": found.verdict.words,
        "clipped": float(np.mean(amplitude > 1.0 - 1e-5)),
        "true_clipped": float(np.mean(true > 1.0 - 1e-5)),
        "scale": found.of_method["scale"],
        "iterations": len(found.curve),
        "seconds": seconds,
    }


def table_row(one: dict[str, Any]) -> str:
    """Return a result as a row of a table."""
    figures = [f"{one['correlation']:.4f}", f"{one['ssim']:.3f}", f"{one['psnr_db']:.1f}"]
    figures += [f"{one['clipped']:.3f} ({one['true_clipped']:.3f})", f"{one['scale']:.3f}"]
    figures += [str(one["iterations"]), f"{one['seconds']:.1f}", f"{one['status']} {one['cause']}"]
    return f"| {one['name']} | {one['seed']} | {' | '.join(figures)} |"


def main(arguments: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Reconstruct all objects, print a table, and return the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="charts and photographs; default: all")
    parser.add_argument("--bench", choices=BENCHES, default="1/32", help="size of the lens over the paper's")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds of the noise")
    parser.add_argument("--frames", type=Path, help="folder that keeps recorded frames for the next run")
    parser.add_argument("--json", type=Path, help="file to which the results are written, too")
    given = parser.parse_args(arguments)
    results = []
    with TemporaryDirectory() as temporary:
        heads = ("object", "seed", "correlation", "SSIM", "PSNR (dB)", "clipped (true)", "scale")
        heads += ("iterations", "seconds", "status")
        print(f"| {' | '.join(heads)} |\n| {' | '.join('---' for _ in heads)} |", flush=True)
        for name in given.names or (*CHARTS, *PICTURES):
            for seed in range(given.seeds):
                own = f"{name.replace(' ', '_')}_{seed}_{given.bench.replace('/', '_')}"
                folder = (given.frames or Path(temporary)) / own
                if not (folder / "lens.toml").exists():
                    make_frames(folder, name, seed, given.bench)
                results.append(result(folder, name, seed, given.bench))
                print(table_row(results[-1]), flush=True)
                if given.json is not None:
                    given.json.write_text(json.dumps(results, indent=1))
    for group, names in (("charts", CHARTS), ("photographs", PICTURES)):
        own = [one for one in results if one["name"] in names]
        if own:
            keys = ("correlation", "ssim", "psnr_db", "seconds")
            means = ", ".join(f"{key} {np.mean([one[key] for one in own]):.4f}" for key in keys)
            right = sum(one["status"] == 0 for one in own)
            print(f"{group}: {right} of {len(own)} end with 0; mean {means}")
    return results


if __name__ == "__main__":
    main()
