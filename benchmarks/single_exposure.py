"""One exposure of one plane: which light, support or surface lets it suffice, at equal numbers of electrons.

Frames are made with finer tiles than those that reconstruct, straight to 5 x 5 points of each pixel, whose
intensities are averaged; the reconstruction has one sample per pixel and the package's pixel model. Objects
are compared as evenly lit light would show them, so that no light is favoured because it is dark where the
object is wrong.

    python -m benchmarks.single_exposure [methods] [kinds] [bright] [fine] [light] [wrong]
        [chart]
    python -m benchmarks.single_exposure -o PICTURE
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from math import asin, tan
from pathlib import Path
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from benchmarks.timing import DESIGNS
from lensdesign import SurfaceFigureSource, load_design, scaled
from lensdesign.lens.lens import Lens, Sensor
from wavesim import Electronics, Field, Frame, engine_for, reconstruct
from wavesim.calibration.planning import _dense, _Random
from wavesim.metrics import object_correlation, transmitted_directions, transmitted_part
from wavesim.scene.engine import Engine
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import Kind
from wavesim.scene.source import SourceMode
from wavesim.sensor import Camera, plane_seeds, recorded_planes
from wavesim.sensor.measurement import noise_misfit
from wavesim.sensor.windows import exit_scene, sensor_window
from wavesim.targets import field_stop, make_target, object_patch, plane_wave, point_source, speckle
from wavesim.targets.patch import Patch

POINTS = 5
"""Points along each side of a pixel, whose intensities are averaged."""

ELECTRONS_PER_PIXEL = 300.0
"""Electrons per pixel of all methods that are compared at equal light."""

BRIGHTEST_ELECTRONS, BITS = 10_000.0, 12
"""Electrons in the brightest pixel, and bits, of a camera's single exposure."""

LARGEST_ITERATIONS = 200


@dataclass(frozen=True)
class Bench:
    """A twin of the paper's lens, its whole field, and the planes of its frames."""

    lens: Lens
    planes_mm: tuple[float, ...]

    @property
    def patch(self) -> Patch:
        """The whole field."""
        return object_patch(self.lens, self.lens.object.field_diameter_mm)

    @property
    def sensor(self) -> Sensor:
        """The window that the light covers on all planes."""
        return sensor_window(self.lens, self.patch, self.planes_mm)


@dataclass(frozen=True)
class Method:
    """What is done to make one exposure suffice: the light, the support, and the lens."""

    name: str
    light: Callable[[Patch], Field]
    support: float = 1.0
    modes: tuple[SourceMode, ...] = ()
    code_um: float = 0.0


@cache
def bench(twin: int, planes: int = 1, code_um: float = 0.0) -> Bench:
    """Return a twin of 1/twin with its nearest plane, or with planes evenly spaced up to the farthest one.

    With `code_um` the back has a smooth figure of this root mean square.
    """
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / twin)
    planes_mm = tuple(np.linspace(*lens.sensor.plane_distances_mm, planes).tolist())
    if code_um:
        back = lens.surfaces[1]
        assert back.semi_diameter_mm is not None
        terms = {6: 1.0, 8: -1.0, 11: 0.7, 14: 0.7, 17: -0.5}  # OSA/ANSI indices: trefoil, coma and higher
        size = code_um / float(np.linalg.norm(list(terms.values())))
        figure = SurfaceFigureSource(
            zernike_um=tuple((index, size * part) for index, part in terms.items()),
            semi_diameter_mm=back.semi_diameter_mm,
        )
        lens = lens.replaced(surfaces=(lens.surfaces[0], back.replaced(figure=figure)))
    return Bench(lens, planes_mm)


@cache
def engine_of(of: Bench, plane: int, points: int, error: float) -> Engine:
    """Return the engine straight to a plane, with points x points samples on each pixel."""
    patch = of.patch
    scene = exit_scene(of.lens, patch, of.sensor, of.planes_mm[plane], oversampling=points)
    stop = Field(patch.grid, patch.inside.astype(np.complex64), patch.wavelength_um)
    return engine_for(scene, "eikonal", error=error, light=Light(stop))


