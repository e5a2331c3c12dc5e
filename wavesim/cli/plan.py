"""The command `wavesim plan`: recommend frames to record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json, output_option
from lensdesign.common.text import finite_or_none, visible
from lensdesign.files.design import load_design
from wavesim.cli.options import validate_picture_request
from wavesim.cli.runs import Run, print_table
from wavesim.scene.settings import PlanSettings

if TYPE_CHECKING:
    from wavesim.calibration.planning import Plan, Plans


@most_used(
    "output",
    "object_",
    "kind",
    "patch_mm",
    "planes_mm",
    "most_planes",
    "exposures",
    "correlation",
    "full_well_electrons",
    "as_json",
)
def plan(
    design: Design,
    settings: PlanSettings,
    object_: Annotated[
        str | None,
        typer.Option(
            "--object",
            metavar="[usaf|star|phase|tissue]|FILE",
            help="An example of what will be imaged: usaf, star, phase, tissue, or FILE (a picture). Its "
            "correlation is predicted, and decides which plan is recommended.",
            rich_help_panel=OptionGroup.OBJECT,
        ),
    ] = None,
    output: Annotated[
        Path | None, output_option("Figure of error against planes to write (png, svg, pdf).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Recommend the number, positions and exposures of the recording planes, and predict the correlation.

    For each plan, several random objects of the given kind are imaged with noise and reconstructed through a
    scaled-down copy of the lens. The prediction is the range of their correlations. The recommended plan has
    the fewest frames with which all objects reach --correlation. With --object, an example of what will be
    imaged is tried as well: its prediction is a single value, and decides. The assumptions are listed.
    """
    from wavesim.calibration.plan_figure import plans_figure
    from wavesim.calibration.planning import plan_frames
    from wavesim.plots.frames import save

    validate_picture_request(output)
    lens = load_design(design)
    run = Run(as_json, resumes=False)
    with run.computing() as on_progress:
        found = plan_frames(lens, settings, example=object_, progress=on_progress)
    title = lens.title or design.stem
    if output is not None:
        save(plans_figure(found, f"{title}\n{settings.kind} object, {_twin(found)}"), output, dpi=120)

    def show(summary: dict[str, Any]) -> None:
        print(visible(title))
        _print(found)
        if output is not None:
            typer.echo(f"wrote {output}")

    run.report(_summary(found, title, run.messages), show)


def _summary(found: Plans, title: str, messages: list[str]) -> dict[str, Any]:
    from wavesim.calibration.planning import TRIAL_OBJECTS

    return {
        "design": title,
        "kind": found.settings.kind,
        "correlation_asked": found.settings.correlation,
        "enough": found.enough,
        "diversity": found.diversity,
        "twin": found.twin._asdict(),
        "engine_error": finite_or_none(found.engine_error),
        "objects": [
            {"name": name, "description": TRIAL_OBJECTS[name].description, "changes_of_amplitude": strength}
            for name, strength in found.strengths.items()
            if name in TRIAL_OBJECTS
        ],
        "described": {
            "name": found.example,
            "changes_of_amplitude": found.example_strength,
            "twin": found.example_twin._asdict(),
        }
        if found.example_twin is not None
        else None,
        "assumptions": list(found.assumptions),
        "plans": [_plan_values(plan) | {"recommended": plan is found.recommended} for plan in found.plans],
        "warnings": messages,
    }


def _plan_values(plan: Plan) -> dict[str, Any]:
    return {
        "planes_mm": list(plan.planes_mm),
        "exposures": list(plan.exposures),
        "frames": plan.frames,
        "correlation": plan.correlation,
        "highest_correlation": plan.highest_correlation,
        "correlation_by_object": dict(plan.by_object),
        "predicted_correlation": finite_or_none(plan.predicted),
        "oversampling": finite_or_none(plan.ratio),
        "information": None if plan.information is None else plan.information.as_dict(),
        "smooth_fraction": finite_or_none(plan.smooth_fraction),
        "error": plan.error,
        "misfit_over_noise": plan.misfit_over_noise,
        "iterations": plan.iterations,
    }


def _twin(found: Plans) -> str:
    twin = found.twin
    lens = "the lens itself" if twin.scale == 1.0 else f"the lens scaled by {twin.scale:.3g}"
    return f"simulated on {lens}, patch {twin.patch_mm:.3g} mm"


def _print(found: Plans) -> None:
    from wavesim.calibration.planning import TRIAL_OBJECTS

    print(f"{found.settings.kind} object; {_twin(found)}")
    trials = [name for name in found.strengths if name in TRIAL_OBJECTS]
    rows = [
        (
            "*" if plan is found.recommended else "",
            ", ".join(f"{z:.4g}" for z in plan.planes_mm),
            ", ".join(f"{e:g}" for e in plan.exposures),
            f"{plan.frames}",
            f"{plan.ratio:.2f}",
            *([] if plan.information is None else [f"{100.0 * plan.information.fraction:.1f} %"]),
            *([f"{plan.predicted:.4f}"] if found.example else []),
            *(f"{plan.by_object[name]:.4f}" for name in trials),
            f"{plan.misfit_over_noise:.2f}",
        )
        for plan in found.plans
    ]
    objects = (name.replace(" ", "\n") for name in [*(["described"] if found.example else []), *trials])
    columns = ("frames", "pixels /\nunknown", "deter-\nmined", *objects, "misfit\nover noise")
    print_table(("", "planes (mm)", "exposures"), columns, rows, "expected correlation of each object")
    print(
        f"phase diversity of the planes {found.diversity:.3g}, in the simulation {found.twin.diversity:.3g}"
    )
    best = found.recommended
    asked = f"a correlation of {found.settings.correlation:g}"
    expected = f"expected {best.correlation:.4f} to {best.highest_correlation:.4f}, depending on the object"
    whom = "all objects"
    if found.example:
        expected, whom = f"predicted {best.predicted:.4f}", visible(found.example)
    if found.enough:
        print(f"* recommended: the fewest frames that reach {asked} for {whom}; {expected}")
    else:
        more = "more light" if found.at_noise else "more planes, a wider range of them, or a smaller patch"
        print(f"* the best plan, but none reaches {asked} for {whom}: use {more}; {expected}")
    print("The prediction assumes:")
    for line in found.assumptions:
        print(f"- {line}")
