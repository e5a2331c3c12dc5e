"""Predictions of `plan_frames` for a described object, compared with what frames then give.

For each case the correlation of one plan is predicted. The plan is given an example of the object: a chart of
the same name, or a random texture of the same kind with another seed. Frames of the object itself are made by
other models than those of the package (:mod:`benchmarks.independent_frames`), and the object is reconstructed
by `reconstruct_frames` with its defaults. Some benches differ from their design, and are calibrated from the
same frames first.

Outcomes are stored in a file, so that an interrupted run continues: `python -m benchmarks.plan_outcomes
[FILE.jsonl]`.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, NoReturn
from unittest.mock import patch as patching

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.independent_frames import independent_frames, independent_intensities
from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim import calibrate_frames
from wavesim.calibration.planning import Plan, plan_frames
from wavesim.fields.field import Field
from wavesim.reconstruction import assessment
from wavesim.reconstruction.diagnostics.cause_trials import CauseTrials
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import Kind, PatchSettings
from wavesim.targets.patch import Patch, lit, make_target, object_patch

ALLOWED = 0.02
"""Difference of correlations up to which a prediction holds."""

SEED, EXAMPLE_SEED = 11, 500
"""Seed of the objects' random textures and of the noise, and seed of the example that a plan is given."""


def _noise(random: np.random.Generator, shape: tuple[int, int], exponent: float) -> NDArray[np.float64]:
    """Return noise with an amplitude spectrum that falls as a power of the frequency, mean 0, deviation 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :])
    fall = 1.0 / np.maximum(frequency, 1.0 / max(shape)) ** exponent
    values = np.fft.ifft2(np.fft.fft2(random.standard_normal(shape)) * fall).real
    return np.asarray((values - values.mean()) / values.std())


def _rough(random: np.random.Generator, shape: tuple[int, int]) -> NDArray[Any]:
    """Absorption and phase with a spectrum of all scales, everywhere."""
    modulus = np.clip(0.6 + 0.2 * _noise(random, shape, 1.0), 0.1, 1.0)
    return np.asarray(modulus * np.exp(0.9j * _noise(random, shape, 1.0)))


def _discs(
    random: np.random.Generator, shape: tuple[int, int], count_per_1000: float, radius: float
) -> NDArray[np.float64]:
    """Return the number of discs of random position and radius that cover each sample."""
    rows, columns = np.indices(shape)
    covered = np.zeros(shape)
    for _ in range(round(1e-3 * count_per_1000 * shape[0] * shape[1])):
        y, x = random.uniform(0, shape[0]), random.uniform(0, shape[1])
        covered += np.hypot(rows - y, columns - x) < radius * random.uniform(0.6, 1.4)
    return covered


def _cells(random: np.random.Generator, shape: tuple[int, int]) -> NDArray[Any]:
    """Transparent cells with a phase of 0.7 rad and a little absorption."""
    cells = gaussian_filter(np.minimum(_discs(random, shape, 4.0, 4.0), 1.0), 0.7)
    return np.asarray((1.0 - 0.1 * cells) * np.exp(0.7j * cells))


def _dust(random: np.random.Generator, shape: tuple[int, int]) -> NDArray[Any]:
    """Opaque grains on a bright ground."""
    return np.where(_discs(random, shape, 2.5, 2.0) > 0.0, 0.0, 1.0)


def _fibres(random: np.random.Generator, shape: tuple[int, int]) -> NDArray[Any]:
    """Dark fibres: level lines of a random pattern."""
    return np.where(np.abs(gaussian_filter(_noise(random, shape, 0.0), 4.0)) < 0.02, 0.2, 1.0)


TEXTURES: dict[str, Callable[[np.random.Generator, tuple[int, int]], NDArray[Any]]] = {
    "rough": _rough,
    "cells": _cells,
    "dust": _dust,
    "fibres": _fibres,
}


class Case(NamedTuple):
    """A bench, an object on it, and a plan.

    Attributes
    ----------
    twin
        Size of the paper's lens over that of the bench's.
    patch_mm, stop_mm
        Side of the patch and diameter of the field stop; None: the side of the patch.
    thing, kind
        Object: one of `TEXTURES`, or an object of `wavesim image`; and its kind.
    planes, exposures
        Number of planes, evenly spaced between those of the design, and exposures of each.
    engine
        Engine of the frames.
    off
        Whether the bench differs from its design.
    """

    twin: int
    patch_mm: float
    stop_mm: float | None
    thing: str
    kind: Kind
    planes: int
    exposures: tuple[float, ...]
    engine: str = "eikonal"
    off: bool = False


ONE, TWO, THREE = (1.0,), (1.0, 30.0), (1.0, 30.0, 1000.0)

CASES = (
    Case(48, 0.04, None, "star", "amplitude", 1, THREE),
    Case(48, 0.03, None, "star", "amplitude", 2, ONE, "slices"),
    Case(48, 0.05, None, "usaf", "amplitude", 1, THREE),
    Case(32, 0.05, None, "usaf", "amplitude", 2, TWO, "slices"),
    Case(24, 0.06, None, "usaf", "amplitude", 1, THREE),
    Case(48, 0.03, None, "phase", "complex", 2, THREE),
    Case(32, 0.05, None, "phase", "complex", 4, THREE),
    Case(24, 0.06, None, "phase", "complex", 3, TWO),
    Case(48, 0.04, None, "phase", "complex", 2, ONE, "slices"),
    Case(48, 0.04, None, "tissue", "complex", 2, THREE, "slices"),
    Case(32, 0.06, None, "tissue", "complex", 3, THREE),
    Case(64, 0.03, None, "tissue", "complex", 1, THREE),
    Case(24, 0.06, None, "tissue", "complex", 2, TWO),
    Case(48, 0.04, None, "rough", "complex", 2, THREE),
    Case(48, 0.04, None, "rough", "complex", 4, THREE, "slices"),
    Case(48, 0.03, None, "rough", "complex", 2, ONE),
    Case(48, 0.05, 0.03, "rough", "complex", 1, THREE),
    Case(48, 0.03, None, "rough", "complex", 3, THREE),
    Case(48, 0.04, None, "cells", "complex", 2, THREE),
    Case(32, 0.05, None, "cells", "complex", 3, ONE),
    Case(64, 0.03, None, "cells", "complex", 4, TWO, "slices"),
    Case(48, 0.04, None, "dust", "amplitude", 1, THREE),
    Case(32, 0.05, None, "dust", "amplitude", 2, ONE),
    Case(24, 0.06, None, "dust", "amplitude", 2, THREE),
    Case(48, 0.04, None, "fibres", "amplitude", 1, ONE),
    Case(32, 0.05, None, "fibres", "amplitude", 1, THREE, "slices"),
    Case(48, 0.04, None, "star", "amplitude", 2, THREE, off=True),
    Case(48, 0.04, None, "cells", "complex", 2, THREE, off=True),
    Case(48, 0.04, None, "tissue", "complex", 2, THREE, off=True),
    Case(48, 0.04, None, "fibres", "amplitude", 2, THREE, off=True),
)

POSE = Pose(decenter_x_mm=0.3e-3, decenter_y_mm=-0.2e-3, tilt_x_deg=0.03)
"""Mounting error of a bench that is off."""

SHIFT_UM = (1.0, -0.7)
"""Displacement of the sensor on its last plane, if the bench is off and has several."""


def lens_of(case: Case) -> Lens:
    """Return the lens of a case."""
    return scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / case.twin)


def planes_of(case: Case, lens: Lens) -> tuple[float, ...]:
    """Return the distances of a case's planes."""
    near, far = lens.sensor.plane_distances_mm
    return tuple(float(z) for z in np.linspace(near, far, case.planes))


