"""Oversampling ratio against correlation, for objects of several kinds on small twins of the paper's lens.

    python -m benchmarks.oversampling_chart [RESULTS.jsonl [CHART.png]]

Frames with noise are reconstructed as by `wavesim plan`. The ratio is varied by the number of planes, the
diameter of the field stop, the numerical aperture, the pixel pitch, the exposures, and by a random choice of
the pixels that are used. Results are stored in a file, and an interrupted run continues.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from lensdesign.lens.lens import Lens
from wavesim.calibration.planning import EXPLAINED, TRIAL_OBJECTS, Trial, Twin, random_objects, trial_of
from wavesim.fields.field import Field
from wavesim.scene.settings import Kind, PlanSettings
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import Patch, object_patch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCALE, SEED = 1 / 80, 3

FOUND = 0.95
"""Correlation from which an object counts as found, if its frames are explained."""

BRACKET, ONE = (1.0, 30.0, 1000.0), (1.0,)

PHASE_OBJECTS: dict[str, float] = {"dense phase": 1.0, "faint phase": 0.25}
"""Objects of phase alone: rms phase in rad of the phase of the trial object "dense"."""

OBJECTS: tuple[str, ...] = (*TRIAL_OBJECTS, *PHASE_OBJECTS)


class Setting(NamedTuple):
    """A lens and its frames: stop as a fraction of the field, NA, pixel pitch, planes, exposures, and the
    fraction of the pixels that is used.
    """

    stop: float
    aperture: float
    pixel_um: float
    planes: int
    exposures: tuple[float, ...]
    used: float


def settings_of_chart() -> Iterator[Setting]:
    """Yield all settings."""
    for planes in (1, 2, 4):
        for used in (1.0, 0.5):
            yield Setting(1.0, 0.5, 3.2, planes, BRACKET, used)
    yield Setting(1.0, 0.5, 3.2, 6, BRACKET, 1.0)
    for planes in (1, 2):
        for used in (1.0, 0.7, 0.35):
            yield Setting(0.6, 0.5, 3.2, planes, BRACKET, used)
    for planes in (1, 2):
        yield Setting(0.8, 0.35, 3.2, planes, BRACKET, 1.0)
        yield Setting(0.8, 0.5, 2.4, planes, BRACKET, 1.0)
        yield Setting(0.6, 0.5, 3.2, planes, ONE, 1.0)


def kind_of(name: str) -> Kind:
    """Return the kind as which an object is sought: objects of phase alone count as complex, too."""
    is_amplitude = name in TRIAL_OBJECTS and TRIAL_OBJECTS[name].kind == "amplitude"
    return "amplitude" if is_amplitude else "complex"


def object_named(name: str, patch: Patch) -> Field:
    """Return an object on a patch."""
    if name in TRIAL_OBJECTS:
        return random_objects(patch, PlanSettings(kind=kind_of(name), seed=SEED))[name]
    dense = random_objects(patch, PlanSettings(kind="complex", seed=SEED + 1))["dense"]
    phase = np.angle(dense.values)
    factor = PHASE_OBJECTS[name] / float(np.std(phase[patch.inside]))
    return dense.with_values(np.exp(1j * factor * phase).astype(np.complex64))


def lens_of(aperture: float, pixel_um: float) -> Lens:
    """Return a twin with another numerical aperture and other pixels on the same area."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    pitch_um = lens.sensor.pixel_pitch_um
    pixels = tuple(round(count * pitch_um / pixel_um) for count in lens.sensor.pixels)
    return lens.replaced(
        object=lens.object.replaced(numerical_aperture=aperture),
        sensor=lens.sensor.replaced(pixel_pitch_um=pixel_um, pixels=pixels),
    )


def _planes(lens: Lens, count: int) -> tuple[float, ...]:
    near, far = lens.sensor.plane_distances_mm
    return tuple(float(z) for z in np.linspace(near, far, count))


def _with_fraction(recorded: Sequence[Measurement], used: float) -> list[Measurement]:
    """Return measurements of which a random fraction of the pixels is known."""
    random = np.random.default_rng(SEED)
    return [
        replace(plane, sigma=np.where(random.random(plane.sigma.shape) < used, plane.sigma, np.inf))
        for plane in recorded
        if plane.sigma is not None
    ]


def _bench(name: str, setting: Setting) -> tuple[Lens, Trial]:
    """Return the lens of a setting, and the frames of an object on all planes that settings with it use."""
    lens = lens_of(setting.aperture, setting.pixel_um)
    patch = object_patch(lens, setting.stop * lens.object.field_diameter_mm)
    counts = {one.planes for one in settings_of_chart() if one[:3] == setting[:3]}
    planes = sorted({z for count in counts for z in _planes(lens, count)})
    settings = PlanSettings(kind=kind_of(name), exposures=BRACKET, seed=SEED)
    twin = Twin(1.0, patch.field_stop_mm, settings.read_noise_electrons, math.nan)
    return lens, trial_of(lens, object_named(name, patch), settings, twin, planes)


def measured(name: str, setting: Setting, lens: Lens, of_object: Trial) -> dict[str, Any]:
    """Return ratio, information and outcome of a setting for an object."""
    kind, planes = kind_of(name), _planes(lens, setting.planes)
    recorded = of_object.recorded(planes, setting.exposures)
    if setting.used < 1.0:
        recorded = _with_fraction(recorded, setting.used)
    outcome = of_object.outcome(kind, recorded)
    information = of_object.information(kind, recorded)
    values = of_object.target.values[of_object.inside]
    changed = float(np.std(values))
    return {
        "object": name,
        "kind": kind,
        **setting._asdict(),
        "ratio": of_object.ratio(kind, planes, recorded),
        "correlation": outcome.correlation,
        "over_noise": outcome.misfit_over_noise,
        "deviation": changed * math.sqrt(max(1.0 - outcome.correlation**2, 0.0)),
        "deviation_of_noise": changed * math.sqrt(max(1.0 - information.fraction, 0.0)),
        "determined": information.fraction,
    }