def stop_of(patch: Patch, support: float) -> NDArray[np.float32]:
    """Return the coverage of a round support, as a fraction of the field's diameter."""
    return field_stop(patch.grid, "disc", support * patch.field_stop_mm).astype(np.float32)


def light_of(method: Method, patch: Patch) -> Field:
    """Return a method's light behind its support."""
    light = method.light(patch)
    return light.with_values((light.values * stop_of(patch, method.support)).astype(np.complex64))


def from_point(sine: float) -> Callable[[Patch], Field]:
    """Return light of a point source, by the sine of its angle at the field's edge (negative: converging)."""

    def light(patch: Patch) -> Field:
        return point_source(patch.grid, patch.wavelength_um, 0.5 * patch.field_stop_mm / tan(asin(sine)))

    return light


def even(patch: Patch) -> Field:
    """Return a plane wave."""
    return plane_wave(patch.grid, patch.wavelength_um)


def tilted(tilt_deg: float) -> Callable[[Patch], Field]:
    """Return a tilted plane wave."""
    return lambda patch: plane_wave(patch.grid, patch.wavelength_um, tilt_x_deg=tilt_deg)


def grains(aperture: float, seed: int = 3) -> Callable[[Patch], Field]:
    """Return speckle of a numerical aperture."""
    return lambda patch: speckle(patch.grid, patch.wavelength_um, aperture, seed)


def phase_screen(rms_rad: float, samples: float) -> Callable[[Patch], Field]:
    """Return light behind a smooth random phase, whose detail has this number of samples."""

    def light(patch: Patch) -> Field:
        smooth = _Random(np.random.default_rng(3), patch.inside).smooth(samples)
        return Field(patch.grid, np.exp(1j * rms_rad * smooth), patch.wavelength_um)

    return light


def grating(patch: Patch) -> Field:
    """Return light with stripes of half the amplitude, of a period of ten samples."""
    stripes = np.cos(2.0 * np.pi * patch.grid.x_mm / (10.0 * patch.grid.pitch_mm)) > 0.0
    values = np.broadcast_to(np.where(stripes, 1.0, 0.5), patch.grid.shape)
    return Field(patch.grid, values.astype(complex), patch.wavelength_um)


def two_directions(tilt_deg: float) -> tuple[SourceMode, ...]:
    """Return two mutually incoherent sources at +- an angle."""
    return tuple(SourceMode(0.5, (tilt, 0.0), 0.532) for tilt in (tilt_deg, -tilt_deg))


PLAIN = Method("plane wave", even)

METHODS = (
    PLAIN,
    *(Method(f"plane wave, support of {part:g}", even, support=part) for part in (0.8, 0.7, 0.6, 0.5)),
    *(Method(f"tilted by {angle:g} deg", tilted(angle)) for angle in (5.0, 10.0)),
    *(Method(f"point source, sine {sine:g} at the edge", from_point(sine)) for sine in (0.1, 0.2, 0.3)),
    Method("converging, sine 0.2 at the edge", from_point(-0.2)),
    Method("point source, sine 0.2, support of 0.6", from_point(0.2), support=0.6),
    Method("smooth phase, 1 rad rms", phase_screen(1.0, 4.0)),
    Method("fine phase, 3 rad rms", phase_screen(3.0, 2.0)),
    Method("grating", grating),
    Method("two directions, +-8 deg", even, modes=two_directions(8.0)),
    Method("point source, sine 0.2, two directions", from_point(0.2), modes=two_directions(5.0)),
    *(Method(f"back with a figure of {size:g} um rms", even, code_um=size) for size in (0.3, 1.0)),
    *(Method(f"speckle of NA {aperture:g}", grains(aperture)) for aperture in (0.1, 0.2, 0.3)),
)

OBJECTS: dict[str, Kind] = {"chart": "amplitude", "phase": "phase", "dense": "complex"}
"""Objects, and the kind as which they are sought."""


