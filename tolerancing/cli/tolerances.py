"""Commands about tolerances: a starting study, sensitivities, inverse limits, budgets and costs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import messages_only, print_json, say
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import GRADES, Design, Json, StudyFile, Trust, output_option
from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError
from tolerancing.cli.tables import print_table

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from tolerancing.budgets.study_budget import StudyBudget
    from tolerancing.cost.pricing import Cost
    from tolerancing.perturbations.parameters import Perturbation
    from tolerancing.statistics.approximations import Approximation
    from tolerancing.statistics.limits import StudyLimits
    from tolerancing.statistics.sensitivities import Sensitivity
    from tolerancing.study.study import Study

Costs = Annotated[
    str | None,
    typer.Option(
        metavar="[relative]|FILE",
        help="Table of costs (TOML), or `relative` for the built-in one.",
        rich_help_panel=OptionGroup.TOLERANCES,
    ),
]
Processes = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[N=]NAME",
        help="Manufacturing process of element N, or of all; may be repeated.",
        rich_help_panel=OptionGroup.TOLERANCES,
    ),
]
StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="Store made by a run.")]
MeritName = Annotated[
    str | None,
    typer.Option(
        "--merit", help="Analyse only the merit of this name.", rich_help_panel=OptionGroup.EVALUATION
    ),
]


def start(
    design: Design,
    output: Annotated[Path, output_option("Study file to write.")],
    grade: Annotated[
        str,
        typer.Option(
            metavar=GRADES,
            help="Grade of the tolerances; iso10110: general tolerances.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = "precision",
    calibrated: Annotated[
        bool,
        typer.Option(
            "--calibrated/--nominal-mounting",
            help="Whether decenter and tilt are calibrated before a reconstruction (compensators).",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = True,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing file.", rich_help_panel=OptionGroup.OUTPUT)
    ] = False,
) -> None:
    """Write a study with the usual tolerances of a grade, as a starting point to edit.

    Its reconstructions follow the mounting of each lens, as after `wavesim calibrate`. With
    --nominal-mounting they assume the design, which takes a mount of a few micrometres.

    Example: tolerancing start lens.toml -o study.toml
    """
    from tolerancing.study.files import start_study

    if output.exists() and not force:
        raise InputError(f"{output} exists already; give another name, or --force to replace it")
    start_study(design, output, grade, calibrated)
    print(f"wrote {output}: edit it, then: tolerancing run {output} --store {output.with_suffix('.db')}")


def sensitivity(store: StorePath, merit: MeritName = None, as_json: Json = False) -> None:
    """Show the effect of each perturbation alone, the most harmful first.

    The root-sum-square prediction is shown beside the result of the trials.
    """
    from tolerancing.statistics.approximations import approximations
    from tolerancing.statistics.sensitivities import sensitivity
    from tolerancing.store.store import open_store

    with open_store(store) as opened:
        found, approximated = sensitivity(opened), approximations(opened)
    merits = [(k, m) for k, m in enumerate(found.study.merits) if merit in (None, m.label)]
    if not merits:
        allowed = ", ".join(m.label for m in found.study.merits)
        raise InputError(f"--merit {merit!r}: there is no such merit; allowed: {allowed}")
    if as_json:
        rows = found.as_dict()
        shown = {"merits": {m.column: rows[m.column] for _, m in merits}}
        print_json({"store": str(store), **shown, **_approximated(approximated)})
        return
    for k, one in merits:
        _print_sensitivity(found.study, found.found, k)
        row = found.compared[k]
        trials = f"trials {row.mean:.4g} ± {row.standard_deviation:.3g}"
        if row.good is not None:
            trials += f", {100.0 * row.good.fraction:.1f} %"
        print(
            f"{one.label}: root sum square {row.predicted_mean:.4g} ± "
            f"{row.predicted_standard_deviation:.3g}, {100.0 * row.predicted_yield:.1f} % good; {trials}"
        )
        print()
    for approximation in approximated:
        print(approximation.sentence)


def inverse(
    study: StudyFile,
    merit: MeritName = None,
    change: Annotated[
        float | None,
        typer.Option(
            help="Amount by which the merit may become worse; default: up to its limit.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Find the largest deviation of each perturbation alone that keeps a merit's limit."""
    from lensdesign.common.progress import progress_count
    from tolerancing.statistics.limits import inverse
    from tolerancing.study.files import load_study

    what = "lenses scored"
    with messages_only(), progress_count(what) as count:
        found = inverse(
            load_study(study, trust=trust),
            merit,
            change=change,
            progress=lambda n: count.advance(n, None, what),
        )
    if as_json:
        print_json({"study": str(study), "limits": found.as_dict()})
    else:
        _print_limits(found, change)


