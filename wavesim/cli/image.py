"""The command `wavesim image`: compute frames of an object as the design's sensor records them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.option_groups import OptionGroup, most_used
from lensdesign.common.options import Design, Json
from lensdesign.common.text import visible
from lensdesign.errors import InputError
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import read_bench_state
from wavesim.cli.options import Output, settings_text
from wavesim.cli.runs import Run, print_table
from wavesim.runtime.result import versions
from wavesim.scene.patches import OBJECT_FINENESS
from wavesim.scene.settings import ImageSettings
from wavesim.targets.patch import layer_file

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from wavesim.scene.system_state import SystemState
    from wavesim.sensor.imaging import Imaged
    from wavesim.sensor.recording import Recording


@most_used(
    "output",
    "object_",
    "patch_mm",
    "illumination",
    "wavelength_um",
    "planes_mm",
    "pixels",
    "noise",
    "exposures",
    "engine",
    "error",
    "state",
    "as_json",
)
def image(
    design: Design,
    output: Output,
    settings: ImageSettings,
    object_: Annotated[
        list[str] | None,
        typer.Option(
            "--object",
            metavar="[usaf|star|phase|tissue|empty]|FILE",
            help="usaf, star, phase, tissue, empty, or FILE (a picture); default: usaf. With --layers-um, "
            "repeated for each layer.",
            rich_help_panel=OptionGroup.OBJECT,
        ),
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(
            help="Deviations of the system from the design: calibration.json of `wavesim calibrate`, or any "
            "file with a state. Omit the options for such deviations.",
            rich_help_panel=OptionGroup.INPUT,
        ),
    ] = None,
    all_wavelengths: Annotated[
        bool,
        typer.Option(
            help="Record one after the other at each wavelength of --wavelengths-um, or of the design; each "
            "in its own subfolder.",
            rich_help_panel=OptionGroup.ILLUMINATION,
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Simulate frames of an object, and write them with the true object, previews and all settings.

    Frames are 16-bit TIFF files that contain their settings. By default, they cover the central part of the
    sensor on which light falls. With several exposures, the long ones show faint light and are saturated
    where it is bright.

    A run on a whole field (--hierarchical) stores its finished parts. After an interrupt, repeat the
    command to continue.

    Example: wavesim image lens.toml --object usaf --patch-mm 0.1 -o frames
    """
    from wavesim.runtime.result_files import remove_unfinished

    remove_unfinished(output)
    lens = load_design(design)
    true_state = read_bench_state(state, lens)
    name, summaries = lens.title or design.stem, list[dict[str, Any]]()
    for folder, chosen in _runs(lens, settings, true_state, output, all_wavelengths):
        summaries.append(_recorded(lens, name, object_ or ["usaf"], chosen, true_state, folder, as_json))
        if not as_json:
            _print(summaries[-1], folder)
    if as_json:
        print_json({"images": summaries} if all_wavelengths else summaries[0])


def _runs(
    lens: Lens, settings: ImageSettings, state: SystemState | None, output: Path, all_wavelengths: bool
) -> list[tuple[Path, ImageSettings]]:
    """Output folder and settings of a recording."""
    if not all_wavelengths:
        return [(output, settings)]
    if settings.wavelength_um is not None:
        raise InputError("--all-wavelengths, --wavelength-um: give only one of them")
    if settings.colour_filters != "monochrome":
        raise InputError("--all-wavelengths, --colour-filters: give only one of them")
    several, pitch_um = settings.wavelengths_um, settings.object_pitch_um
    if several is not None and pitch_um is None:
        # The samples of all wavelengths are those that the shortest one needs.
        pitch_um = OBJECT_FINENESS * 0.5 * min(several) / lens.object.numerical_aperture
    alone = settings.replaced(wavelengths_um=None, object_pitch_um=pitch_um)
    if several is not None and settings.pixels is None:
        from wavesim.sensor.imaging import common_pixels

        alone = alone.replaced(pixels=common_pixels(lens, alone, several, state))
    return [
        (output / f"{wavelength:g}_um", alone.replaced(wavelength_um=wavelength))
        for wavelength in several or lens.wavelengths_um
    ]


def _recorded(
    lens: Lens,
    name: str,
    object_: list[str],
    settings: ImageSettings,
    state: SystemState | None,
    output: Path,
    as_json: bool,
) -> dict[str, Any]:
    """Record frames, write the files, and return the summary."""
    from wavesim.sensor.imaging import image as record
    from wavesim.sensor.recording import drop_parts

    run = Run(as_json)
    with run.computing() as on_progress:
        imaged = record(
            lens,
            object_,
            settings,
            state=state,
            folder=output,
            progress=on_progress,
            on_estimate=run.tells_memory(output),
        )
    summary = {"design": name} | _summary(imaged) | {"warnings": run.messages}
    summary["files"] = [str(output / file) for file in _write(imaged, summary, output)]
    drop_parts(output)
    return summary


