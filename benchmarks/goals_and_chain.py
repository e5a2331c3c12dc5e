"""What each goal of a search buys in the whole chain from object to reconstruction.

Lenses that searches of one specification found for different goals are compared. Twins of them, 48 times
smaller, are perturbed alike: by random draws of the study's tolerances, as large in wavelengths as at the
lens's own size, times a factor. Frames with noise are recorded through each perturbed twin. The object is
reconstructed with the nominal lens, and with the mounting that a calibration finds in frames of a known
chart. Each trial is appended to a file, so that a run that was interrupted continues.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.merits_and_chain.chain import Chain, thing
from benchmarks.merits_and_chain.perturbations import RELATIVE
from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.problem import DesignProblem
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.sections import LOSS_GOAL
from lensdesign.optimization.specification.specification import load_specification
from tolerancing import load_study
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.merits.registry import merit_from_table
from tolerancing.prediction.reconstruction_loss import DRAWS, loss_model, loss_paths
from tolerancing.prediction.wavefront_prediction import drawn_amounts
from tolerancing.study.evaluate import sample_perturbations
from wavesim.scene.system_state import SystemState

Array = np.ndarray[Any, Any]

SCALE = 48.0
"""How many times smaller the twins are."""

FACTOR = 0.3
"""Of the tolerances. With all of them frames of so small a field are moved so far that a reconstruction with
the nominal lens finds next to nothing, whatever the lens."""

PLACE_MM, STOP_MM = (0.0, 0.011), 0.04
"""Middle and diameter of the twins' field stop."""

TRIALS = {"nominal": 48, "calibrated": 12}
"""Perturbed twins of each lens, by the model of the reconstruction."""

SEED, NOISE_SEED, CHART_SEED = 3, 5000, 23

RESAMPLES = 4000
"""Of the trials, for 95 % intervals."""


class Found(NamedTuple):
    """A lens as a search of `designs/as_built_spec.toml` found it; its stop is the second surface."""

    radii_mm: tuple[float, float]
    conics: tuple[float, float]
    thickness_mm: float
    semi_diameters_mm: tuple[float, float]


LENSES = {
    "smallest spread": Found((37.810083, -12.008605), (-6.2119651, -0.92805212), 9.7, (8.52, 9.5799988)),
    "yield": Found((65.970643, -10.780227), (-20.0, -0.74082073), 8.6416477, (8.26, 9.2583451)),
    "loss, nominal model": Found((65.087234, -10.985366), (-20.0, -0.69578335), 8.6428650, (8.26, 9.2693659)),
    "loss, calibrated model": Found(
        (75.576487, -10.660101), (20.0, -0.82929339), 8.7038468, (8.26, 9.2577576)
    ),
}
"""By the goal of the search; those for small losses began at the lens of the yield."""

REFERENCE = "smallest spread"
"""The goal with which others are compared."""

LOSS = {
    "kind": "reconstruction_loss",
    "patch_mm": 0.05,
    "field_points_mm": [[0.0, 0.0], [0.0, 1.0], [0.0, 1.4]],
    "at_most": 0.05,
}
"""The merit whose mean is predicted at the lens's own size."""

COMPENSATORS = tuple(
    Compensator(target=target, parameter=parameter, limit=limit)
    for target, parameter, limit in (
        ("lens", "decenter_x_mm", 0.05),
        ("lens", "decenter_y_mm", 0.05),
        ("lens", "tilt_x_deg", 0.2),
        ("lens", "tilt_y_deg", 0.2),
        ("object", "working_distance_mm", 0.05),
    )
)
"""What a calibration of the mounting finds."""


def lens_of(goal: str) -> Lens:
    """The lens at its own size."""
    found, lens = LENSES[goal], load_design(DESIGNS / "paper_singlet.toml")
    surfaces = [
        surface.replaced(
            radius_mm=found.radii_mm[k],
            conic=found.conics[k],
            thickness_mm=None if k else found.thickness_mm,
            semi_diameter_mm=found.semi_diameters_mm[k],
            stop=bool(k),
        )
        for k, surface in enumerate(lens.surfaces)
    ]
    return lens.replaced(surfaces=tuple(surfaces))


@cache
def perturbed(goal: str) -> tuple[Chain, list[SystemState]]:
    """The twin of a lens, and as many perturbations of it as there are trials."""
    twin = scaled(lens_of(goal), 1.0 / SCALE)
    study = load_study(DESIGNS / "as_built_tolerances.toml").study
    drawn = study.model_copy(update={"trials": max(TRIALS.values()), "seed": SEED, "draws": "random"})
    values = sample_perturbations(drawn, range(drawn.trials)).values * FACTOR
    for column, perturbation in enumerate(study.perturbations):
        if perturbation.parameter.split("_")[-1] in RELATIVE:
            values[:, column] *= SCALE
    context = Context(twin, Sampling(plane_distance_mm=twin.sensor.plane_distances_mm[0]))
    batch = context.perturbed(study.perturbations, values)
    return Chain(twin, PLACE_MM, STOP_MM, "amplitude"), context.states(batch, None)


def measured(path: Path) -> list[dict[str, Any]]:
    """All trials, of which those that the file lacks are made now."""
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {(row["goal"], row["model"], row["trial"]) for row in done}
    with path.open("a") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for goal, model, trial in _work():
            if (goal, model, trial) not in known:
                done.append(_row(goal, model, trial))
                file.write(json.dumps(done[-1]) + "\n")
                file.flush()
    return done


