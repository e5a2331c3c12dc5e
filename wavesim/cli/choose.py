"""The command `wavesim choose-engine`: compare all engines on a scene, and name the one that is selected."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json
from lensdesign.common.text import finite_or_none
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from wavesim.cli.resolve import PlaneDistanceMm
from wavesim.cli.runs import print_table
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import DEFAULT_ERROR, ChoiceSettings

if TYPE_CHECKING:
    from wavesim.scene.scattered_light import Light
    from wavesim.scene.scene import Scene


@most_used(
    "object_",
    "patch_mm",
    "illumination",
    "wavelength_um",
    "error",
    "field_height_mm",
    "plane_distance_mm",
    "meridional",
    "runs",
    "memory_gb",
    "hours",
    "as_json",
)
def choose(
    design: Design,
    settings: ChoiceSettings,
    object_: Annotated[
        str,
        typer.Option(
            "--object",
            metavar="[usaf|star|phase|tissue|even]|FILE",
            help="usaf, star, phase, tissue, FILE, or even (a patch that sends light in all directions).",
            rich_help_panel=OptionGroup.OBJECT,
        ),
    ] = "usaf",
    error: Annotated[
        float,
        typer.Option(help="Allowed relative error of the exit field.", rich_help_panel=OptionGroup.ENGINE),
    ] = DEFAULT_ERROR,
    field_height_mm: Annotated[
        float,
        typer.Option(
            "--field-height-mm",
            "--field-mm",
            help="Height of the field point along y.",
            rich_help_panel=OptionGroup.OBJECT,
        ),
    ] = 0.0,
    plane_distance_mm: PlaneDistanceMm = 2.0,
    meridional: Annotated[
        bool,
        typer.Option(
            help="Use the meridional line of the object instead of a plane.",
            rich_help_panel=OptionGroup.EVALUATION,
        ),
    ] = False,
    runs: Annotated[
        int,
        typer.Option(
            help="Forward and adjoint runs that share the set-up.", rich_help_panel=OptionGroup.EVALUATION
        ),
    ] = 2,
    memory_gb: Annotated[
        float, typer.Option(help="Memory limit.", rich_help_panel=OptionGroup.OUTPUT)
    ] = 16.0,
    hours: Annotated[
        float,
        typer.Option(
            "--max-hours",
            "--hours",
            help="Time limit of all runs together.",
            rich_help_panel=OptionGroup.OUTPUT,
        ),
    ] = 1.0,
    as_json: Json = False,
) -> None:
    """Predict error, time and memory of every engine, and name the fastest within the limits.

    The predicted errors are for the light of the given object. The edge of the aperture, where ray-based
    engines are least accurate, receives from a chart only a twentieth of the light that it receives from
    an object that sends light in all directions.

    The engines are: eikonal, whose rays carry the phase and whose Fourier transforms carry the object;
    slices, thin slices of the lens; wpm, plane waves in zones of one refractive index; thin-lens, one plane
    that bends the light; no-lens, free space.

    Example: wavesim choose-engine lens.toml --error 0.01
    """
    from wavesim.engines.choosing import choose as choose_engine
    from wavesim.scene.patches import patch_scene

    lens = load_design(design)
    validate_lengths(lens, settings)
    validate_lengths(
        lens,
        {"field_height_mm": field_height_mm, "plane_distance_mm": plane_distance_mm},
        settings.wavelength_um,
    )
    scene = patch_scene(
        lens,
        settings.patch_mm,
        field_height_mm,
        plane_distance_mm=plane_distance_mm,
        wavelength_um=settings.wavelength_um,
        meridional=meridional,
        object_pitch_um=settings.object_pitch_um,
    )
    scene = settings.applied_to(scene)
    light = None
    # ``even`` is light of all directions on an evenly filled patch.
    if object_ != "even":
        scene, light = _lit_scene(lens, scene, object_, settings)
    choice = choose_engine(scene, error, memory_gb, 3600.0 * hours, runs, light)
    if as_json:
        print_json({"object": object_} | _choice_summary(choice, runs))
    else:
        print(f"object {object_}, patch {settings.patch_mm:g} mm, field height {field_height_mm:g} mm")
        _print_choice(choice, runs)


def _lit_scene(lens: Lens, scene: Scene, name: str, settings: ChoiceSettings) -> tuple[Scene, Light]:
    """Return the scene with the object's samples and the field behind it; for a line, its middle column."""
    from wavesim.fields.field import Field
    from wavesim.scene.scattered_light import Light
    from wavesim.targets.patch import lit_patch, make_target

    patch, illumination = lit_patch(lens, settings, settings.wavelength_um)
    target = make_target(
        patch,
        name,
        settings.ground,
        numerical_aperture=lens.object.numerical_aperture,
        picture_pixel_um=settings.picture_pixel_um,
        picture_width_mm=settings.picture_width_mm,
        chart_at_mm=settings.chart_at_mm,
    )
    values = illumination.values * target.transmission.values
    if scene.object_grid.is_line:
        values = values[:, values.shape[1] // 2]
    grid = replace(scene.object_grid, shape=values.shape)
    return replace(scene, object_grid=grid), Light(Field(grid, values, scene.wavelength_um))


def _choice_summary(choice: Any, runs: int) -> dict[str, Any]:
    return {
        "engine": choice.chosen.engine,
        "settings": choice.chosen.settings,
        "polarization": choice.chosen.polarization,
        "reason": choice.reason,
        "runs": runs,
        "predictions": [
            {
                "engine": p.engine,
                "settings": p.settings,
                "polarization": p.polarization,
                "relative_error": finite_or_none(p.relative_error),
                "seconds": finite_or_none(p.seconds),
                "setup_seconds": p.setup_seconds,
                "peak_mb": 1e-6 * p.peak_bytes,
                "neglected": p.neglected,
                "refused": p.refused or None,
            }
            for p in choice.predictions
        ],
    }


def _print_choice(choice: Any, runs: int) -> None:
    rows = []
    for p in choice.predictions:
        figures = (f"{p.relative_error:.2g}", f"{p.total_seconds(runs):.2g}", f"{p.peak_bytes / 1e6:.3g}")
        mark = "*" if p is choice.chosen else ""
        rows.append((mark, p.label, *(("refused", "", "") if p.refused else figures)))
    columns = ("predicted error", f"seconds, {runs} run(s)", "memory (MB)")
    print_table(("", "engine"), columns, rows)
    print()
    for sentence in choice.reason.split(". "):
        print(sentence.removesuffix("."))
