"""The cases: wrong inputs, perfect benches, and errors whose cause is to be named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from benchmarks.verdicts.benches import Bench, BenchFrames, Settings
from benchmarks.verdicts.errors import (
    TURNS,
    at_planes,
    changed,
    clipped,
    first_plane_twice,
    quantised,
    smoothed,
    stating,
    vibrating,
    weak_second_plane,
    with_cosmic_rays,
    with_gamma,
    with_hot_pixels,
    with_second_plane,
)
from lensdesign.lens.lens import Lens
from wavesim.sensor.frames import Frame

Group = Literal["wrong", "perfect", "cause"]
Taking = Callable[[BenchFrames], Sequence[Frame]]


@dataclass(frozen=True)
class Case:
    """Frames, what is believed of them, and what may be said of them.

    Attributes
    ----------
    name
        Of the case; no two have the same.
    group
        "wrong", "perfect", or "cause": errors that have a name, which the verdict is asked for.
    bench
        The bench that is believed in.
    take
        Makes the frames.
    causes
        Names of the cause that are right; a refusal is right if its message has one of these words. Empty
        where none is asked for.
    healthy
        Makes the frames without the error.
    stated
        Settings of the frames, as options of `wavesim reconstruct`.
    settings
        Further settings of the reconstruction.
    believed
        Makes the design that is believed in of the lens as it is.
    stop_um
        x, y and diameter of the object's stop in the frames without the error, if it is not the patch's.
    """

    name: str
    group: Group
    bench: Bench
    take: Taking = BenchFrames.frames
    causes: tuple[str, ...] = ()
    healthy: Taking = BenchFrames.frames
    stated: Settings = ()
    settings: Settings = ()
    believed: Callable[[Lens], Lens] = field(default=lambda lens: lens)
    stop_um: tuple[float, float, float] | None = None


THREE = (1.0, 30.0, 1000.0)
AMPLITUDE = Bench(1 / 48, "letters", patch_mm=0.03, exposures=THREE)
ONE_LETTERS = Bench(1 / 48, "letters", patch_mm=0.03, exposures=(1.0,))
ONE_PHANTOM = Bench(1 / 48, "phantom", "complex", 0.03, (1.0,))
CHART = Bench(1 / 16, "usaf", patch_mm=0.08)
COMPLEX = Bench(1 / 48, "tissue", "complex", 0.03, THREE, seed=1)
DENSE = Bench(1 / 20, "dense", patch_mm=0.08)
ONE_EXPOSURE = Bench(1 / 16, "star", patch_mm=0.08, exposures=(1.0,))
SEED = 11
"""Of noise that is another one than the bench's."""

WEAK, FAINT = 0.002, 0.01
"""Shares of the exposure, with which the second plane's brightest pixel has some 16 and 80 electrons."""

STOP_UM = 14.0
"""Diameter of a field stop that stands beside the middle."""


def imaged(**changes: Any) -> Taking:
    """Return frames of a bench with other settings of `wavesim image`."""
    return lambda bench: bench.frames(**changes)


def stated_as(**settings: Any) -> Taking:
    """Return frames that state other settings; a function is given what they state."""
    return lambda bench: stating(bench.frames(), **settings)


def times(factor: float) -> Callable[[float], float]:
    """Return the product with a factor."""
    return lambda value: factor * value


def second_plane(turn: str, weak: float | None = None) -> Taking:
    """Return frames whose second plane is turned, mirrored or shifted, and has a short exposure."""
    return lambda bench: changed(
        bench.frames() if weak is None else weak_second_plane(bench, weak), TURNS[turn], plane=1
    )


def long_exposures(factor: float) -> Taking:
    """Return frames that state for all but the shortest exposure so many times what it was."""

    def take(bench: BenchFrames) -> Sequence[Frame]:
        frames = bench.frames()
        shortest = min(frame.settings.exposure for frame in frames)
        limit = 5.0 * shortest
        return stating(frames, exposure=lambda value: value * (factor if value > limit else 1.0))

    return take


def nearly_one_plane(relative: float) -> Taking:
    """Return frames of the first plane and of one that is farther by a share of its distance."""

    def take(bench: BenchFrames) -> Sequence[Frame]:
        first = bench.planes_mm[0]
        return bench.frames(planes_mm=(first, (1.0 + relative) * first))

    return take