def object_of_case(case: Case, patch: Patch, aperture: float, seed: int) -> Field:
    """Return the transmission of a case's object."""
    if case.thing not in TEXTURES:
        return make_target(patch, case.thing, numerical_aperture=aperture, seed=seed).transmission
    values = TEXTURES[case.thing](np.random.default_rng(seed), patch.grid.shape)
    return Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)


def reached(case: Case) -> dict[str, Any]:
    """Return the correlation that frames of a case give, and what the verdict says."""
    lens = lens_of(case)
    planes = planes_of(case, lens)
    patch = object_patch(lens, case.patch_mm, case.stop_mm)
    true = object_of_case(case, patch, lens.object.numerical_aperture, SEED)
    bench: dict[str, Any] = {}
    if case.off:
        shifts = [(0.0, 0.0)] * (case.planes - 1) + [SHIFT_UM]
        bench = {"pose": POSE, "shifts_um": shifts if case.planes > 1 else ()}
    error = 0.003 if case.engine == "eikonal" else None
    illumination = lit(patch, PatchSettings())
    behind = illumination.with_values((illumination.values * true.values).astype(np.complex64))
    light = independent_intensities(lens, patch, behind, planes, engine=case.engine, error=error, **bench)
    frames = independent_frames(lens, patch.wavelength_um, planes, light, exposures=case.exposures, seed=SEED)
    settings: dict[str, Any] = {"kind": case.kind, "patch_mm": case.patch_mm, "field_stop_mm": case.stop_mm}
    state = calibrate_frames(lens, frames, verdict="none", **settings).state if case.off else None
    found = reconstruct_frames(lens, frames, truth=true, calibration=state, **settings)
    return {
        "reached": found.truth["object_correlation"],
        "over_noise": found.verdict.over_noise,
        "verdict": found.verdict.words,
        "iterations": len(found.curve),
    }