def budget(
    store: StorePath,
    required: Annotated[
        float,
        typer.Option(
            "--yield",
            help="Required fraction of good lenses, 0 to 1.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ],
    output: Annotated[Path, output_option("Study file with the new tolerances.")],
    weight: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN=WEIGHT",
            help="Cost of a tolerance relative to the others; may be repeated.",
            rich_help_panel=OptionGroup.TOLERANCES,
        ),
    ] = None,
    costs: Costs = None,
    process: Processes = None,
    verify: Annotated[
        int,
        typer.Option(
            min=20,
            help="Number of trials that verify each round of the search.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = 500,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Find the cheapest tolerances that keep a yield, from a run's trials, and write them as a study.

    Each result of the search is verified by random trials of another seed, until yield and requirement agree.
    An interrupted command writes the best tolerances found so far. Lenses are scored again: Python code in
    the store is executed only with --trust.

    Exit status: 0 for success, 1 if yield and requirement do not agree in the end, 2 for invalid input.
    """
    from lensdesign.common.progress import progress_count
    from lensdesign.common.text import duration_text
    from tolerancing.budgets.study_budget import (
        BudgetInterrupted,
        budget,
        most_seconds,
        scaled_study,
    )
    from tolerancing.statistics.approximations import approximations
    from tolerancing.store.store import open_store
    from tolerancing.study.files import save_study

    interrupted, weights, base_cost = False, _weights(weight or []), 0.0
    if weights and (costs or process):
        raise InputError("--weight and --costs both set the cost of tolerances; give only one of them")
    with open_store(store, trust=trust) as opened:
        study, fixed, approximated = opened.study, list[str](), approximations(opened)
        if costs or process:
            priced = priced_study(study, opened.loaded.lens, costs, process)
            weights = {line.perturbation: line.cost for line in priced.lines if line.quantity}
            fixed = [line.perturbation for line in priced.lines if not line.quantity]
            base_cost = float(priced.elements)
        try:
            with messages_only(), progress_count("trials of the lens") as count:

                def progress(completed: int, total: int) -> None:
                    if not completed:
                        expected = duration_text(most_seconds(opened, verify))
                        print(f"at most {total} trials of the lens, about {expected}", file=sys.stderr)
                    count.update(completed, total, "trials of the lens")

                found = budget(
                    opened,
                    required,
                    weights,
                    fixed=fixed,
                    base_cost=base_cost,
                    fresh=verify,
                    progress=progress,
                )
        except BudgetInterrupted as stop:
            if stop.found is None:
                raise KeyboardInterrupt(
                    "interrupted; no tolerances that keep the yield have been found yet"
                ) from None
            found, interrupted = stop.found, True
        save_study(scaled_study(opened.loaded, found.budget.scales), output)
    if as_json:
        result = _budget_dict(study, found)
        complete = {"complete": not interrupted, **_approximated(approximated)}
        print_json({"store": str(store), "study": str(output), **complete, **result})
    else:
        _print_budget(study, found)
        for one in approximated:
            print(one.sentence)
        print(f"wrote {output}")
    if interrupted:
        raise KeyboardInterrupt(f"interrupted; {output} holds the best tolerances found so far")
    if not found.agrees:
        raise typer.Exit(1)


def cost(
    study: StudyFile,
    costs: Costs = None,
    process: Processes = None,
    as_json: Json = False,
) -> None:
    """Show the relative cost of each tolerance of a study, the most expensive first."""
    from tolerancing.study.files import load_study

    loaded = load_study(study)
    found = priced_study(loaded.study, loaded.lens, costs, process)
    if as_json:
        print_json({"study": str(study), **found.as_dict()})
        return
    rows = [
        (
            line.perturbation,
            f"{line.process} {line.quantity}".strip(),
            f"{line.tolerance:.4g}",
            f"{line.cost:.3f}",
        )
        for line in sorted(found.lines, key=lambda line: -line.cost)
    ]
    last = ("total, with the cost of the elements", "", "", f"{found.total:.3f}")
    print_table(
        "relative cost of tolerances", ["perturbation", "priced as"], ["tolerance", "cost"], rows, last
    )


def priced_study(study: Study, lens: Lens, costs: str | None, processes: list[str] | None) -> Cost:
    """Return the cost of a study by the table and the processes given to a command."""
    from tolerancing.cost.pricing import cost_of
    from tolerancing.cost.table import load_costs

    items: dict[int | None, str] = {}
    for item in processes or []:
        number, equals, name = item.rpartition("=")
        if equals and not (number.isdigit() and 1 <= int(number) <= len(lens.glass_fronts)):
            raise InputError(
                f"--process {item!r}: must be NAME or N=NAME, N from 1 to {len(lens.glass_fronts)}"
            )
        items[int(number) if equals else None] = name
    table = load_costs(None if costs in (None, "relative") else costs).with_processes(items)
    return cost_of(study, lens, table)


def _approximated(found: Sequence[Approximation]) -> dict[str, list[dict[str, Any]]]:
    """Return the approximated merits for JSON; an empty dict without any."""
    if not found:
        return {}
    return {"approximated": [one.as_dict() for one in found]}


def _weights(items: list[str]) -> dict[str, float]:
    weights = {}
    for item in items:
        name, _, text = item.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0.0 < value < float("inf"):
            raise InputError(f"--weight {item!r}: must be COLUMN=WEIGHT with a weight above 0")
        weights[name] = value
    return weights


def _print_sensitivity(study: Study, found: Sensitivity, k: int) -> None:
    merit = study.merits[k]
    rows = [
        (
            study.perturbations[i].column,
            _tolerance(study.perturbations[i]),
            f"{found.change[i, 0, k]:+.4f}",
            f"{found.change[i, -1, k]:+.4f}",
            f"{found.standard_deviation[i, k]:.4f}",
        )
        for i in found.ranking(study.merits)[k]
    ]
    title = f"{merit.label}: nominal {found.nominal[k]:.4g}, {merit.limit_text}"
    _print_table(title, ["tolerance T", "at -T", "at +T", "std. dev."], rows)


def _print_limits(found: StudyLimits, change: float | None) -> None:
    from tolerancing.statistics.limits import SHAPES

    study = found.study
    for label, own in found.limits.items():
        (merit,) = (m for m in study.merits if m.label == label)
        limit_text = (
            merit.limit_text if change is None else number_with_unit(f"worse by {change:g}", merit.unit)
        )
        rows = [
            (
                perturbation.column,
                _tolerance(perturbation),
                "never" if limit.below is None else f"{-limit.below:.4g}",
                "never" if limit.above is None else f"{limit.above:+.4g}",
            )
            for perturbation, limit in zip(study.perturbations, own, strict=True)
        ]
        title = f"{label}: largest deviation of each perturbation alone ({limit_text})"
        _print_table(title, ["tolerance", "down to", "up to"], rows)
    if any(p.is_irregularity for p in study.perturbations):
        print(f"irregularities: the worst of {SHAPES} random shapes of each size")


def _budget_dict(study: Study, found: StudyBudget) -> dict[str, Any]:
    budget = found.budget
    return {
        "scales": {p.column: float(s) for p, s in zip(study.perturbations, budget.scales, strict=True)},
        "required_yield": found.required,
        "agrees": found.agrees,
        "verified_yield": None if found.verified is None else found.verified.as_dict(),
        "verified_seed": found.seed,
        "estimated_yield": found.estimated_yield,
        "estimated_yield_error": found.estimated_yield_error,
        "yield_before": None if found.yield_before is None else found.yield_before.as_dict(),
        "cost": found.cost,
        "cost_before": found.cost_before,
        "uniform_scale": budget.uniform_scale,
        "uniform_cost": found.uniform_cost,
    }


def _print_budget(study: Study, found: StudyBudget) -> None:
    rows = [
        (p.column, _tolerance(p), f"{scale:.3f}", _tolerance(p, scale))
        for p, scale in zip(study.perturbations, found.budget.scales.tolist(), strict=True)
    ]
    title = f"cheapest tolerances for a yield of {100.0 * found.required:g} %"
    _print_table(title, ["was", "scale", "tolerance"], rows)
    budget, good = found.budget, found.verified
    costs = [
        ("tolerances of the study", "1.000", f"{found.cost_before:.4g}"),
        ("these tolerances", "", f"{found.cost:.4g}"),
    ]
    if budget.uniform_scale is not None:
        common = (
            "all tolerances scaled by one factor",
            f"{budget.uniform_scale:.3f}",
            f"{found.uniform_cost:.4g}",
        )
        costs.insert(1, common)
    print_table("", ["cost"], ["scale", ""], costs)
    if (own := found.yield_before) is not None:
        print(
            f"trials with the tolerances of the study: {100.0 * own.fraction:.1f} % good "
            f"({100.0 * own.low:.1f} to {100.0 * own.high:.1f} % of {own.total})"
        )
    if good is None:
        print("not verified by trials")
        return
    print(
        f"{good.total} fresh trials (seed {found.seed}): {100.0 * good.fraction:.1f} % good "
        f"({100.0 * good.low:.1f} to {100.0 * good.high:.1f} %)"
    )
    if found.estimated_yield is not None and found.estimated_yield_error is not None:
        interval = 100.0 * 1.96 * found.estimated_yield_error
        print(f"with the model as control variate: {100.0 * found.estimated_yield:.1f} ± {interval:.1f} %")
    if not found.agrees:
        say("not met:", "yield and requirement do not agree; allow more trials (--verify)")


def _tolerance(perturbation: Perturbation, scale: float = 1.0) -> str:
    return number_with_unit(f"{scale * perturbation.tolerance:.4g}", perturbation.unit)


def _print_table(title: str, numbers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    print_table(title, ["perturbation"], numbers, rows)