def saturated(bench: BenchFrames) -> Sequence[Frame]:
    """Return frames of one exposure that is 300 times too long."""
    return bench.frames(exposures=(300.0,))


NOISE = ("noise", "read noise", "gain", "noise parameters", "smoothed")
GEOMETRY = ("shift", "orientation", "mirrored", "rotated", "second plane", "diversity")
SAME = ("same picture", "identical", "diversity")
PIXELS = ("pixels", "hot pixels", "cosmic rays", "outliers", "bad pixels")
CLIPPED = ("saturation", "saturated", "clipped")
LINEARITY = ("linearity", "gamma", "offset", "background", "dark")

WRONG = (
    Case(
        "read noise stated 50 times too high",
        "wrong",
        AMPLITUDE,
        stated_as(read_noise_electrons=times(50)),
        NOISE,
    ),
    Case(
        "read noise stated 50 times too high, tissue",
        "wrong",
        COMPLEX,
        stated_as(read_noise_electrons=times(50)),
        NOISE,
    ),
    Case(
        "gain stated 30 times too low",
        "wrong",
        AMPLITUDE,
        stated_as(gain_electrons_per_count=times(1 / 30)),
        NOISE,
    ),
    Case(
        "gain stated 30 times too high",
        "wrong",
        AMPLITUDE,
        stated_as(gain_electrons_per_count=times(30)),
        NOISE,
    ),
    Case(
        "gain stated 30 times too low, tissue",
        "wrong",
        COMPLEX,
        stated_as(gain_electrons_per_count=times(1 / 30)),
        NOISE,
    ),
    Case("frames smoothed, 0.7 px", "wrong", AMPLITUDE, lambda b: smoothed(b.frames(), 0.7), NOISE),
    Case("frames smoothed, 2 px", "wrong", COMPLEX, lambda b: smoothed(b.frames(), 2.0), NOISE),
    *(
        Case(f"{name}, one exposure", "wrong", bench, take, NOISE)
        for name, bench, take in (
            ("read noise stated 50 times too high", ONE_LETTERS, stated_as(read_noise_electrons=times(50))),
            (
                "read noise stated 50 times too high, phantom",
                ONE_PHANTOM,
                stated_as(read_noise_electrons=times(50)),
            ),
            ("gain stated 30 times too low", ONE_LETTERS, stated_as(gain_electrons_per_count=times(1 / 30))),
            (
                "gain stated 30 times too low, phantom",
                ONE_PHANTOM,
                stated_as(gain_electrons_per_count=times(1 / 30)),
            ),
            ("frames smoothed, 0.7 px", ONE_LETTERS, lambda b: smoothed(b.frames(), 0.7)),
            ("frames smoothed, 2 px", ONE_PHANTOM, lambda b: smoothed(b.frames(), 2.0)),
        )
    ),
    Case(
        "gain stated 30 times too low, text",
        "wrong",
        Bench(exposures=THREE),
        stated_as(gain_electrons_per_count=times(1 / 30)),
        NOISE,
    ),
    Case("identical pictures", "wrong", AMPLITUDE, lambda b: first_plane_twice(b.frames(), b.frames()), SAME),
    Case(
        "same picture, other noise",
        "wrong",
        AMPLITUDE,
        lambda b: first_plane_twice(b.frames(), b.frames(seed=SEED)),
        SAME,
    ),
    *(
        Case(f"{name}, {where}", "wrong", bench, take, SAME)
        for where, bench in (("tissue", COMPLEX), ("phantom, one exposure", ONE_PHANTOM))
        for name, take in (
            ("identical pictures", lambda b: first_plane_twice(b.frames(), b.frames())),
            ("same picture, other noise", lambda b: first_plane_twice(b.frames(), b.frames(seed=SEED))),
        )
    ),
    Case("planes 0.1 % apart", "wrong", AMPLITUDE, nearly_one_plane(1e-3), SAME),
    Case("planes 0.1 % apart, phantom, one exposure", "wrong", ONE_PHANTOM, nearly_one_plane(1e-3), SAME),
    Case("planes 1 % apart, tissue", "wrong", COMPLEX, nearly_one_plane(1e-2), SAME),
    *(
        Case(f"second plane {turn}", "wrong", AMPLITUDE, second_plane(turn), GEOMETRY)
        for turn in TURNS
        if turn != "as it is"
    ),
    *(
        Case(
            f"second plane faint, {turn}, {where}",
            "wrong",
            bench,
            second_plane(turn, FAINT),
            GEOMETRY,
            healthy=second_plane("as it is", FAINT),
        )
        for where, bench in (("letters", ONE_LETTERS), ("phantom", ONE_PHANTOM))
        for turn in ("shifted by 3 px", "mirrored", "rotated by 90°")
    ),
    *(
        Case(
            f"second plane weak, {turn}{where}",
            "wrong",
            bench,
            second_plane(turn, WEAK),
            GEOMETRY,
            healthy=second_plane("as it is", WEAK),
        )
        for turn, where, bench in (
            ("shifted by 3 px", "", ONE_LETTERS),
            ("shifted by 20 px", "", ONE_LETTERS),
            ("mirrored", ", phantom", ONE_PHANTOM),
            ("rotated by 90°", ", phantom", ONE_PHANTOM),
            ("rotated by 180°", "", ONE_LETTERS),
            ("transposed", ", phantom", ONE_PHANTOM),
        )
    ),
    Case(
        "lens decentered by 1.25 µm, tilted by 0.1°, one exposure",
        "wrong",
        ONE_EXPOSURE,
        imaged(decenter_x_mm=0.00125, tilt_x_deg=0.1),
        ("mounting",),
    ),
    Case(
        "another object on the second plane",
        "wrong",
        AMPLITUDE,
        lambda b: with_second_plane(b.frames(), b.frames(thing="sparse")),
        ("other object", "second plane", "several objects"),
    ),
    Case("clipped below the top count", "wrong", AMPLITUDE, lambda b: clipped(b.frames(), 0.4), CLIPPED),
    Case("exposed 300 times too long", "wrong", ONE_LETTERS, saturated, CLIPPED),
    Case("200 hot pixels", "wrong", AMPLITUDE, lambda b: with_hot_pixels(b.frames(), 200), PIXELS),
    Case("200 cosmic rays a frame", "wrong", AMPLITUDE, lambda b: with_cosmic_rays(b.frames(), 200), PIXELS),
    Case("long exposure stated 1.5 times too long", "wrong", AMPLITUDE, long_exposures(1.5), ("exposure",)),
    Case("long exposure stated 8 % too long", "wrong", AMPLITUDE, long_exposures(1.08), ("exposure",)),
    Case(
        "source of 0.15° and vibration of 1 µm",
        "wrong",
        CHART,
        lambda b: vibrating(b, 1.0, source_deg=0.15),
        ("source", "source size", "vibration", "coherence"),
    ),
    Case(
        "bandwidth of 30 nm not stated", "wrong", CHART, imaged(bandwidth_nm=30.0), ("bandwidth", "coherence")
    ),
    Case(
        "field stop off centre",
        "wrong",
        AMPLITUDE,
        imaged(stop_um=(6.0, -5.0, STOP_UM)),
        ("field stop",),
        healthy=imaged(stop_um=(0.0, 0.0, STOP_UM)),
        settings=(("field_stop_mm", 1e-3 * STOP_UM),),
        stop_um=(0.0, 0.0, STOP_UM),
    ),
    Case("background of 3 %", "wrong", AMPLITUDE, imaged(plane_background=(0.03, 0.03)), ("background",)),
    Case(
        "planes swapped, tissue",
        "wrong",
        COMPLEX,
        lambda b: at_planes(b.frames(), *b.planes_mm[::-1]),
        ("planes swapped",),
    ),
    Case("wavelength 560 nm, 532 nm stated", "wrong", AMPLITUDE, imaged(wavelength_um=0.56), ("wavelength",)),
    Case("gamma of 2.2", "wrong", AMPLITUDE, lambda b: with_gamma(b.frames(), 2.2), LINEARITY),
    Case(
        "quantised to 8 bits of 12", "wrong", AMPLITUDE, lambda b: quantised(b.frames(), 8), (*NOISE, "bits")
    ),
    Case("dark count of 64 stated as 0", "wrong", AMPLITUDE, stated_as(offset_counts=0.0), LINEARITY),
    Case("dark count of 64 stated as 54", "wrong", COMPLEX, stated_as(offset_counts=54.0), LINEARITY),
    *(
        Case(f"{name}, one exposure", "wrong", bench, take, causes)
        for name, bench, take, causes in (
            ("gamma of 2.2", ONE_LETTERS, lambda b: with_gamma(b.frames(), 2.2), LINEARITY),
            ("gamma of 2.2, phantom", ONE_PHANTOM, lambda b: with_gamma(b.frames(), 2.2), LINEARITY),
            ("quantised to 6 bits of 12", ONE_LETTERS, lambda b: quantised(b.frames(), 6), (*NOISE, "bits")),
            ("dark count of 64 stated as 0", ONE_PHANTOM, stated_as(offset_counts=0.0), LINEARITY),
            ("dark count of 64 stated as 54", ONE_LETTERS, stated_as(offset_counts=54.0), LINEARITY),
            ("clipped at a tenth of the top count", ONE_PHANTOM, lambda b: clipped(b.frames(), 0.1), CLIPPED),
            ("200 cosmic rays a frame", ONE_PHANTOM, lambda b: with_cosmic_rays(b.frames(), 200), PIXELS),
        )
    ),
    Case(
        "tissue stated as an amplitude object",
        "wrong",
        Bench(1 / 48, "tissue", patch_mm=0.03, seed=1),
        causes=("kind", "phase"),
    ),
)