def predicted(case: Case) -> tuple[float, Plan]:
    """Return the predicted correlation of a case, and its plan."""
    lens = lens_of(case)
    plan = planes_of(case, lens), case.exposures
    patch = object_patch(lens, case.stop_mm or case.patch_mm)
    example: str | Field = case.thing
    if case.thing in TEXTURES:
        example = object_of_case(case, patch, lens.object.numerical_aperture, EXAMPLE_SEED)
    settings: dict[str, Any] = {"patch_mm": patch.field_stop_mm, "most_planes": case.planes}
    settings |= {"kind": case.kind, "exposures": case.exposures}
    (found,) = plan_frames(lens, example=example, candidates=[plan], **settings).plans
    return found.predicted, found


def measured(case: Case) -> dict[str, Any]:
    """Return what was predicted for a case, and what came of it."""
    begun = perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        correlation, plan = predicted(case)
        outcome = reached(case)
    values = {"predicted": correlation, "lowest": plan.correlation, "highest": plan.highest_correlation}
    values |= {"ratio": plan.ratio, "misfit_of_example": plan.misfit_of_example}
    return {"case": str(case)} | values | outcome | {"seconds": perf_counter() - begun}


@contextmanager
def without_causes() -> Iterator[None]:
    """Let reconstructions try no causes of a misfit, which take minutes and change no object."""

    def refused(*_: Any, **__: Any) -> NoReturn:
        raise TransferLensError("not tested")

    with (
        patching.object(CauseTrials, "trials", lambda _: []),
        patching.object(assessment, "score_test", refused),
    ):
        yield


def main(path: Path | None = None, cases: Sequence[Case] = CASES) -> None:
    """Print the table, and how many predictions hold."""
    lines = path.read_text().splitlines() if path is not None and path.exists() else []
    done = {one["case"]: one for one in map(json.loads, lines)}
    print("| twin | object | planes | exposures | predicted | reached | difference | over noise | seconds |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    differences = []
    for case in cases:
        if str(case) not in done:
            with without_causes():
                done[str(case)] = measured(case)
            if path is not None:
                with path.open("a") as file:
                    file.write(json.dumps(done[str(case)]) + "\n")
        values = done[str(case)]
        differences.append(values["reached"] - values["predicted"])
        exposures = ", ".join(f"{one:g}" for one in case.exposures)
        print(
            f"| 1/{case.twin}{', off' if case.off else ''} | {case.thing}, {case.kind} | {case.planes} "
            f"| {exposures} | {values['predicted']:.4f} | {values['reached']:.4f} | {differences[-1]:+.4f} "
            f"| {values['over_noise']:.2f} | {values['seconds']:.0f} |",
            flush=True,
        )
    held = sum(abs(one) <= ALLOWED for one in differences)
    print(f"within {ALLOWED:g} of the prediction: {held} of {len(cases)}")
    print(f"largest promise that was not kept: {-min(differences):.4f}")


if __name__ == "__main__":
    main(*(Path(name) for name in sys.argv[1:2]))
