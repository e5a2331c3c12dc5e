"""Options that `wavesim image` and `wavesim reconstruct` share, and what they mean together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, NamedTuple

import typer

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.cli.engine_options import engine_settings, numbers

Design = Annotated[Path, typer.Argument(metavar="DESIGN", help="Design file (TOML).")]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write to.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]

PatchMm = Annotated[float | None, typer.Option(help="Side of the object patch; left out, the whole field.")]
FieldStopMm = Annotated[float | None, typer.Option(help="Diameter of the field stop; left out: the patch.")]
ObjectPitchUm = Annotated[float | None, typer.Option(help="Samples of the object; left out: by NA.")]
WavelengthUm = Annotated[float | None, typer.Option(help="Left out: the design's first.")]

Illumination = Annotated[str, typer.Option(help="plane, tilted, gaussian, or FILE of a measured field.")]
LightTiltDeg = Annotated[str, typer.Option(help="tilted: angles x,y of the light.")]
WaistMm = Annotated[float | None, typer.Option(help="gaussian: radius of the waist.")]
LightPitchUm = Annotated[float | None, typer.Option(help="FILE: its pitch, if it does not say.")]

EngineName = Annotated[str, typer.Option("--engine", help="Engine, or auto: the cheapest that holds.")]
MemoryGb = Annotated[float | None, typer.Option(help="Most memory; left out, 80 % of what is free.")]
Cluster = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="two-level: Dask scheduler whose workers do the tiles.")
]
Device = Annotated[str | None, typer.Option(help="two-level: cpu or gpu.")]
Error = Annotated[float | None, typer.Option(help="Relative error that the engine may have.")]

DecenterXMm = Annotated[float, typer.Option(help="Shift of the lens as mounted, along x.")]
DecenterYMm = Annotated[float, typer.Option(help="Shift of the lens as mounted, along y.")]
DespaceMm = Annotated[float, typer.Option(help="Shift of the lens towards the sensor.")]
TiltXDeg = Annotated[float, typer.Option(help="Rotation of the lens about x.")]
TiltYDeg = Annotated[float, typer.Option(help="Rotation of the lens about y.")]
PivotZMm = Annotated[float, typer.Option(help="Centre of rotation, from the front vertex.")]

Frames = Annotated[
    list[Path], typer.Argument(metavar="FRAMES...", help="Frames (TIFF), one or more for each plane.")
]
DesignOption = Annotated[Path, typer.Option("--design", metavar="DESIGN", help="Design file (TOML).")]
ActiveWidth = Annotated[float, typer.Option(help="Of a pixel, as a share of the pitch.")]

PlaneDistanceMm = Annotated[str | None, typer.Option(help="Of each frame, as its file should say.")]
PixelPitchUm = Annotated[float | None, typer.Option(help="Of the frames.")]
Exposure = Annotated[str | None, typer.Option(help="Of each frame; any unit.")]
Bits = Annotated[int | None, typer.Option(help="Of a count.")]
OffsetCounts = Annotated[float | None, typer.Option(help="Count of a dark pixel.")]
GainElectronsPerCount = Annotated[float | None, typer.Option(help="Of the sensor.")]
ReadNoiseElectrons = Annotated[float | None, typer.Option(help="Of the sensor.")]

ChartAtMm = Annotated[
    list[str] | None,
    typer.Option(help="usaf: x,y of fine groups beside those in the middle; may be given again."),
]

KINDS = ("complex", "amplitude")
"""Of objects, for `wavesim.reconstruct`."""

FRAME_SETTINGS = (
    "pixel_pitch_um",
    "wavelength_um",
    "bits",
    "offset_counts",
    "gain_electrons_per_count",
    "read_noise_electrons",
)
"""Options that are the same for all frames."""


class Options(SimpleNamespace):
    """The options of a command, by their names."""


def settings_given(options: Any) -> list[dict[str, Any]]:
    """Settings of each frame that were given, for :func:`wavesim.camera.frames.read_frame`.

    Raises
    ------
    InputError
        If there are not as many distances or exposures as frames.
    """
    count = len(options.frames)
    common = {n: getattr(options, n) for n in FRAME_SETTINGS if getattr(options, n) is not None}
    given = [dict(common) for _ in range(count)]
    for name in ("plane_distance_mm", "exposure"):
        text = getattr(options, name)
        if text is None:
            continue
        for settings, value in zip(given, numbers(text, f"--{name.replace('_', '-')}", count), strict=True):
            settings[name] = value
    return given


def patch_and_light(lens: Lens, options: Any) -> tuple[Any, Any]:
    """The patch of the object and its illumination, from a command's options.

    Raises
    ------
    InputError
        If a value is not usable.
    """
    from wavesim.objects.patch import make_illumination, object_patch

    tilt_x, tilt_y = numbers(options.light_tilt_deg, "--light-tilt-deg", 2)
    kinds = {
        "--light-tilt-deg": (tilt_x or tilt_y, "tilted"),
        "--waist-mm": (options.waist_mm, "gaussian"),
    }
    for option, (value, kind) in kinds.items():
        if value and options.illumination != kind:
            raise InputError(f"{option}: means nothing without --illumination {kind}")
    patch = object_patch(
        lens,
        lens.object.field_diameter_mm if options.patch_mm is None else options.patch_mm,
        options.field_stop_mm,
        wavelength_um=options.wavelength_um,
        object_pitch_um=options.object_pitch_um,
    )
    light = make_illumination(
        patch,
        options.illumination,
        tilt_deg=(tilt_x, tilt_y),
        waist_mm=options.waist_mm,
        pitch_um=options.light_pitch_um,
    )
    return patch, light


class Framed(NamedTuple):
    """Frames, the planes that they are of, each once, and the patch of the object."""

    frames: Any
    planes_mm: tuple[float, ...]
    sensor: Any
    patch: Any
    light: Any
    diversity: float


def chart_points(options: Any) -> list[tuple[float, float]]:
    """Points about which charts stand beside the one in the middle.

    Raises
    ------
    InputError
        If one is not two numbers.
    """
    pairs = [numbers(text, "--chart-at-mm", 2) for text in options.chart_at_mm or ()]
    return [(x, y) for x, y in pairs]


def framed_patch(lens: Lens, options: Any, pose: Pose = Pose()) -> Framed:
    """Read a command's frames, with the patch and light of its options, and check what they can tell.

    Raises
    ------
    InputError
        If frames do not belong together or to the design, or a value is not usable.

    Warns
    -----
    SaturationWarning, FootprintWarning, DiversityWarning
        Where frames tell less than they might.
    """
    from wavesim.camera.frame_sets import frames_by_plane, read_frames, refuse_other_pitch
    from wavesim.camera.windows import check_diversity, check_footprint

    frames = read_frames(options.frames, settings_given(options))
    refuse_other_pitch(frames, lens)
    options.wavelength_um = frames[0].settings.wavelength_um
    patch, light = patch_and_light(lens, options)
    rows, columns = frames[0].counts.shape
    planes = tuple(plane[0].settings.plane_distance_mm for plane in frames_by_plane(frames))
    sensor = lens.sensor.replaced(pixels=(columns, rows))
    check_footprint(lens, patch, sensor, planes, pose)
    figure = check_diversity(lens, patch, planes) if len(planes) > 1 else 0.0
    return Framed(frames, planes, sensor, patch, light, figure)


def key_of_frames(lens: Lens, frames: Any, light: Any, *told: str | bytes) -> str:
    """Digest of all that a result depends on, under which parts of a run are kept."""
    from wavesim.runtime.checkpoint import key_of

    pictures = [
        part for frame in frames for part in (_digest(frame.counts), frame.settings.model_dump_json())
    ]
    return key_of(lens.model_dump_json(), _digest(light.values), *told, *pictures)


def _digest(values: Any) -> str:
    """Of an array, without a copy of it."""
    import hashlib

    import numpy as np

    data: Any = np.ascontiguousarray(values)
    return hashlib.sha256(data).hexdigest()


def refuse_other(option: str, value: str, allowed: Sequence[str]) -> None:
    """Refuse a word that is none of those allowed.

    Raises
    ------
    InputError
        Naming the option, the word, and those allowed.
    """
    if value not in allowed:
        raise InputError(f"{option} = {value!r}: allowed: {', '.join(allowed)}")


def pose_of(options: Any) -> Pose:
    """The lens as mounted."""
    return Pose(*(getattr(options, field.name) for field in fields(Pose)))


def engine_options(options: Any) -> dict[str, Any]:
    """Settings of the engine that were given."""
    names = ("tile_width_mm", "slices", "compensation", "interface", "step_um", "pitch_um", "device")
    return engine_settings(**{name: getattr(options, name, None) for name in names})


@contextmanager
def tiles_in(address: str | None) -> Iterator[Callable[[Any], Any]]:
    """What hands an engine's tiles to a cluster and returns it; without an address, it stays as it is.

    Raises
    ------
    InputError
        If the cluster cannot be used.
    """
    if address is None:
        yield lambda engine: engine
        return
    from wavesim.engines.whole_field.on_cluster import tile_cluster

    with tile_cluster(address) as tiles:

        def take(engine: Any) -> Any:
            tiles.take(engine)
            return engine

        yield take


def engine_summary(engine: Any) -> dict[str, Any]:
    """What an engine is and says of itself, ready for JSON."""
    import math

    error = engine.predicted_error()
    return {
        "name": engine.name,
        "settings": engine.settings(),
        "predicted_error": error if math.isfinite(error) else None,
    }


def versions() -> dict[str, str]:
    """Versions of what results depend on."""
    import platform
    from importlib.metadata import version

    return {"python": platform.python_version()} | {
        name: version(name) for name in ("transferlens", "numpy", "scipy", "finufft")
    }