def object_of(name: str, of: Bench) -> NDArray[np.complex64]:
    """Return an object: a USAF chart, tissue, pads of phase, or random ones."""
    patch = of.patch
    if name in ("chart", "tissue", "pads"):
        known = {"chart": "usaf", "pads": "phase"}.get(name, name)
        aperture = of.lens.object.numerical_aperture
        return np.asarray(make_target(patch, known, numerical_aperture=aperture, seed=5).transmission.values)
    random = _Random(np.random.default_rng(5), patch.inside)
    if name.startswith("detail of "):
        return _dense_of_detail(random, float(name.split()[-1]))
    made = {
        "dense": lambda: _dense(random),
        "phase": lambda: np.exp(1.2j * random.smooth(3.0)),
        "weak phase": lambda: np.exp(0.2j * random.smooth(6.0)),
        "moderate phase": lambda: np.exp(0.5j * random.smooth(3.0)),
        "empty": lambda: np.ones(patch.grid.shape),
    }[name]()
    return np.asarray(made, np.complex64)


def _dense_of_detail(random: _Random, samples: float) -> NDArray[np.complex64]:
    """Return a dense object with Gaussian smoothing over a number of samples."""
    modulus = 0.3 + 0.7 / (1.0 + np.exp(-2.0 * random.smooth(samples)))
    return np.asarray(modulus * np.exp(1.2j * random.smooth(samples)), np.complex64)


