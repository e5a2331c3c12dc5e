"""Bounds of verdicts on photographs behind careful benches, against the true correlations.

    python -m benchmarks.photographs [--pictures N] [--benches N] [--kind amplitude|complex]

Each case is one of the pictures that scikit-image ships, on a bench whose small errors are drawn at random.
The bench is calibrated from the frames, and the object reconstructed. The verdict states a correlation with
the true object that is reached with a probability of 95 %. Frames come from the engine of the reconstruction,
so that noise and bench are the only errors.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import Pose, load_design, scaled
from lensdesign.lens.lens import Lens
from wavesim import calibrate_frames, image, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.system_state import SystemState
from wavesim.targets.patch import object_patch

PICTURES = ("camera", "moon", "coins", "astronaut", "page", "text", "chelsea", "coffee", "brick", "grass")
PICTURES += ("gravel", "rocket")
SETTINGS: dict[str, Any] = {"engine": "eikonal", "error": 0.1}
SCALE, PATCH_MM = 1 / 24, 0.12
"""Size of the lens over that of the paper's, the smallest with enough diversity, and side of the patch."""


class Outcome(NamedTuple):
    """Correlation with the true object, its bound, both without low orders, and whether it is explained.

    An amplitude object has no correlation without low orders.
    """

    correlation: float
    bound: float
    without_low_orders: float | None
    bound_without_low_orders: float
    is_explained: bool


def picture(name: str, shape: tuple[int, int]) -> np.ndarray:
    """Return the grey middle of a picture on the samples of a patch, from 0 to 1."""
    import skimage.data
    from PIL import Image

    values = np.asarray(getattr(skimage.data, name)())
    opened = Image.fromarray(values).convert("L")
    side = min(opened.size)
    left, top = ((count - side) // 2 for count in opened.size)
    square = opened.crop((left, top, left + side, top + side))
    resized = square.resize((shape[1], shape[0]), Image.Resampling.LANCZOS)
    return np.asarray(resized, float)[::-1] / 255.0


def careful_bench(seed: int) -> SystemState:
    """Return a bench with small random errors of light, mounting and camera."""
    random = np.random.default_rng(seed)

    def pair(deviation: float) -> tuple[float, float]:
        x, y = deviation * random.standard_normal(2)
        return float(x), float(y)

    (x_mm, y_mm), (tilt_x, tilt_y), ratios, bends = pair(5e-4), pair(0.05), pair(0.01), pair(0.02)
    light = LightErrors(
        pair(0.05), {(1, 0): ratios[0], (0, 2): ratios[1]}, {(2, 0): bends[0], (1, 1): bends[1]}
    )
    return SystemState(
        Pose(decenter_x_mm=x_mm, decenter_y_mm=y_mm, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y),
        light=light,
        plane_shifts_um=((0.0, 0.0), pair(0.7)),
        plane_distance_errors_mm=(0.0, pair(2e-3)[0]),
        plane_backgrounds=(0.003, 0.003),
    )


def measure(lens: Lens, name: str, seed: int, kind: str) -> Outcome:
    """Return the outcome of one picture on one bench."""
    patch = object_patch(lens, PATCH_MM)
    values = picture(name, patch.grid.shape)
    if kind == "complex":
        values = (0.7 + 0.3 * values) * np.exp(1.5j * values)
    true = Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bench = careful_bench(seed)
        frames = image(
            lens,
            true,
            state=bench,
            exposures=(1.0,),
            seed=seed,
            field_stop_mm=patch.field_stop_mm,
            **SETTINGS,
        ).frames
        settings = {"kind": kind, "patch_mm": PATCH_MM, "error": SETTINGS["error"]}
        found = calibrate_frames(lens, frames, verdict="none", **settings)
        again = reconstruct_frames(lens, frames, truth=true, calibration=found.state, **settings)
    assert found.object_uncertainty is not None
    truth, judged = again.truth, replace(again.verdict, bench=found.object_uncertainty.summary)
    correlation = truth["object_correlation"] or 0.0
    without = truth.get("correlation_without_low_orders")
    least, least_without = judged.least_correlation, judged.least_correlation_without_low_orders
    return Outcome(correlation, least or 0.0, without, least_without or 0.0, judged.explained)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--pictures", type=int, default=len(PICTURES))
    parser.add_argument("--benches", type=int, default=2)
    parser.add_argument("--first-bench", type=int, default=0)
    parser.add_argument("--kind", choices=("amplitude", "complex"), default="amplitude")
    given = parser.parse_args()
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    outcomes = []
    for seed in range(given.first_bench, given.first_bench + given.benches):
        for name in PICTURES[: given.pictures]:
            one = measure(lens, name, seed, given.kind)
            outcomes.append(one)
            without = ""
            if one.without_low_orders is not None:
                without = f"; without low orders {one.without_low_orders:.4f}, "
                without += f"bound {one.bound_without_low_orders:.4f}"
            print(
                f"{name}, bench {seed}: correlation {one.correlation:.4f}, bound {one.bound:.4f}{without}; "
                f"explained {one.is_explained}",
                flush=True,
            )
    explained = [one for one in outcomes if one.is_explained]
    held = [one.correlation >= one.bound for one in explained]
    pairs = [(one.without_low_orders, one.bound_without_low_orders) for one in explained]
    held_without = [true >= bound for true, bound in pairs if true is not None]
    rows = [
        Row("cases", len(outcomes)),
        Row("explained", len(explained)),
        Row("bound holds", float(np.mean(held)) if held else np.nan, at_least=0.95),
        Row(
            "bound without low orders holds",
            float(np.mean(held_without)) if held_without else np.nan,
            at_least=0.95,
        ),
        Row("median distance to the bound", float(np.median([o.correlation - o.bound for o in explained]))),
    ]
    print_table(f"photographs, {given.kind}", rows)


if __name__ == "__main__":
    main()
