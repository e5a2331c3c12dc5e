"""Commands about tolerances themselves: where to start, what harms, how far one may go, what to spend."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from tolerancing.analysis.inverse import InverseLimit
    from tolerancing.analysis.sensitivity import Sensitivity
    from tolerancing.analysis.study_budget import StudyBudget
    from tolerancing.merits.base import Merit
    from tolerancing.study.study import Study

StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="Store that a run made.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
MeritName = Annotated[str | None, typer.Option("--merit", help="Only this merit, by its name.")]


def start(
    design: Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file (TOML).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Study file to write.")],
    grade: Annotated[
        str, typer.Option(help="commercial, precision, high_precision, or iso10110 (general tolerances).")
    ] = "precision",
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a study with usual tolerances of a grade, to be edited."""
    import os

    from lensdesign.errors import atomic_path
    from lensdesign.files.design import load_design
    from tolerancing.perturbations.grades import starting_study

    lens = load_design(design)
    if output.exists() and not force:
        raise InputError(f"{output} is there already; give another name, or --force to replace it")
    name = Path(os.path.relpath(design.resolve(), output.resolve().parent)).as_posix()
    text = starting_study(lens, name, grade)
    with atomic_path(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    print(f"wrote {output}: edit it, then: tolerancing run {output} --store {output.with_suffix('.db')}")


def sensitivity(store: StorePath, merit: MeritName = None, as_json: Json = False) -> None:
    """Show what each perturbation does alone, the most harmful first.

    With the root-sum-square prediction beside the trials.
    """
    from tolerancing.analysis.scorer import study_sensitivities
    from tolerancing.analysis.sensitivity import compare_with_trials, root_sum_square
    from tolerancing.store.store import open_store

    with open_store(store) as opened:
        study = opened.study
        chosen = _chosen(study, merit)
        found = study_sensitivities(study, opened.nominal(), opened.steps())
        compared = compare_with_trials(root_sum_square(found, study.merits), opened.trials().scores)
    if as_json:
        print_json({"store": str(store), "merits": {m.column: _as_dict(study, found, k) for k, m in chosen}})
        return
    for k, one in chosen:
        _print_sensitivity(study, found, k)
        row = compared[k]
        trials = f"trials {row.mean:.4g} ± {row.standard_deviation:.3g}"
        if row.good is not None:
            trials += f", {100.0 * row.good.share:.1f} %"
        print(
            f"{one.label}: root sum square {row.predicted_mean:.4g} ± "
            f"{row.predicted_standard_deviation:.3g}, {100.0 * row.predicted_share:.1f} % good; {trials}"
        )
        print()


def inverse(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")],
    merit: MeritName = None,
    change: Annotated[
        float | None, typer.Option(help="By how much the merit may become worse; by default to its limit.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find how far each perturbation may go by itself before a merit misses its limit."""
    from lensdesign.common.console import progress_bar
    from tolerancing.analysis.inverse import inverse_limits
    from tolerancing.analysis.scorer import StudyScorer, scatter_of
    from tolerancing.study.evaluate import context_of, decide_levels, nominal_scores
    from tolerancing.study.files import load_study

    loaded = load_study(study)
    own = loaded.study.with_levels(decide_levels(loaded.lens, loaded.study))
    if change is not None and merit is None and len(own.merits) > 1:
        raise InputError("--change is in one merit's unit: name it with --merit")
    context = context_of(loaded.lens, own)
    nominal = nominal_scores(context, own)
    scores = [nominal[m.label] for m in own.merits]
    limits: dict[str, tuple[InverseLimit, ...]] = {}
    with progress_bar() as bar:
        task = bar.add_task("lenses scored", total=None)
        scorer = StudyScorer(context, own, lambda count: bar.advance(task, count))
        for k, one in _chosen(own, merit):
            limits[one.label] = inverse_limits(scorer, scores, scatter_of(own).tolerance, one, k, change)
    if as_json:
        print_json({"study": str(study), "limits": {m: _limits_dict(own, v) for m, v in limits.items()}})
        return
    _print_limits(own, limits, change)


def budget(
    store: StorePath,
    required: Annotated[float, typer.Option("--yield", help="Share of good parts to keep, 0 to 1.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Study file with the new tolerances.")],
    weight: Annotated[
        list[str] | None,
        typer.Option(help="COLUMN=WEIGHT: what a tolerance costs, over the others; several times."),
    ] = None,
    verify: Annotated[int, typer.Option(help="Trials of the lens itself, and as many fresh ones.")] = 500,
    as_json: Json = False,
) -> None:
    """Find the loosest tolerances that keep a yield, from a run's trials, and write them as a study."""
    from lensdesign.common.console import progress_bar
    from tolerancing.analysis.study_budget import budget_of_study, write_scaled_study
    from tolerancing.store.store import open_store

    with open_store(store) as opened, progress_bar() as bar:
        loaded, trials = opened.loaded, opened.trials()
        task = bar.add_task("fresh trials", total=None)
        found = budget_of_study(
            loaded.lens,
            loaded.study,
            trials.values,
            trials.scores,
            required,
            _weights(weight or []),
            fresh=verify,
            report=lambda count: bar.advance(task, count),
        )
        write_scaled_study(loaded, found.budget.scales, output)
    if as_json:
        print_json({"store": str(store), "study": str(output), **_budget_dict(loaded.study, found)})
    else:
        _print_budget(loaded.study, found, required)
        print(f"wrote {output}")


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


def _chosen(study: Study, name: str | None) -> list[tuple[int, Merit]]:
    labels = [m.label for m in study.merits]
    if name is not None and name not in labels:
        raise InputError(f"--merit {name!r}: there is no such merit; allowed: {', '.join(labels)}")
    return [(k, m) for k, m in enumerate(study.merits) if name in (None, m.label)]


def _as_dict(study: Study, found: Sensitivity, k: int) -> list[dict[str, Any]]:
    return [
        {
            "perturbation": study.perturbations[i].column,
            "tolerance": study.perturbations[i].distribution.largest,
            "derivative": found.derivative[i, k],
            "change_at_minus_tolerance": found.change[i, 0, k],
            "change_at_plus_tolerance": found.change[i, -1, k],
            "quadratic_coefficients": found.coefficients[i, :, k].tolist(),
            "residual": found.residual[i, k],
            "standard_deviation": found.standard_deviation[i, k],
        }
        for i in found.ranking(study.merits)[k]
    ]


def _print_sensitivity(study: Study, found: Sensitivity, k: int) -> None:
    merit = study.merits[k]
    table = _table(f"{merit.label}: nominal {found.nominal[k]:.4g}, {merit.limit_text}")
    for heading in ("tolerance T", "at -T", "at +T", "std. dev."):
        table.add_column(heading, justify="right")
    for i in found.ranking(study.merits)[k]:
        perturbation = study.perturbations[i]
        table.add_row(
            perturbation.column,
            f"{perturbation.distribution.largest:.4g} {perturbation.unit}".strip(),
            f"{found.change[i, 0, k]:+.4f}",
            f"{found.change[i, -1, k]:+.4f}",
            f"{found.standard_deviation[i, k]:.4f}",
        )
    _print(table)


def _limits_dict(study: Study, limits: tuple[InverseLimit, ...]) -> dict[str, Any]:
    return {p.column: vars(limit) for p, limit in zip(study.perturbations, limits, strict=True)}


def _print_limits(study: Study, limits: dict[str, tuple[InverseLimit, ...]], change: float | None) -> None:
    for label, own in limits.items():
        (merit,) = (m for m in study.merits if m.label == label)
        asked = merit.limit_text if change is None else f"worse by {change:g} {merit.unit}".strip()
        table = _table(f"{label}: how far each may go by itself ({asked})")
        for heading in ("tolerance", "down to", "up to"):
            table.add_column(heading, justify="right")
        for perturbation, limit in zip(study.perturbations, own, strict=True):
            table.add_row(
                perturbation.column,
                f"{perturbation.distribution.largest:.4g} {perturbation.unit}".strip(),
                "never" if limit.below is None else f"{-limit.below:.4g}",
                "never" if limit.above is None else f"{limit.above:+.4g}",
            )
        _print(table)


def _budget_dict(study: Study, found: StudyBudget) -> dict[str, Any]:
    return {
        "scales": {p.column: float(s) for p, s in zip(study.perturbations, found.budget.scales, strict=True)},
        "verified_yield": vars(found.verified),
        "yield_before": vars(found.budget.before),
        "cost": found.budget.cost,
        "cost_before": found.budget.cost_before,
        "cross_validated_r_squared": {
            m.column: float(r)
            for m, r in zip(study.merits, found.response.cross_validated_r_squared, strict=True)
        },
    }


def _print_budget(study: Study, found: StudyBudget, required: float) -> None:
    table = _table(f"loosest tolerances for a yield of {100.0 * required:g} %")
    for heading in ("was", "scale", "tolerance"):
        table.add_column(heading, justify="right")
    for perturbation, scale in zip(study.perturbations, found.budget.scales, strict=True):
        largest, unit = perturbation.distribution.largest, perturbation.unit
        table.add_row(
            perturbation.column,
            f"{largest:.4g} {unit}".strip(),
            f"{scale:.3f}",
            f"{scale * largest:.4g} {unit}".strip(),
        )
    _print(table)
    good = found.verified
    print(
        f"{good.total} fresh trials: {100.0 * good.share:.1f} % good ({100.0 * good.low:.1f} - "
        f"{100.0 * good.high:.1f} %), cost {found.budget.cost:.4g}, was "
        f"{found.budget.cost_before:.4g}"
    )


def _table(title: str) -> Any:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("perturbation", no_wrap=True)
    return table


def _print(table: Any) -> None:
    from rich.console import Console

    Console().print(table)