FINE_TILES: Settings = (("engine", "eikonal"), ("error", 0.0112), ("tile_width_mm", 0.0077))
"""Settings of `wavesim image` for a predicted error of 0.024 on a 1/20 twin, half of the default's."""

PERFECT = (
    Case("star, 1/48", "perfect", Bench(1 / 48, "star", patch_mm=0.03)),
    Case("star, 1/48, one exposure", "perfect", Bench(1 / 48, "star", patch_mm=0.03, exposures=(1.0,))),
    Case("usaf, 1/16", "perfect", Bench(1 / 16, "usaf", patch_mm=0.08)),
    Case("usaf, 1/16, one exposure", "perfect", Bench(1 / 16, "usaf", patch_mm=0.08, exposures=(1.0,))),
    Case("usaf on dark ground, 1/32", "perfect", Bench(thing="usaf dark", exposures=THREE)),
    Case("dense chart, 1/20", "perfect", DENSE),
    Case(
        "dense chart, 1/20, three exposures",
        "perfect",
        # The frames have less noise than the error of the engine that records them by default.
        Bench(1 / 20, "dense", "amplitude", 0.12, THREE, imaged=FINE_TILES),
    ),
    Case("dense chart, 1/48", "perfect", Bench(1 / 48, "dense", patch_mm=0.03)),
    Case("text, 1/32", "perfect", Bench()),
    Case("text, 1/32, three exposures", "perfect", Bench(exposures=THREE)),
    Case("letters, 1/48, three exposures", "perfect", AMPLITUDE),
    Case("letters, 1/32", "perfect", Bench(thing="letters")),
    Case("letters, 1/32, three planes", "perfect", Bench(thing="letters", planes=3)),
    Case("sparse, 1/20", "perfect", Bench(1 / 20, "sparse", patch_mm=0.08)),
    Case(
        "sparse, 1/16, three exposures",
        "perfect",
        Bench(1 / 16, "sparse", "amplitude", 0.06, THREE),
    ),
    Case("phase, 1/32", "perfect", Bench(thing="phase", kind="complex")),
    Case(
        "phase, 1/48, three exposures",
        "perfect",
        Bench(1 / 48, "phase", "complex", 0.03, THREE),
    ),
    Case(
        "phase, 1/20, three planes, one exposure",
        "perfect",
        Bench(1 / 20, "phase", "complex", 0.06, (1.0,), 3),
    ),
    Case(
        "tissue, 1/20, three exposures",
        "perfect",
        Bench(1 / 20, "tissue", "complex", 0.128, THREE, seed=1),
    ),
    Case("tissue, 1/32, one exposure", "perfect", Bench(thing="tissue", kind="complex", exposures=(1.0,))),
    Case("tissue, 1/48, three exposures", "perfect", COMPLEX),
    Case("tissue, 1/16, three planes", "perfect", Bench(1 / 16, "tissue", "complex", 0.08, planes=3)),
    Case(
        "phantom, 1/16, three exposures",
        "perfect",
        Bench(1 / 16, "phantom", "complex", 0.08, THREE),
    ),
    Case(
        "phantom, 1/48, four planes, three exposures",
        "perfect",
        Bench(1 / 48, "phantom", "complex", 0.03, THREE, 4),
    ),
    Case("star, 1/32, four planes, one exposure", "perfect", Bench(thing="star", exposures=(1.0,), planes=4)),
    Case("usaf as complex, 1/32", "perfect", Bench(thing="usaf", kind="complex")),
    Case(
        "dense chart as complex, 1/20, three exposures",
        "perfect",
        Bench(1 / 20, "dense", "complex", 0.08, THREE),
    ),
    Case("star as complex, 1/48", "perfect", Bench(1 / 48, "star", "complex", 0.03)),
    Case(
        "sparse as complex, 1/32, three exposures",
        "perfect",
        Bench(1 / 32, "sparse", "complex", 0.05, THREE),
    ),
    Case("text, 1/32, 633 nm", "perfect", Bench(wavelength_um=0.633)),
    Case(
        "tissue, 1/32, 460 nm, three exposures",
        "perfect",
        Bench(thing="tissue", kind="complex", exposures=THREE, wavelength_um=0.46, seed=2),
    ),
    Case(
        "star, 1/48, source of 0.1° stated",
        "perfect",
        Bench(
            1 / 48,
            "star",
            patch_mm=0.03,
            imaged=(("source_deg", 0.1),),
            reconstructed=(("source_deg", 0.1),),
        ),
    ),
    Case(
        "letters, 1/48, source of 0.15° to be found",
        "perfect",
        Bench(
            1 / 48,
            "letters",
            patch_mm=0.03,
            imaged=(("source_deg", 0.15),),
            reconstructed=(("source_deg", "find"),),
        ),
    ),
    Case(
        "letters, 1/48, bandwidth of 20 nm stated",
        "perfect",
        Bench(
            1 / 48,
            "letters",
            patch_mm=0.03,
            imaged=(("bandwidth_nm", 20.0),),
            reconstructed=(("bandwidth_nm", 20.0),),
        ),
    ),
    Case(
        "star, 1/48, bandwidth of 30 nm to be found",
        "perfect",
        Bench(
            1 / 48,
            "star",
            patch_mm=0.03,
            imaged=(("bandwidth_nm", 30.0),),
            reconstructed=(("bandwidth_nm", "find"),),
        ),
    ),
    Case(
        "tissue, 1/48, source of 0.1° stated",
        "perfect",
        Bench(
            1 / 48,
            "tissue",
            "complex",
            0.03,
            imaged=(("source_deg", 0.1),),
            reconstructed=(("source_deg", 0.1),),
        ),
    ),
)