def _work() -> Iterator[tuple[str, str, int]]:
    """Trials in turn through all lenses, so that a part of them is a fair one."""
    for trial in range(max(TRIALS.values())):
        for model, count in TRIALS.items():
            if trial < count:
                yield from ((goal, model, trial) for goal in LENSES)


def _row(goal: str, model: str, trial: int) -> dict[str, Any]:
    chain, systems = perturbed(goal)
    true, begun = thing(chain), time.process_time()
    row: dict[str, Any] = {"goal": goal, "model": model, "trial": trial}
    try:
        planes, bench = chain.recorded(systems[trial], true, NOISE_SEED + trial), None
        if model == "calibrated":
            chart = thing(chain, CHART_SEED)
            bench = chain.mounting(chain.recorded(systems[trial], chart, 2 * NOISE_SEED + trial), chart)
        found, _ = chain.found(planes, bench)
        row["correlation"] = chain.correlation(found, true)
    except TransferLensError as error:
        row |= {"correlation": None, "error": str(error)}
    return row | {"processor_s": round(time.process_time() - begun, 3)}


def interval(values: Array) -> str:
    """Mean with its 95 % interval, from resampled trials."""
    random = np.random.default_rng(SEED)
    means = np.mean(random.choice(values, (RESAMPLES, len(values))), axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{np.mean(values):.4f} ({low:.4f} to {high:.4f})"


def predicted(goal: str) -> str:
    """Mean losses of the lens at its own size, with the nominal and with a calibrated model.

    All lenses take the loss model of the first: different speckle would otherwise hide the differences.
    """
    study = load_study(DESIGNS / "as_built_tolerances.toml").study
    merit = merit_from_table(LOSS, "benchmark")
    assert isinstance(merit, ReconstructionLoss)
    model, amounts, found = loss_model(lens_of(REFERENCE), merit), drawn_amounts(study, DRAWS), []
    for compensators in ((), COMPENSATORS):
        own = study.model_copy(update={"compensators": compensators})
        paths = loss_paths(lens_of(goal), own, merit)
        losses, _ = model.losses(model.coefficients(paths, amounts))
        found.append(f"{np.mean(losses.max(axis=0)):.3g}")
    return " | ".join(found)


def search() -> None:
    """Search for small losses from the lens of the yield, and print time, losses by trials, and the lens."""
    study = (DESIGNS / "as_built_tolerances.toml").read_text(encoding="utf-8")
    study = study[: study.index("# What a good lens is")]
    merit = "\n[[merit]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in LOSS.items())
    mounting = "".join(
        f'\n[[compensator]]\ntarget = "{c.target}"\nparameter = "{c.parameter}"\nlimit = {c.limit}\n'
        for c in COMPENSATORS
    )
    text = (DESIGNS / "as_built_spec.toml").read_text(encoding="utf-8")
    text = text.replace('goal = "yield"', f'goal = "{LOSS_GOAL}"')
    text = text.replace('"as_built_tolerances.toml"', '"study.toml"\ntrials = 200')
    for model, compensators in (("nominal", ""), ("calibrated", mounting)):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
            (folder / "study.toml").write_text(study + compensators + merit, encoding="utf-8")
            (folder / "specification.toml").write_text(text, encoding="utf-8")
            asked = load_specification(folder / "specification.toml")
            asked = asked.replaced(
                surfaces=lens_of("yield").surfaces,
                variables=tuple(v for v in asked.variables if not v.discrete),
                optimize=asked.optimize.replaced(start="design", starts=1),
            )
            problem, begun = DesignProblem(asked, asked.lens), time.process_time()
            problem.losses(problem.to_unit(asked.lens) + 1e-9)
            one, begun = time.process_time() - begun, time.process_time()
            found = optimize(asked)
        spent = time.process_time() - begun
        print(f"{model} model: {one:.2f} s an evaluation; {found.evaluations} of them, {spent:.0f} s in all")
        assert found.as_built is not None
        for row in found.as_built.rows:
            (loss,) = row.losses
            print(f"  {row.name}: {loss.mean:.3g} +- {2.0 * loss.error:.2g}, predicted {loss.predicted:.3g}")
        print(f"  {found.variables}")


def main() -> None:
    """Measure what the file lacks, and print a table of lenses and models."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--file", type=Path, default=Path("goals_and_chain.jsonl"), help="of what was done")
    parser.add_argument("--search", action="store_true", help="search for the lenses of small losses instead")
    asked = parser.parse_args()
    if asked.search:
        search()
        return
    rows = measured(asked.file)
    known = {(row["goal"], row["model"], row["trial"]): row["correlation"] or 0.0 for row in rows}
    found = {
        (goal, model): np.array([known[goal, model, trial] for trial in range(count)])
        for goal in LENSES
        for model, count in TRIALS.items()
    }
    print(
        "| goal of the search | nominal model | beside the first | calibrated model | beside the first "
        "| mean loss predicted at its own size, nominal model | calibrated |"
    )
    print("| --- " * 7 + "|")
    for goal in LENSES:
        cells = []
        for model in TRIALS:
            own, first = found[goal, model], found[REFERENCE, model]
            cells += [interval(own), "-" if goal == REFERENCE else interval(own - first)]
        print(f"| {goal} | {' | '.join(cells)} | {predicted(goal)} |", flush=True)
    lost = sum(row["correlation"] is None for row in rows)
    spent = sum(row["processor_s"] for row in rows)
    print(f"{len(rows)} chains, {lost} of them not carried; processor time {spent / 60.0:.1f} min")


if __name__ == "__main__":
    main()
