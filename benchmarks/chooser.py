"""How well engines predict error and time: over a hundred scenes and four objects, against `wpm`."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from lensdesign.lens.scaling import stopped_down
from wavesim.engines.choosing import Prediction, choose, engine_for
from wavesim.fields.field import Field, relative_error
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics.comparison import random_field, reference_for
from wavesim.scene.engine import Engine
from wavesim.scene.patches import patch_scene
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

SCALES, APERTURES, FIELD_SHARES = (1 / 8, 1 / 16), (0.2, 0.35, 0.5), (0.0, 0.5, 0.9)
PATCHES_MM, PLANES_MM = (0.01, 0.03, 0.06), (2.0, 22.0)
ERRORS = (0.2, 0.1, 0.03)
"""Allowed in turn, one for each scene."""

OBJECTS = ("even", "chart", "phase", "spots")


@dataclass(frozen=True)
class GlassChoiceResult:
    """A prediction for the light of an object, and what came of it."""

    thing: str
    prediction: Prediction
    chosen: bool
    relative_error: float
    total_seconds: float

    @property
    def error_ratio(self) -> float:
        """Predicted over measured."""
        return self.prediction.relative_error / self.relative_error

    @property
    def seconds_ratio(self) -> float:
        """Predicted over measured, of set-up and two runs."""
        return self.prediction.total_seconds(2) / self.total_seconds


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    tried: list[GlassChoiceResult] = []
    kept = []
    for number, scene in enumerate(scenes()):
        allowed = ERRORS[number % len(ERRORS)]
        of_scene = try_all(scene, allowed, number)
        tried += of_scene
        kept += [t.relative_error <= allowed for t in of_scene if t.chosen]
    rows = [
        Row("scenes and objects", len(kept)),
        Row("error allowed kept by the engine chosen", np.mean(kept)),
    ]
    rows += summary("chosen engines", [t for t in tried if t.chosen and t.prediction.engine != "wpm"])
    for name in ("eikonal", "slices", "thin-lens"):
        rows += summary(name, [t for t in tried if t.prediction.engine == name])
    for thing in OBJECTS:
        own = [t for t in tried if t.thing == thing and t.prediction.engine == "eikonal"]
        rows += summary(f"eikonal, {thing}", own)[:3]
    rows.append(seconds_row("all engines", [t for t in tried if t.thing == OBJECTS[0]]))
    print_table("Predicted and measured, of all engines over all scenes and objects", rows)


def scenes() -> Iterator[Scene]:
    """Meridional patches of twins of the paper's lens."""
    paper = load_design(DESIGNS / "paper_singlet.toml")
    for scale, aperture, share, patch, plane in product(
        SCALES, APERTURES, FIELD_SHARES, PATCHES_MM, PLANES_MM
    ):
        lens = stopped_down(scaled(paper, scale), aperture)
        height = share * lens.half_field_mm
        yield patch_scene(lens, patch, height, plane_distance_mm=scale * plane, meridional=True)


def object_field(thing: str, scene: Scene, number: int) -> Field:
    """An object on a line, lit along the axis.

    Parameters
    ----------
    thing
        "even": speckle of all directions; "chart": groups of three opaque bars, 0.8 to 3 times as wide as
        the wavelength over the aperture; "phase": pads of up to half a turn; "spots": four bright samples.
    scene, number
        Where, and the seed.
    """
    grid, lens = scene.object_grid, scene.lens
    aperture = lens.object.numerical_aperture
    if thing == "even":
        return random_field(grid, scene.wavelength_um, aperture)
    rng = np.random.default_rng(number)
    half = grid.half_widths_mm[0]
    y = grid.y_mm - grid.centre_mm[1]
    values = (np.abs(y) < 0.95 * half).astype(complex)
    if thing == "spots":
        values[:] = 0.0
        values[rng.integers(0, len(y), 4)] = 1.0
    elif thing == "phase":
        for pad in range(4):
            first = (0.4 * pad - 0.7) * half
            values[(y > first) & (y <= first + half / 6)] *= np.exp(0.125j * np.pi * (pad + 1))
    else:
        first = -0.8 * half
        while first < 0.7 * half:
            width = 1e-3 * scene.wavelength_um / aperture * rng.uniform(0.8, 3.0)
            bars = np.abs((y - first) / width - np.array([[0.5], [2.5], [4.5]])) < 0.5
            values[bars.any(axis=0)] = 0.0
            first += 8.0 * width
    return Field(grid, values, scene.wavelength_um)


def try_all(scene: Scene, allowed: float, number: int) -> list[GlassChoiceResult]:
    """Run all that was weighed for a scene's objects, and say what was chosen."""
    truth = reference_for(scene)
    built: dict[str, tuple[Engine, float]] = {}
    found = []
    for thing in OBJECTS:
        field = object_field(thing, scene, number)
        exact, light = truth.forward(field).values, Light(field)
        choice = choose(scene, allowed, light=light)
        for prediction in choice.predictions:
            if prediction.refused or not np.isfinite(prediction.relative_error):
                continue
            if prediction.label not in built:
                built[prediction.label] = timed(scene, prediction, field)
            engine, seconds = built[prediction.label]
            error = relative_error(engine.forward(field).values, exact)
            found.append(GlassChoiceResult(thing, prediction, prediction is choice.chosen, error, seconds))
    return found


def timed(scene: Scene, prediction: Prediction, field: Field) -> tuple[Engine, float]:
    """The engine, and seconds of its set-up and two runs."""
    started = time.perf_counter()
    engine = engine_for(scene, prediction.engine, **prediction.settings)
    engine.forward(field)
    once = time.perf_counter() - started
    runs = []
    for _ in range(3):
        started = time.perf_counter()
        engine.forward(field)
        runs.append(time.perf_counter() - started)
    return engine, once + min(runs)


def within(ratios: list[float], factor: float) -> float:
    """Share of ratios no farther from 1 than a factor."""
    return float(np.mean([1.0 / factor <= ratio <= factor for ratio in ratios]))


def seconds_row(name: str, tried: list[GlassChoiceResult]) -> Row:
    """How often the time is printed."""
    ratios = [t.seconds_ratio for t in tried]
    return Row(f"{name}: seconds within a factor 3", within(ratios, 3.0), at_least=0.9)


def summary(name: str, tried: list[GlassChoiceResult]) -> list[Row]:
    """Shares of predictions of some kind that hold."""
    ratios = [t.error_ratio for t in tried]
    return [
        Row(f"{name}: number", len(tried)),
        Row(
            f"{name}: predicted error is an upper bound",
            float(np.mean(np.array(ratios) >= 1.0)),
            at_least=0.95,
        ),
        Row(f"{name}: predicted error within a factor 5", within(ratios, 5.0), at_least=0.8),
        Row(f"{name}: predicted over measured error, 1 in 20 below", float(np.quantile(ratios, 0.05))),
        Row(f"{name}: predicted over measured error, median", float(np.median(ratios))),
        Row(f"{name}: predicted over measured error, 1 in 5 above", float(np.quantile(ratios, 0.8))),
        seconds_row(name, tried),
    ]


if __name__ == "__main__":
    main()