def intensity(
    of: Bench, plane: int, light: Field, object_: NDArray[Any], modes: Sequence[SourceMode] = ()
) -> NDArray[Any]:
    """Return the mean intensity on each pixel of a plane."""
    engine, total = engine_of(of, plane, POINTS, 0.01), 0.0
    for mode in modes or (SourceMode(1.0, (0.0, 0.0), light.wavelength_um),):
        lit = mode.on(light)
        field = engine.forward(lit.with_values((lit.values * object_).astype(np.complex64))).values
        rows, columns = (count // POINTS for count in field.shape)
        blocks = (np.abs(field) ** 2).reshape(rows, POINTS, columns, POINTS)
        total = total + mode.weight * blocks.mean(axis=(1, 3))
    return np.asarray(total)


def frames_of(
    of: Bench,
    lights: Sequence[NDArray[Any]],
    brightest: Sequence[float],
    bits: int = 16,
    times: Sequence[float] = (1.0,),
) -> list[Frame]:
    """Return frames of all planes, by the electrons in their brightest pixels; the read noise is 2."""
    found: list[Frame] = []
    planes = zip(of.planes_mm, lights, brightest, plane_seeds(1, len(lights)), strict=True)
    for plane_mm, light, peak, seed in planes:
        # The default of the peak fill, 0.8, gives the brightest pixel `peak` electrons.
        electronics = Electronics(full_well_electrons=1.25 * peak, bits=bits)
        camera = Camera(of.sensor, electronics, tuple(times))
        found += camera.frames(light, plane_mm, of.patch.wavelength_um, seed)
    return found


@dataclass(frozen=True, eq=False)
class Outcome:
    """Correlation, misfit over the noise, iterations, electrons per pixel, and those of the median pixel.

    The first frame, and the object found.
    """

    correlation: float
    over_noise: float
    iterations: int
    mean_electrons: float
    median_electrons: float
    frame: Frame
    found: NDArray[Any]


def outcome(
    method: Method,
    object_name: str,
    kind: Kind,
    *,
    twin: int = 48,
    planes: int = 1,
    brightest: float | None = None,
    known_light: Field | None = None,
) -> Outcome:
    """Return the result of one exposure on each plane.

    Parameters
    ----------
    method, object_name, kind
        What is imaged and how it is sought.
    twin, planes
        Scale of the twin, and number of planes, which share the electrons.
    brightest
        Electrons in the brightest pixel; default: `ELECTRONS_PER_PIXEL` on average, by a camera of 16 bits.
    known_light
        Light with which the object is reconstructed; default: the true one.
    """
    of = bench(twin, planes, method.code_um)
    light, object_ = light_of(method, of.patch), object_of(object_name, of)
    bright = [intensity(of, plane, light, object_, method.modes) for plane in range(planes)]
    peaks = [
        ELECTRONS_PER_PIXEL / planes * float(one.max() / one.mean()) if brightest is None else brightest
        for one in bright
    ]
    frames = frames_of(of, bright, peaks, 16 if brightest is None else BITS)
    recorded = recorded_planes(frames)
    found = reconstruct(
        engine_of(of, 0, 1, 0.05),
        known_light or light,
        recorded,
        kind=kind,
        tv_weight="auto",
        iterations=LARGEST_ITERATIONS,
        until_noise=True,
        fill_factor=1.0,
        modes=method.modes,
    )
    electrons = [one * (peak / one.max()) for one, peak in zip(bright, peaks, strict=True)]
    return Outcome(
        correlation_of(of, method.support, found.transmission.values, object_),
        found.misfit[-1] / (noise_misfit(recorded) or np.nan),
        len(found.misfit),
        float(np.mean(electrons)),
        float(np.median(electrons[0])),
        frames[0],
        found.transmission.values,
    )


def correlation_of(of: Bench, support: float, found: NDArray[Any], object_: NDArray[Any]) -> float:
    """Return the correlation of an object with the true one, as even light would show both."""
    patch, engine = of.patch, engine_of(of, 0, 1, 0.05)
    stop = stop_of(patch, support)
    directions = transmitted_directions(engine.scene, patch.grid)

    def passed(values: Any) -> Field:
        field = Field(patch.grid, (stop * values).astype(np.complex64), patch.wavelength_um)
        return transmitted_part(field, directions)

    return object_correlation(passed(found), passed(object_), passed(np.float32(1.0)), stop > 0.5)


def print_methods(methods: Sequence[Method] = METHODS) -> None:
    """Print all methods at equal light, for an amplitude, a phase and a complex object."""
    print(
        f"\nOne plane, {ELECTRONS_PER_PIXEL:g} electrons per pixel; correlation (misfit over noise)\n\n"
        f"| light, support or lens | {' | '.join(OBJECTS)} |\n| --- | {' | '.join('---' for _ in OBJECTS)} |"
    )
    for method in methods:
        results = [outcome(method, name, kind) for name, kind in OBJECTS.items()]
        cells = [f"{one.correlation:.3f} ({one.over_noise:.2f})" for one in results]
        print(f"| {method.name} | {' | '.join(cells)} |", flush=True)


def print_kinds() -> None:
    """Print phase objects that are sought as such and as complex ones, from one and from two planes."""
    print(
        f"\nPhase objects, plane wave, {ELECTRONS_PER_PIXEL:g} electrons per pixel over all planes; "
        "correlation (iterations)\n\n"
        "| object | planes | kind phase | kind complex |\n| --- | --- | --- | --- |"
    )
    for name in ("weak phase", "moderate phase", "pads"):
        for planes in (1, 2):
            results = [outcome(PLAIN, name, kind, planes=planes) for kind in ("phase", "complex")]
            cells = [f"{one.correlation:.4f} ({one.iterations})" for one in results]
            print(f"| {name} | {planes} | {' | '.join(cells)} |", flush=True)


BRIGHT_METHODS = (
    PLAIN,
    Method("point source, sine 0.2 at the edge", from_point(0.2)),
    Method("speckle of NA 0.2", grains(0.2)),
    Method("speckle of NA 0.3", grains(0.3)),
    Method("speckle of NA 0.4", grains(0.4)),
)


def print_bright() -> None:
    """Print single exposures of a camera of 12 bits, with 10,000 electrons in the brightest pixel."""
    names: dict[str, Kind] = {**OBJECTS, "tissue": "complex", "weak phase": "phase"}
    print(
        f"\nOne plane, one exposure of {BITS} bits, {BRIGHTEST_ELECTRONS:g} electrons in the brightest "
        "pixel; correlation (electrons per pixel)\n\n"
        f"| light | {' | '.join(names)} |\n| --- | {' | '.join('---' for _ in names)} |"
    )
    for method in BRIGHT_METHODS:
        results = [outcome(method, name, kind, brightest=BRIGHTEST_ELECTRONS) for name, kind in names.items()]
        cells = [f"{one.correlation:.4f} ({one.mean_electrons:.0f})" for one in results]
        print(f"| {method.name} | {' | '.join(cells)} |", flush=True)


def print_fine() -> None:
    """Print dense objects of finer and finer detail in single exposures, with supports and a second plane."""
    known = BRIGHT_METHODS[-1]
    columns = (
        *((f"support of {part:g}", replace(known, support=part), 1) for part in (1.0, 0.8, 0.6)),
        ("two planes", known, 2),
        ("two planes, plane wave", PLAIN, 2),
    )
    print(
        f"\nDense complex objects in {known.name}, exposures of {BITS} bits; correlation (misfit over noise)"
        f"\n\n| detail (samples) | {' | '.join(name for name, _, _ in columns)} |\n"
        f"| --- | {' | '.join('---' for _ in columns)} |"
    )
    for samples in (3.0, 2.0, 1.5, 1.0):
        cells = []
        for _, method, planes in columns:
            name = f"detail of {samples}"
            one = outcome(method, name, "complex", planes=planes, brightest=BRIGHTEST_ELECTRONS)
            cells.append(f"{one.correlation:.3f} ({one.over_noise:.1f})")
        print(f"| {samples:g} | {' | '.join(cells)} |", flush=True)


def light_found(method: Method, twin: int = 48, planes: int = 4) -> tuple[Field, float]:
    """Return light that is found from planes without an object, and its correlation with the true one.

    Each plane has the exposures 1 and 30.
    """
    of = bench(twin, planes)
    light, empty = light_of(method, of.patch), object_of("empty", of)
    bright = [intensity(of, plane, light, empty) for plane in range(planes)]
    frames = frames_of(of, bright, [BRIGHTEST_ELECTRONS] * planes, BITS, (1.0, 30.0))
    found = reconstruct(
        engine_of(of, 0, 1, 0.05),
        light_of(PLAIN, of.patch),
        recorded_planes(frames),
        tv_weight="auto",
        iterations=400,
        until_noise=True,
        fill_factor=1.0,
    ).transmission.values
    return light.with_values(found), float(
        abs(np.vdot(found, light.values)) / np.linalg.norm(found) / np.linalg.norm(light.values)
    )


LIGHT_SEEDS = (3, 4)
"""Seeds of the speckle that is found from frames."""


def print_light() -> None:
    """Print single exposures that are reconstructed with speckle found from four planes without an object."""
    print(
        "\nSpeckle that is found from four planes of two exposures without an object; then one exposure "
        f"of {BITS} bits\n\n| light | correlation of the light | {' | '.join(OBJECTS)} |\n"
        f"| --- | --- | {' | '.join('---' for _ in OBJECTS)} |"
    )
    for aperture, seed in product((0.2, 0.3), LIGHT_SEEDS):
        method = Method(f"speckle of NA {aperture:g}, seed {seed}", grains(aperture, seed))
        light, correlation = light_found(method)
        cells = []
        for name, kind in OBJECTS.items():
            true, found = (
                outcome(method, name, kind, brightest=BRIGHTEST_ELECTRONS, known_light=known)
                for known in (None, light)
            )
            cells.append(f"{found.correlation:.4f} ({true.correlation:.4f} with the true light)")
        print(f"| {method.name} | {correlation:.4f} | {' | '.join(cells)} |", flush=True)


def print_wrong() -> None:
    """Print what a wrong distance of the source, and a displaced speckle, cost single exposures."""
    print(
        f"\nLight that differs from the stated one; one exposure of {BITS} bits\n\n"
        "| object, light | error | correlation | misfit over noise |\n| --- | --- | --- | --- |"
    )
    patch = bench(48).patch
    point, fine = BRIGHT_METHODS[1], BRIGHT_METHODS[3]
    for percent in (0.3, 1.0, 3.0):
        sine = float(np.sin(np.arctan(np.tan(np.arcsin(0.2)) / (1.0 + 0.01 * percent))))
        wrong = light_of(Method("", from_point(sine)), patch)
        one = outcome(point, "chart", "amplitude", brightest=BRIGHTEST_ELECTRONS, known_light=wrong)
        print(
            f"| chart, point source | distance {percent:g} % | {one.correlation:.4f} | {one.over_noise:.2f} |"
        )
    for shift_um in (0.05, 0.1, 0.2):
        samples = 1e-3 * shift_um / patch.grid.pitch_mm
        moved = scipy.ndimage.fourier_shift(np.fft.fft2(fine.light(patch).values), (0.0, samples))
        light = Field(patch.grid, np.fft.ifft2(moved), patch.wavelength_um)
        wrong = light_of(Method("", lambda _, light=light: light), patch)
        one = outcome(fine, "dense", "complex", brightest=BRIGHTEST_ELECTRONS, known_light=wrong)
        print(
            f"| dense, {fine.name} | moved by {shift_um:g} um | {one.correlation:.4f} "
            f"| {one.over_noise:.2f} |"
        )


def print_chart(twin: int = 8) -> None:
    """Print the chart in the whole field of a one-eighth twin, from one exposure of a camera."""
    print(f"\nUSAF chart, whole field of the 1/{twin} twin, one exposure on one plane\n")
    print(
        "| light | correlation | misfit over noise | iterations | electrons per pixel | of the median pixel |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for method in (PLAIN, Method("point source, sine 0.2 at the edge", from_point(0.2))):
        one = outcome(method, "chart", "amplitude", twin=twin, brightest=BRIGHTEST_ELECTRONS)
        print(
            f"| {method.name} | {one.correlation:.4f} | {one.over_noise:.2f} | {one.iterations} "
            f"| {one.mean_electrons:.0f} | {one.median_electrons:.2g} |",
            flush=True,
        )


def draw(picture: Path) -> None:
    """Draw single exposures of a chart and of tissue, and the objects found, by plain and by spread light."""
    from matplotlib.figure import Figure

    from wavesim.plots.frames import save

    point, fine = BRIGHT_METHODS[1], BRIGHT_METHODS[3]
    rows: tuple[tuple[str, Kind, Method], ...] = (
        ("chart", "amplitude", point),
        ("tissue", "complex", fine),
    )
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplots(len(rows), 4)
    for line, (name, kind, spread) in zip(axes, rows, strict=True):
        for pair, method in zip((line[:2], line[2:]), (PLAIN, spread), strict=True):
            one = outcome(method, name, kind, brightest=BRIGHTEST_ELECTRONS)
            settings = one.frame.settings
            electrons = (one.frame.counts - settings.offset_counts) * settings.gain_electrons_per_count
            pair[0].imshow(np.log10(np.maximum(electrons, 1.0)), vmin=0.0, vmax=4.0, cmap="magma")
            pair[0].set_title(f"{method.name}:\nframe (log)", fontsize=9)
            pair[1].imshow(np.abs(one.found), vmin=0.0, vmax=1.0, cmap="gray")
            pair[1].set_title(f"{name} found,\ncorrelation {one.correlation:.3f}", fontsize=9)
    for panel in axes.flat:
        panel.set_axis_off()
    save(figure, picture, dpi=90)


PARTS = {
    "methods": print_methods,
    "kinds": print_kinds,
    "bright": print_bright,
    "fine": print_fine,
    "light": print_light,
    "wrong": print_wrong,
    "chart": print_chart,
}


def main() -> None:
    """Print the tables that the arguments name; default: all."""
    warnings.simplefilter("ignore")
    if sys.argv[1:2] == ["-o"]:
        return draw(Path(sys.argv[2]))
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
    return None


if __name__ == "__main__":
    main()
