"""Commands that score further trials: yields of lenses that seldom fail, and variance-based indices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lensdesign.common.console import messages_only, print_json
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import Json, StudyFile, Trust, output_option
from tolerancing.cli.tables import print_table
from tolerancing.cli.tolerances import StorePath

if TYPE_CHECKING:
    from tolerancing.statistics.indices import VarianceIndices
    from tolerancing.statistics.rare_failures import RareYield


TRIALS = "trials of the lens"
"""What the progress counts."""


def rare(
    store: StorePath,
    trials: Annotated[
        int,
        typer.Option(help="Number of further trials of the lens.", rich_help_panel=OptionGroup.EVALUATION),
    ] = 500,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Estimate the yield of a lens that seldom fails, by trials where a model expects failures.

    The model is fitted to the store's trials. The yield is unbiased even if the model is wrong. Nothing is
    written to the store. Python code in the store is executed only with --trust.
    """
    from lensdesign.common.progress import progress_count
    from tolerancing.statistics.rare_failures import rare_yield
    from tolerancing.store.store import open_store

    with open_store(store, trust=trust) as opened, messages_only(), progress_count(TRIALS) as count:
        found = rare_yield(opened, trials, progress=lambda rows: count.advance(rows, trials, TRIALS))
    if as_json:
        print_json({"store": str(store), **found.as_dict()})
    else:
        _print_rare(found)


def indices(
    study: StudyFile,
    base: Annotated[
        int,
        typer.Option(
            help="A power of two; there are BASE x (perturbations + 2) trials.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = 256,
    output: Annotated[Path | None, output_option("Chart (png, svg or pdf).")] = None,
    trust: Trust = False,
    as_json: Json = False,
) -> None:
    """Compute which fraction of each merit's variance each perturbation causes, alone and with others.

    The results are first-order and total Sobol indices with 95 % intervals. Where the two differ, products of
    perturbations matter, which the sensitivity to each perturbation alone does not show.
    """
    from lensdesign.common.progress import progress_count
    from tolerancing.report.figures.indices import indices_figure
    from tolerancing.report.figures.style import figure_format, write_figure
    from tolerancing.statistics.indices import most_trials, variance_indices
    from tolerancing.study.files import load_study

    loaded = load_study(study, trust=trust)
    if output is not None:
        figure_format(output)
    total = most_trials(loaded.study, base)
    with messages_only(), progress_count(TRIALS) as count:
        found = variance_indices(loaded, base, progress=lambda rows: count.advance(rows, total, TRIALS))
        if output is not None:
            write_figure(indices_figure(found), output)
    if as_json:
        print_json({"study": str(study), "trials": found.trials, "merits": found.as_dict()})
        return
    _print_indices(found)
    if output is not None:
        print(f"wrote {output}")


def _print_rare(found: RareYield) -> None:
    print(
        f"yield {100.0 * found.fraction:.4g} % ({100.0 * found.low:.4g} - {100.0 * found.high:.4g} %): "
        f"{found.failed} of {found.trials} trials failed; most were drawn where failures are likely"
    )
    modelled = f"the model alone predicts {100.0 * found.modelled_yield:.4g} %"
    print(f"as precise as {found.plain_trials:.0f} plain trials; {modelled}")
    worst = min(
        zip(found.study.merits, found.cross_validated_r_squared.tolist(), strict=True), key=lambda m: m[1]
    )
    print(f"lowest cross-validated R2 of the model: {worst[1]:.3f}, of {worst[0].label}")


def _print_indices(found: VarianceIndices) -> None:
    for merit, own in zip(found.study.merits, found.as_dict().values(), strict=True):
        rows = [
            (
                row["perturbation"],
                *(
                    "-" if row[name] is None else f"{row[name]:.3f} ± {row[f'{name}_half_width']:.3f}"
                    for name in ("first", "total")
                ),
            )
            for row in own["indices"]
        ]
        print_table(
            f"{merit.label}: fractions of the variance, {found.trials} trials",
            ["perturbation"],
            ["first order", "total"],
            rows,
        )
        if own["share_of_products"] is not None:
            print(f"products of perturbations: {own['share_of_products']:.3f}")
        print()