QUICK: Settings = (("engine", "eikonal"), ("error", 0.3))
SMALL = Bench(
    1 / 48, "star", "amplitude", 0.03, pixels=140, imaged=QUICK, reconstructed=(*QUICK, ("iterations", 12))
)
SMALL_COMPLEX = Bench(
    1 / 48, "star", "complex", 0.03, pixels=140, imaged=QUICK, reconstructed=(*QUICK, ("iterations", 25))
)
SMALL_PHASE = Bench(
    1 / 48, "phase", "complex", 0.03, pixels=140, imaged=QUICK, reconstructed=(*QUICK, ("iterations", 25))
)


def caused(name: str, take: Taking, cause: str = "", bench: Bench = SMALL, **more: Any) -> Case:
    """Return a case of an error on a small twin; without a cause where frames do not show the error."""
    name = f"{name}, complex" if bench.kind == "complex" else name
    return Case(name, "cause", bench, take, (cause,) if cause else (), **more)


def stated_planes(first: float, second: float) -> Taking:
    """Return frames that state so many times the distances of their planes."""
    return lambda bench: at_planes(bench.frames(), first * bench.planes_mm[0], second * bench.planes_mm[1])


def swapped(bench: BenchFrames) -> Sequence[Frame]:
    """Return frames whose planes state each other's distances."""
    return at_planes(bench.frames(), *bench.planes_mm[::-1])