def _summary(imaged: Imaged) -> dict[str, Any]:
    from wavesim.scene.engine import engine_summary
    from wavesim.scene.state_files import STATE, state_table

    patch, recording, settings = imaged.patch, imaged.recording, imaged.settings
    return {
        "object": {
            "name": imaged.target.name,
            "ground": imaged.target.polarity,
            "elements": len(imaged.target.elements),
            "patch_mm": patch.grid.shape[0] * patch.grid.pitch_mm,
            "field_stop_mm": patch.field_stop_mm,
            "field_stop_at_mm": list(patch.field_stop_at_mm),
            "pitch_um": 1e3 * patch.grid.pitch_mm,
            "samples": patch.grid.shape[0],
            **_finest(imaged),
            **_layers(imaged),
        },
        "illumination": settings.illumination,
        "polarization": imaged.engine.scene.polarization,
        "coating": settings.coating or "design",
        "wavelength_um": patch.wavelength_um,
        **_colours(imaged),
        "engine": engine_summary(imaged.engine, imaged.predicted_error),
        "pose": vars(settings.pose),
        "errors": settings.errors(),
        "sensor": {
            "pixel_pitch_um": imaged.sensor.pixel_pitch_um,
            "pixels": list(imaged.sensor.pixels),
            **recording.camera.electronics.model_dump(mode="json", exclude_none=True),
            "seed": recording.seed,
            "stage_errors_mm": [
                recording.state.sensor_pose(n).distance_mm for n in range(len(recording.plane_distances_mm))
            ],
            "shift_um": list(settings.shift_um),
        },
        STATE: state_table(recording.state),
        "frames": [
            {
                "file": name,
                "plane_distance_mm": frame.settings.plane_distance_mm,
                "exposure": frame.settings.exposure,
                "times": times,
                "brightest_counts": int(frame.counts.max()),
                "saturated_pixels": int(frame.saturated.sum()),
            }
            for (name, times), frame in zip(_names(recording), imaged.frames, strict=True)
        ],
        "diversity": imaged.diversity,
        **_scattered(imaged),
        "energy_share_beyond_pixel_limit": imaged.share_beyond_pixels,
        "pixel_limit_per_mm": 500.0 / imaged.sensor.pixel_pitch_um,
        "memory": imaged.memory.as_dict(),
        "versions": versions(),
    }


def _scattered(imaged: Imaged) -> dict[str, Any]:
    """Describe the light that rough surfaces scatter; empty without a rough surface."""
    found = imaged.scattered
    if found is None:
        return {}
    return {
        "scattered_light": {
            "fraction": found.mean_fraction,
            "half_width_deg": found.half_width_deg,
            "halo_radius_mm": list(found.halo_radius_mm),
            "interference_rms": found.interference_rms,
        }
    }


def _colours(imaged: Imaged) -> dict[str, Any]:
    """Describe the wavelengths that are recorded at once, and the filters; empty for one wavelength."""
    colours = imaged.recording.camera.colours
    return {} if colours is None else {"colours": colours.model_dump(mode="json")}


def _finest(imaged: Imaged) -> dict[str, Any]:
    """Describe the finest element of a chart, and the reason why it has no finer ones."""
    from wavesim.metrics.charts import chart_end
    from wavesim.scene.scene import diffraction_limit_um

    elements = imaged.target.elements
    if not elements:
        return {}
    passed_um = diffraction_limit_um(imaged.engine.scene.lens, imaged.patch.wavelength_um)
    return {
        "finest_line_um": min(one.line_width_um for one in elements),
        "finest_limited_by": chart_end(elements, 1e3 * imaged.patch.grid.pitch_mm),
        "aperture_passes_um": passed_um,
    }


def _layers(imaged: Imaged) -> dict[str, Any]:
    """Describe the layers of an object of several; empty for other objects."""
    if not imaged.layers:
        return {}
    named = zip(imaged.settings.layers_um or (), imaged.layers, strict=True)
    return {
        "layers": [
            {"distance_um": distance, "name": layer.name, "file": layer_file(index)}
            for index, (distance, layer) in enumerate(named, start=1)
        ]
    }


def _names(recording: Recording) -> list[tuple[str, float]]:
    """Describe the frames with their exposures, relative to the one for the brightest pixel."""
    planes = range(1, len(recording.plane_distances_mm) + 1)
    if len(recording.camera.exposures) == 1:
        return [(f"frame_{number}.tif", recording.camera.exposures[0]) for number in planes]
    return [
        (f"frame_{number}_{place}.tif", times)
        for number in planes
        for place, times in enumerate(recording.camera.exposures, start=1)
    ]


