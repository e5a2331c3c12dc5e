"""Pictures of the documentation that need no result: drawn from designs and equations, in a minute.

    python -m benchmarks.explaining_pictures docs/images

The argument is the folder for the pictures.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lensdesign import launch, load_design, pupil_hexapolar, trace, trace_polarized
from lensdesign.analysis import largest_spread_angle
from lensdesign.plots.style import BLUE, GREEN, GREY, ORANGE, RED
from tolerancing.report.figures.style import chart_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAPER = "designs/paper_singlet.toml"
DOTS_PER_INCH = 112


def space_bandwidth(picture: Path) -> None:
    """Object, beam and sensor as areas of position and direction."""
    from matplotlib.patches import Rectangle

    lens = load_design(PAPER)
    field_mm, aperture = lens.object.field_diameter_mm, lens.object.numerical_aperture
    limit = 0.5e-3 * lens.wavelengths_um[0] / (1e-3 * lens.sensor.pixel_pitch_um)
    side_mm = 1e-3 * lens.sensor.pixel_pitch_um * min(lens.sensor.pixels)
    with chart_style():
        figure = _figure(7.6, 2.9)
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, title, width, height, colour in (
            (left, "the object emits", field_mm, aperture, BLUE),
            (right, "the sensor samples", side_mm, limit, ORANGE),
        ):
            size = (-0.5 * width, -height), width, 2.0 * height
            axes.add_patch(Rectangle(*size, facecolor=colour, alpha=0.25, edgecolor=colour))
            axes.set(title=title, xlim=(-13.0, 13.0), ylim=(-0.62, 0.62), xlabel="position (mm)")
        left.set_ylabel("sine of the angle to the axis")
        needed = field_mm * aperture / limit
        size = (-0.5 * needed, -limit), needed, 2.0 * limit
        right.add_patch(Rectangle(*size, facecolor=BLUE, alpha=0.25, edgecolor=BLUE))
        left.text(0.0, 0.53, f"{field_mm:g} mm × 2 · {aperture:g}", ha="center", color=BLUE)
        right.text(0.0, 0.2, f"the object's, {needed:.2f} mm × 2 · {limit:.3f}", ha="center", color=BLUE)
        right.text(0.0, -0.24, f"the sensor's, {side_mm:.1f} mm × 2 · {limit:.3f}", ha="center", color=ORANGE)
        _save(figure, picture)


def spread_limit(picture: Path) -> None:
    """Fringes of two waves on the pixels, at the limit and beyond it."""
    across = np.linspace(0.0, 16.0, 1601)
    pixels = np.arange(16)
    with chart_style():
        figure = _figure(7.6, 2.9)
        for axes, factor, title in zip(
            figure.subplots(1, 2, sharey=True),
            (0.5, 1.5),
            ("half the limit: the pixels follow the fringes", "1.5 times the limit: false, wide fringes"),
            strict=True,
        ):
            # At the limit a fringe is two pixels wide; its middle shifts so that the limit itself shows.
            frequency = 0.5 * factor
            light = 0.5 + 0.5 * np.cos(2.0 * np.pi * frequency * (across - 0.5))
            loss = np.sinc(frequency)
            means = 0.5 + 0.5 * loss * np.cos(2.0 * np.pi * frequency * pixels)
            axes.plot(across, light, color=BLUE, lw=1.0, label="light")
            axes.stairs(means, np.arange(17), color=ORANGE, lw=1.6, baseline=None, label="pixels")
            axes.set(title=title, xlabel="position (pixels)", xlim=(0.0, 16.0), ylim=(-0.05, 1.3))
        axes.legend(loc="upper right", ncols=2)
        figure.axes[0].set_ylabel("intensity")
        _save(figure, picture)


def no_image(picture: Path) -> None:
    """Where the rays of three object points meet the two planes of the sensor."""
    lens = load_design(PAPER)
    heights = (0.0, 0.75, 1.5)
    with chart_style():
        figure = _figure(7.6, 3.6)
        for axes, distance_mm in zip(
            figure.subplots(1, 2, sharey=True), lens.sensor.plane_distances_mm, strict=True
        ):
            for height, colour in zip(heights, (BLUE, ORANGE, GREEN), strict=True):
                x_mm, y_mm = _arrivals(lens, height, distance_mm)
                axes.plot(x_mm, y_mm, ".", ms=2.0, color=colour, label=f"{height:g} mm")
            width, height_mm = (1e-3 * lens.sensor.pixel_pitch_um * count for count in lens.sensor.pixels)
            axes.set(
                title=f"{distance_mm:g} mm behind the lens",
                xlabel="x (mm)",
                xlim=(-0.52 * width, 0.52 * width),
                ylim=(-0.52 * height_mm, 0.52 * height_mm),
                aspect="equal",
            )
        figure.axes[0].set_ylabel("y (mm)")
        figure.legend(
            *figure.axes[0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=3,
            title="height of the object point",
            markerscale=4.0,
        )
        _save(figure, picture)


def _arrivals(lens: Any, height_mm: float, distance_mm: float) -> tuple[Any, Any]:
    wavelength_um = lens.wavelengths_um[0]
    origins, directions = launch(lens, [[0.0, height_mm]], pupil_hexapolar(16).points, wavelength_um)
    plane_z_mm = distance_mm + sum(surface.thickness_mm or 0.0 for surface in lens.surfaces)
    rays = trace(lens, origins, directions, wavelength_um, plane_z_mm=plane_z_mm)
    return rays.position[..., 0].ravel(), rays.position[..., 1].ravel()


def two_planes(picture: Path) -> None:
    """Two waves that one plane cannot tell apart, and the next one can."""
    from wavesim import Field, Grid, propagate

    grid = Grid((8192,), 4e-4, 0.0)
    y_mm = grid.y_mm
    amplitude = np.exp(-((y_mm / 0.25) ** 2)) * (1.0 + 0.3 * np.cos(2.0 * np.pi * y_mm / 0.12))
    waves = 2.0 * np.pi / 0.532e-3
    with chart_style():
        figure = _figure(7.6, 2.9)
        first, second = figure.subplots(1, 2, sharey=True)
        for name, curvature, colour, dashes in (
            ("converging", -1.0, BLUE, "-"),
            ("diverging", 1.0, ORANGE, (0, (4, 3))),
        ):
            values = amplitude * np.exp(0.5j * waves * curvature * y_mm**2 / 20.0)
            field = Field(grid, values, 0.532)
            behind = propagate(field, 8.0)
            first.plot(y_mm, np.abs(field.values) ** 2, color=colour, ls=dashes, label=name)
            second.plot(y_mm, np.abs(behind.values) ** 2, color=colour, ls=dashes, label=name)
        first.set(
            title="first plane: the same intensity", xlabel="y (mm)", ylabel="intensity", xlim=(-0.7, 0.7)
        )
        second.set(title="8 mm behind it: the phase shows", xlabel="y (mm)", xlim=(-0.7, 0.7))
        second.legend(title="wave")
        _save(figure, picture)


def spread_over_field(picture: Path) -> None:
    """The spread of the start, a plate, beside those of two lenses that were found."""
    with chart_style():
        figure = _figure(6.4, 3.2)
        axes = figure.subplots()
        for name, words, colour in (
            ("paper_singlet", "the paper's lens", GREY),
            ("feasible_singlet", "smallest spread", BLUE),
            ("thinnest_singlet", "thinnest lens", ORANGE),
        ):
            lens = load_design(f"designs/{name}.toml")
            found = largest_spread_angle(lens, field_heights_mm=np.linspace(0.0, 1.5, 16))
            axes.plot(found.field_heights_mm, found.per_field_deg, ".-", color=colour, label=words)
        axes.axhline(4.7682, color=RED, lw=1.0)
        axes.text(0.01, 4.773, "limit of the sensor", color=RED, va="bottom")
        axes.set(xlabel="height of the object point (mm)", ylabel="largest spread (°)")
        axes.legend()
        _save(figure, picture)


def reconstruction_pupil(picture: Path) -> None:
    """The effect of a decenter of 30 um, as `wavesim pupil` draws it."""
    from lensdesign import Pose
    from wavesim import PupilSampler, refocus
    from wavesim.plots.pupils import pupil_figure

    sampler = PupilSampler(load_design(PAPER), field_mm=(0.0, 0.0), wavelength_um=0.532, samples=128)
    pupil = refocus(sampler.pupil(Pose(decenter_y_mm=0.03))).pupil
    written = BytesIO()
    pupil_figure(pupil, (1.55, 0.775, 0.6), "decenter y 0.03 mm, refocused").savefig(written, dpi=100)
    _shrink(written, picture, 1000)


def rough_frames(picture: Path) -> None:
    """A frame of a smooth lens, and what equal roughness adds: on average, and in one lens."""
    from benchmarks.roughness import CAMERA, PATCH, SCALE, rough_lens, with_screen
    from lensdesign import scaled
    from wavesim import image
    from wavesim.sensor import estimate_intensity

    lens = scaled(load_design(PAPER), SCALE)
    plain = PATCH | CAMERA | {"noise": False}
    smooth, rough = (image(one, "usaf", **plain) for one in (lens, rough_lens(lens, 10.0, 1.0)))
    assert rough.scattered is not None
    one_lens = with_screen(smooth, rough.scattered.mean_fraction, 1.0, 0)
    frames = [estimate_intensity(taken[0])[0] for taken in (smooth.frames, rough.frames, one_lens)]
    direct = frames[0] / frames[0].sum()
    changes = [frame / frame.sum() - direct for frame in frames[1:]]
    with chart_style():
        figure = _figure(8.4, 2.8)
        axes = figure.subplots(1, 3)
        titles = "smooth lens", "mean of rough lenses", "one rough lens"
        inner = slice(80, -80), slice(80, -80)
        shown = [values[inner] / direct.max() for values in (direct, *changes)]
        for one, title, values in zip(axes, titles, shown, strict=True):
            is_frame = one is axes[0]
            limits = {"vmin": 0.0, "vmax": 1.0} if is_frame else {"vmin": -0.03, "vmax": 0.03}
            drawn = one.imshow(values, cmap="gray" if is_frame else "RdBu_r", **limits)
            one.set(title=title, xticks=[], yticks=[])
            figure.colorbar(drawn, ax=one, shrink=0.85)
        _save(figure, picture)


def coatings(picture: Path) -> None:
    """Transmittance of coatings over the angle of incidence, and the crossed component over the stop."""
    from lensdesign.lens import film_coefficients, film_index, refractive_index

    wavelength_um, films = 0.532, [film_index(name, 0.532) for name in ("MgF2", "Ta2O5")]
    stacks: dict[str, tuple[str, list[complex], list[float]]] = {
        "bare": (RED, [], []),
        "MgF2": (ORANGE, films[:1], [1.0]),
        "3 layers": (BLUE, [*films, 1.65 + 0.0j], [1.0, 2.0, 1.0]),
    }
    angle = np.linspace(0.0, 70.0, 200)
    steps = np.linspace(-1.0, 1.0, 161)
    stop = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    stop = stop[np.hypot(*stop.T) <= 1.0]
    bare = load_design(PAPER).with_coating("bare")
    light = trace_polarized(bare, *launch(bare, [(0.0, 0.0)], stop, wavelength_um), wavelength_um)
    with chart_style():
        figure = _figure(8.4, 3.2)
        left, right = figure.subplots(1, 2)
        glass = refractive_index("N-BK7", wavelength_um)
        for name, (colour, indices, waves) in stacks.items():
            thicknesses = [0.25 * q * wavelength_um / n.real for q, n in zip(waves, indices, strict=True)]
            cosine = np.cos(np.radians(angle))
            found = film_coefficients(1.0, glass, indices, thicknesses, cosine, wavelength_um)
            left.plot(angle, 100.0 * np.abs(found.ts) ** 2, color=colour, label=f"{name}, s")
            left.plot(angle, 100.0 * np.abs(found.tp) ** 2, "--", color=colour, label=f"{name}, p")
        left.set(xlabel="angle of incidence (deg)", ylabel="transmittance (%)", ylim=(75.0, 100.5))
        left.legend(loc="lower left", fontsize=7)
        crossed = 100.0 * light.jones[:, 1, 0].real
        drawn = right.scatter(*stop.T, c=crossed, s=2.0, marker="s", cmap="RdBu_r", vmin=-4.0, vmax=4.0)
        right.set(title="crossed amplitude (%)", xlabel="stop, x", ylabel="stop, y", aspect="equal")
        figure.colorbar(drawn, ax=right, shrink=0.85)
        _save(figure, picture)


def ghosts(picture: Path) -> None:
    """Rays of two ghosts of the paper's lens with a cover glass, beside the direct ones."""
    from lensdesign import CoverGlass
    from lensdesign.analysis.double_reflections import sensor_system
    from lensdesign.raytrace.ghosts import ghost_system
    from lensdesign.raytrace.rays import trace_compiled

    lens = load_design(PAPER)
    glass = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)
    lens = lens.replaced(sensor=lens.sensor.replaced(cover_glass=glass))
    system, names = sensor_system(lens, lens.wavelengths_um[0], lens.sensor.plane_distances_mm[0])
    sines = np.linspace(-0.48, 0.48, 13)
    origins = np.tile([0.0, 0.0, lens.object_z_mm], (len(sines), 1))
    directions = np.column_stack([np.zeros(len(sines)), sines, np.sqrt(1.0 - sines**2)])
    with chart_style():
        figure = _figure(7.6, 3.6)
        for axes, pair in zip(
            figure.subplots(1, 2, sharey=True),
            (("surface 2", "surface 1"), ("cover glass front", "surface 1")),
            strict=True,
        ):
            back, front = (names.index(name) for name in pair)
            for path, colour in ((system, GREY), (ghost_system(system, front, back), ORANGE)):
                rays = trace_compiled(path, origins, directions, record_hits=True)
                assert rays.hits is not None
                for ray in np.flatnonzero(rays.ok):
                    points = np.vstack([origins[ray], rays.hits[ray]])
                    axes.plot(points[:, 2], points[:, 1], color=colour, lw=0.6)
            y = np.linspace(-10.0, 10.0, 201)
            for i, name in enumerate(names):
                z = system.vertex[0, i, 2] + system.sag(i, 0.0 * y, y)
                axes.plot(z, y, color=RED if name == "sensor" else BLUE, lw=1.2)
            axes.set(title=f"{pair[0]} - {pair[1]}", xlim=(-4.0, 13.0), ylim=(-11.0, 11.0), xlabel="z (mm)")
        figure.axes[0].set_ylabel("y (mm)")
        _save(figure, picture)


def view(picture: Path) -> None:
    """The lens, its rays and the planes of the sensor in space."""
    from lensdesign.plots.scene3d import render_lens

    large = picture.with_stem("large")
    render_lens(load_design(PAPER), large)
    _shrink(large, picture, 760)
    large.unlink()


def _shrink(source: Path | BytesIO, picture: Path, width: int) -> None:
    from PIL import Image

    with Image.open(source) as opened:
        small = opened.convert("RGB").resize(
            (width, round(width * opened.height / opened.width)), Image.Resampling.LANCZOS
        )
    small.quantize(128).save(picture, optimize=True)


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def _save(figure: Figure, picture: Path) -> None:
    figure.savefig(picture, dpi=DOTS_PER_INCH)


def main(arguments: list[str]) -> None:
    """Draw all pictures into a folder."""
    if len(arguments) != 1:
        raise SystemExit(__doc__)
    for draw in (
        space_bandwidth,
        spread_limit,
        no_image,
        two_planes,
        spread_over_field,
        reconstruction_pupil,
        rough_frames,
        coatings,
        ghosts,
        view,
    ):
        draw(Path(arguments[0]) / f"{draw.__name__}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