def pitch(factor: float) -> Taking:
    """Return frames whose pixels are so many times larger than stated."""

    def take(bench: BenchFrames) -> Sequence[Frame]:
        sensor = bench.lens.sensor
        other = sensor.replaced(pixel_pitch_um=factor * sensor.pixel_pitch_um)
        return bench.frames(lens=bench.lens.replaced(sensor=other))

    return take


def radius(surface: int, factor: float) -> Callable[[Lens], Lens]:
    """Return a design whose surface (its index) has so many times the radius."""

    def believed(lens: Lens) -> Lens:
        surfaces = list(lens.surfaces)
        surfaces[surface] = surfaces[surface].replaced(
            radius_mm=factor * (surfaces[surface].radius_mm or 0.0)
        )
        return lens.replaced(surfaces=tuple(surfaces))

    return believed


AS_TAKEN: Taking = BenchFrames.frames

CAUSES = (
    caused("planes swapped", swapped, "planes swapped"),
    caused("second plane nearer by a third", stated_planes(1.0, 1.5), "distance"),
    caused("second plane nearer by 7 %", stated_planes(1.0, 1.08), "distance"),
    caused("both planes nearer by 9 %", stated_planes(1.1, 1.1), "distance"),
    caused("pixels larger by 15 %", pitch(1.15), "pixel pitch"),
    caused("pixels larger by 5 %", pitch(1.05), "pixel pitch"),
    caused("pixels smaller by 3 %", pitch(0.97), "pixel pitch"),
    caused("light tilted by 0.3, 0°", imaged(light_error_deg=(0.3, 0.0)), "light"),
    caused("light tilted by -0.2, 0.3°", imaged(light_error_deg=(-0.2, 0.3)), "light"),
    caused("light tilted by 0, 0.6°", imaged(light_error_deg=(0.0, 0.6)), "light"),
    caused("light bent, 20:0.15,11:0.1 waves", imaged(light_phase_waves="20:0.15,11:0.1"), "light"),
    caused("light bent, 02:-0.3 waves", imaged(light_phase_waves="02:-0.3"), "light"),
    caused(
        "second plane shifted by 1.3, -2.2 µm",
        imaged(plane_shift_um=((0.0, 0.0), (1.3, -2.2))),
        "shift",
    ),
    caused("second plane shifted by -3, 0 µm", imaged(plane_shift_um=((0.0, 0.0), (-3.0, 0.0))), "shift"),
    caused("background of 2 %", imaged(plane_background=(0.02, 0.02)), "background"),
    caused("background of 5 %, second plane", imaged(plane_background=(0.0, 0.05)), "background"),
    caused("design with first radius 20 % longer", AS_TAKEN, "lens", believed=radius(0, 1.2)),
    caused("design with second radius 3 % shorter", AS_TAKEN, "lens", believed=radius(1, 0.97)),
    caused("index 0.01 higher", imaged(perturb="surface 1: index=0.01"), "lens"),
    caused("lens 0.02 mm thicker", imaged(perturb="surface 1: thickness_mm=0.02"), "lens"),
    caused("lens decentered by 10 µm", imaged(decenter_x_mm=0.01), "mounting"),
    caused(
        "lens decentered by 3 µm, tilted by 0.3°",
        imaged(decenter_x_mm=0.003, tilt_x_deg=0.3),
        "mounting",
    ),
    caused("object farther by 0.01 mm", imaged(working_distance_error_mm=0.01), "working distance"),
    caused("wavelength 560 nm, 532 stated", imaged(wavelength_um=0.56), "wavelength"),
    caused("planes swapped", swapped, "planes swapped", SMALL_COMPLEX),
    caused("pixels larger by 5 %", pitch(1.05), "pixel pitch", SMALL_COMPLEX),
    caused(
        "design with second radius 3 % shorter", AS_TAKEN, "lens", SMALL_COMPLEX, believed=radius(1, 0.97)
    ),
    caused("second plane nearer by 3 %", stated_planes(1.0, 1.03)),
    caused("pixels larger by 1 %", pitch(1.01)),
    caused("design with first radius 5 % longer", AS_TAKEN, believed=radius(0, 1.05)),
    caused("ghost of 0.18 %", imaged(ghost=0.0018)),
)
AS_DESIGNED = (
    Case("as designed, star", "perfect", SMALL),
    Case("as designed, star, other noise", "perfect", SMALL, imaged(seed=SEED)),
    Case("as designed, star as complex", "perfect", SMALL_COMPLEX),
    Case("as designed, phase", "perfect", SMALL_PHASE),
)

CASES: tuple[Case, ...] = (*WRONG, *PERFECT, *AS_DESIGNED, *CAUSES)