def _write(imaged: Imaged, summary: dict[str, Any], output: Path) -> list[str]:
    """Return the names of the written files."""
    from wavesim.fields.files import write_field
    from wavesim.plots.frames import frames_figure, save
    from wavesim.plots.objects import layers_figure, object_figure
    from wavesim.plots.pyramid import write_pyramid
    from wavesim.runtime.result_files import new_results, write_json
    from wavesim.sensor.frames import write_frame
    from wavesim.targets.patch import object_file

    patch, transmission = imaged.patch, imaged.target.transmission
    with new_results(output) as folder:
        for entry, frame in zip(summary["frames"], imaged.frames, strict=True):
            write_frame(frame, folder / entry["file"])
        x_mm, y_mm = patch.field_stop_at_mm
        of_stop = {"field_stop_mm": patch.field_stop_mm, "field_stop_x_mm": x_mm, "field_stop_y_mm": y_mm}
        write_field(transmission, folder / "object.npz", **of_stop)
        for one in imaged.coloured:
            write_field(one, folder / object_file(one.wavelength_um), **of_stop)
        for quantity, name in (("amplitude", "object_amplitude.tif"), ("phase_rad", "object_phase.tif")):
            write_pyramid(transmission.values, folder / name, 1e3 * patch.grid.pitch_mm, (quantity,))
        for index, layer in enumerate(imaged.layers, start=1):
            write_field(layer.transmission, folder / layer_file(index), **of_stop)
        colours = imaged.recording.camera.colours
        at_once = (patch.wavelength_um,) if colours is None else colours.wavelengths_um
        light = ", ".join(f"{one:g}" for one in at_once) + " µm"
        title = f"{summary['design']}\nobject {imaged.target.name}, {light}, {patch.stop_words}"
        drawn = object_figure(transmission, patch.inside, title, elements=imaged.target.elements)
        save(drawn, folder / "object.png")
        if imaged.layers:
            stack = [layer.transmission for layer in imaged.layers]
            drawn = layers_figure(imaged.settings.layers_um or (), stack, patch.inside, title)
            save(drawn, folder / "layers.png")
        sensor = f"{light}, pixels of {imaged.sensor.pixel_pitch_um:g} µm"
        save(frames_figure(imaged.frames, f"{summary['design']}\n{sensor}"), folder / "frames.png")
        names = sorted(path.name for path in folder.iterdir())
        write_json(summary | {"files": [*names, "image.json"]}, folder / "image.json")
        return [*names, "image.json"]


def _print(summary: dict[str, Any], output: Path) -> None:
    from wavesim.scene.polarization import is_vector, polarization_text
    from wavesim.targets.patch import stop_words

    engine, sensor, thing = summary["engine"], summary["sensor"], summary["object"]
    across, down = sensor["pixels"]
    error = engine["predicted_error"]
    predicted = "unknown" if error is None else f"{error:.2g} for the light of this object"
    print(visible(str(summary["design"])))
    print(
        f"object {thing['name']}, {stop_words(thing['field_stop_mm'], thing['field_stop_at_mm'])}, "
        f"{thing['samples']} x {thing['samples']} samples of {thing['pitch_um']:.4g} µm"
    )
    if "finest_line_um" in thing:
        ends = {
            "sampling": "limited by the sampling (a smaller --object-pitch-um shows finer ones)",
            "chart": "the finest of the chart",
        }[thing["finest_limited_by"]]
        print(
            f"finest lines {thing['finest_line_um']:.3g} µm: {ends}; "
            f"the aperture passes {thing['aperture_passes_um']:.3g} µm (wavelength / 2 NA)"
        )
    for layer in thing.get("layers", ()):
        print(f"  layer at {layer['distance_um']:g} µm: {layer['name']}")
    print(f"engine {engine['name']}, predicted relative error {predicted}")
    print(f"  {settings_text(engine['settings'])}")
    if "colours" in summary:
        several = ", ".join(f"{one:g}" for one in summary["colours"]["wavelengths_um"])
        filters = "/".join(summary["colours"]["pattern"])
        where = "a monochrome sensor" if filters == "M" else f"colour filters {filters}"
        print(f"{several} um at once, on {where}")
    if is_vector(summary["polarization"]):
        print(f"  components of {polarization_text(summary['polarization'])}")
    print(
        f"sensor: central {across} x {down} pixels of {sensor['pixel_pitch_um']:g} µm; "
        f"{100.0 * summary['energy_share_beyond_pixel_limit']:.2g} % of the light lies above their Nyquist "
        f"limit of {summary['pixel_limit_per_mm']:.4g} per mm"
    )
    if "scattered_light" in summary:
        scattered = summary["scattered_light"]
        radii = ", ".join(f"{radius:.3g}" for radius in scattered["halo_radius_mm"])
        print(
            f"rough surfaces scatter {100.0 * scattered['fraction']:.3g} % of the light; radius of the halo "
            f"on the planes: {radii} mm; the frames are the mean of many lenses, without interference of "
            f"scattered and direct light ({100.0 * scattered['interference_rms']:.2g} % rms of the intensity)"
        )
    rows = [
        (
            frame["file"],
            f"{frame['plane_distance_mm']:g}",
            str(frame["brightest_counts"]),
            str(frame["saturated_pixels"]),
            f"{frame['times']:g} x",
        )
        for frame in summary["frames"]
    ]
    print()
    print_table(("frame",), ("plane (mm)", "brightest count", "saturated pixels", "exposure"), rows)
    print(f"\nwrote {len(summary['files'])} files to {output}")