def run(path: Path) -> list[dict[str, Any]]:
    """Measure what the file does not have yet, and return all results."""
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    keys = {(one["object"], *_key(one)) for one in done}
    for name in OBJECTS:
        held: dict[tuple[float, float, float], tuple[Lens, Trial]] = {}
        for setting in settings_of_chart():
            if (name, *_key(setting._asdict())) in keys:
                continue

            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                key = setting[:3]
                if key not in held:
                    held = {key: _bench(name, setting)}
                done.append(measured(name, setting, *held[key]))
            with path.open("a") as file:
                file.write(json.dumps(done[-1]) + "\n")
    return done


def _key(values: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(values[name] if name != "exposures" else tuple(values[name]) for name in Setting._fields)


def is_found(result: dict[str, Any]) -> bool:
    """Return whether an object was found, and its frames explained."""
    return bool(result["correlation"] >= FOUND and result["over_noise"] <= EXPLAINED)


def threshold(results: Sequence[dict[str, Any]]) -> tuple[float, float, float]:
    """Return the ratio that best separates objects that are found, and the ends of its transition.

    The ends are the lowest ratio with which an object was found, and the highest with which it was not.
    Frames with one exposure are left out: there noise hides the object, whatever the ratio is.
    """
    bright = [one for one in results if tuple(one["exposures"]) == BRACKET]
    ratios, found = np.array([one["ratio"] for one in bright]), np.array([is_found(one) for one in bright])
    if not found.any() or found.all():
        edge = float(ratios.min()) if found.all() else math.inf
        return edge, edge, edge
    limits = np.sort(ratios)
    wrong = [np.count_nonzero((ratios >= limit) != found) for limit in limits]
    return float(limits[int(np.argmin(wrong))]), float(ratios[found].min()), float(ratios[~found].max())


def chart(results: Sequence[dict[str, Any]]) -> Figure:
    """Draw correlation against ratio, and the error against that of noise alone."""
    from lensdesign.plots.style import SERIES, styled_figure

    figure = styled_figure(11.0, 4.4)
    panels = figure.subplots(1, 3)
    for axes, kind in zip(panels, ("amplitude", "complex"), strict=False):
        names = [name for name in OBJECTS if kind_of(name) == kind]
        for name, colour in zip(names, SERIES, strict=False):
            own = [one for one in results if one["object"] == name]
            for exposures, marker in ((BRACKET, "o"), (ONE, "x")):
                shown = [one for one in own if tuple(one["exposures"]) == exposures]
                axes.plot(
                    [one["ratio"] for one in shown],
                    [one["correlation"] for one in shown],
                    marker,
                    ms=4.0,
                    color=colour,
                    alpha=0.75,
                    label=name if marker == "o" else None,
                )
        axes.axvspan(1.0, 2.0, color="0.9", zorder=0)
        axes.set_xscale("log")
        axes.set_xticks([0.5, 1.0, 2.0, 4.0, 8.0], labels=["0.5", "1", "2", "4", "8"])
        axes.minorticks_off()
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("pixels in the light for each unknown")
        axes.set_ylabel("correlation")
        axes.set_title(f"{kind} objects")
        axes.grid(True)
        axes.legend(fontsize=7)
    last = panels[2]
    for name in OBJECTS:
        names = [other for other in OBJECTS if kind_of(other) == kind_of(name)]
        colour = SERIES[names.index(name)]
        own = [one for one in results if one["object"] == name]
        for found in (True, False):
            shown = [one for one in own if is_found(one) == found]
            last.plot(
                [one["deviation_of_noise"] for one in shown],
                [one["deviation"] for one in shown],
                ms=4.0,
                color=colour,
                marker="s" if kind_of(name) == "amplitude" else "o",
                ls="",
                markerfacecolor=colour if found else "none",
            )
    ends = [2e-3, 1.0]
    last.plot(ends, ends, "-", color="0.5", lw=1.0)
    last.set_xscale("log")
    last.set_yscale("log")
    last.set_xlabel("deviation of a sample that noise leaves")
    last.set_ylabel("deviation of a sample, reached")
    last.set_title("filled: found; squares: amplitude")
    last.grid(True)
    return figure


def main(path: Path | None = None, picture: Path | None = None) -> None:
    """Measure, print the thresholds, and draw the chart."""
    if path is None:
        with TemporaryDirectory() as folder:
            results = run(Path(folder) / "results.jsonl")
    else:
        results = run(path)
    print("| object | kind | threshold | lowest ratio found | highest ratio not found | best correlation |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in OBJECTS:
        own = [one for one in results if one["object"] == name]
        limit, low, high = threshold(own)
        best = max(one["correlation"] for one in own)
        print(f"| {name} | {kind_of(name)} | {limit:.2f} | {low:.2f} | {high:.2f} | {best:.4f} |")
    found = [one for one in results if is_found(one)]
    ratios = np.array([one["deviation"] / one["deviation_of_noise"] for one in found])
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9])
    print(f"{len(results)} trials, {len(found)} found")
    print(f"deviation reached over that of noise: {middle:.2f} (10 to 90 %: {low:.2f} to {high:.2f})")
    if picture is not None:
        chart(results).savefig(picture, dpi=120)


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:3]))
