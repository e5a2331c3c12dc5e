"""Both ways of reconstruction on the one-eighth twin of the paper's lens, from points and from frames."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from lensdesign.lens.lens import Sensor
from wavesim import (
    Electronics,
    Engine,
    Field,
    Grid,
    Measurement,
    SamplingWarning,
    Scene,
    engine_for,
    propagate,
    reconstruct,
    retrieve,
)
from wavesim.fields.coverage import rectangle, rectangle_coverage
from wavesim.metrics import element_contrasts, object_correlation, smallest_resolved_element, transmitted_part
from wavesim.sensor import Camera, Frame, light_on_pixels, plane_seeds, recorded_planes
from wavesim.targets import usaf_chart, usaf_elements_within

SIDE_MM, PITCH_MM, PIXELS, PIXEL_MM = 0.38, 0.4256e-3, 864, 3.2e-3
STOP_MM = 0.98 * SIDE_MM
PLANES_MM = (0.625, 3.125)
BRIGHTEST_ELECTRONS = 10_000.0
RETRIEVAL_ITERATIONS = 500
SENSOR = Sensor(pixel_pitch_um=1e3 * PIXEL_MM, pixels=(PIXELS, PIXELS), plane_distances_mm=PLANES_MM)
CAMERA = Electronics(full_well_electrons=1.3 * BRIGHTEST_ELECTRONS)


@dataclass(frozen=True, eq=False)
class Case:
    """The object under its field stop, and the field on both planes."""

    transmission: np.ndarray
    fields: tuple[Field, ...]


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    print_table("Correlation with the band-limited object, the illumination taken out of both", from_points())
    print_table(
        f"The same from frames: pixels integrate, shot and read noise, 12 bits, brightest pixel "
        f"{BRIGHTEST_ELECTRONS:g} electrons",
        from_frames() + chart_from_frames(),
    )


@cache
def twin() -> tuple[Engine, Field]:
    """The engine and the illumination."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), 0.125)
    count = round(SIDE_MM / PITCH_MM)
    grid = Grid((count, count), PITCH_MM, lens.object_z_mm)
    exit_grid = Grid((PIXELS, PIXELS), PIXEL_MM, lens.exit_vertex_z_mm + PLANES_MM[0])
    engine = engine_for(Scene(lens, grid, exit_grid, 0.532), "eikonal", error=0.1)
    stop = (np.sqrt(grid.radius_squared_mm2()) < 0.5 * STOP_MM).astype(np.complex64)
    return engine, Field(grid, stop, 0.532)


def random_bars() -> np.ndarray:
    """Where 60 groups of bars of 0.87 to 6 um are."""
    rng = np.random.default_rng(60)
    grid = twin()[1].grid
    bars = np.zeros(grid.shape)
    for _ in range(60):
        width = rng.uniform(0.87e-3, 6e-3)
        x, y = rng.uniform(-0.17, 0.17, 2)
        for bar in (-1, 0, 1):
            part = rectangle((x + 2 * bar * width, y), width, 5 * width)
            bars = np.maximum(bars, rectangle_coverage(grid, [part]))
    return bars


def seen(transmission: np.ndarray) -> Case:
    """An object's field on both planes."""
    engine, lit = twin()
    at_exit = engine.forward(lit.with_values((transmission * lit.values).astype(np.complex64)))
    fields = [propagate(at_exit, d - PLANES_MM[0], band_limit=False, check=False) for d in PLANES_MM]
    return Case(transmission, tuple(f.with_values(np.asarray(f.values, np.complex64)) for f in fields))


def points(case: Case) -> list[Measurement]:
    """Amplitudes at points, without noise."""
    return [
        Measurement(d - PLANES_MM[0], np.abs(field.values))
        for d, field in zip(PLANES_MM, case.fields, strict=True)
    ]


def frames(case: Case, seed: int = 1) -> list[Measurement]:
    """Amplitudes estimated from a camera's frames, each exposed for itself, and their standard deviations."""
    share = BRIGHTEST_ELECTRONS / CAMERA.full_well_electrons
    planes = zip(PLANES_MM, case.fields, plane_seeds(seed, len(PLANES_MM)), strict=True)
    camera = Camera(SENSOR, CAMERA, peak_fill=share)
    found: list[Frame] = []
    for distance, field, one in planes:
        light = light_on_pixels(field, SENSOR, fill_factor=CAMERA.fill_factor)
        found += camera.frames(light, distance, field.wavelength_um, one)
    return recorded_planes(found)


def from_points() -> list[Row]:
    """Both ways, two planes and one."""
    bars, rows = random_bars(), []
    for ground, transmission in (("bright", 1.0 - bars), ("dark", bars)):
        case = seen(transmission)
        recorded = points(case)
        wanted = 0.985 if ground == "bright" else 0.98
        rows += object_domain(f"{ground}, amplitude", case, recorded, wanted, kind="amplitude")
        if ground == "bright":
            rows += object_domain(f"{ground}, complex", case, recorded, 0.98)
            rows += object_domain(
                f"{ground}, amplitude, one plane", case, recorded[:1], 0.95, kind="amplitude"
            )
        else:
            rows += object_domain(f"{ground}, complex", case, recorded, None, start="amplitude")
        rows += dual_plane(ground, case, recorded)
    return rows


def from_frames() -> list[Row]:
    """By pixels that integrate, and by points that do not; by standard deviations, and without."""
    bars, rows = random_bars(), []
    for ground, transmission in (("bright", 1.0 - bars), ("dark", bars)):
        case = seen(transmission)
        recorded = frames(case)
        alike = [replace(plane, sigma=None) for plane in recorded]
        name = f"{ground}, amplitude"
        rows += object_domain(f"{name}, points, sigma unknown", case, alike, kind="amplitude")
        pixels: dict[str, Any] = {"kind": "amplitude", "fill_factor": 1.0}
        rows += object_domain(f"{name}, pixels, sigma unknown", case, alike, **pixels)
        rows += object_domain(f"{name}, pixels, sigma", case, recorded, **pixels)
        rows += object_domain(
            f"{name}, pixels, sigma, auto",
            case,
            recorded,
            0.975 if ground == "bright" else None,
            tv_weight="auto",
            **pixels,
        )
        if ground == "bright":
            complex_: dict[str, Any] = {"fill_factor": 1.0, "tv_weight": "auto"}
            rows += object_domain(f"{ground}, complex, pixels, sigma, auto", case, recorded, 0.93, **complex_)
    return rows


def chart_from_frames() -> list[Row]:
    """The finest element of a USAF chart that is resolved."""
    engine, lit = twin()
    elements = usaf_elements_within(lit.grid, STOP_MM / np.sqrt(2.0))
    case = seen(usaf_chart(lit.grid, elements, "bright").real)
    rows = []
    for kind in ("amplitude", "complex"):
        found = reconstruct(
            engine,
            lit,
            frames(case),
            kind=kind,
            tv_weight="auto",
            scale=1.0,
            iterations=30,
            fill_factor=1.0,
        )
        finest = smallest_resolved_element(element_contrasts(found.transmission.values, lit.grid, elements))
        width = np.inf if finest is None else finest.line_width_um
        rows.append(Row(f"USAF chart, {kind}: finest lines resolved", width, "um", at_most=0.871))
    return rows


def object_domain(
    name: str,
    case: Case,
    recorded: Sequence[Measurement],
    at_least: float | None = None,
    *,
    tv_weight: Any = 0.02,
    **settings: Any,
) -> list[Row]:
    """One reconstruction of at most 30 iterations."""
    engine, lit = twin()
    started = time.perf_counter()
    found = reconstruct(engine, lit, recorded, tv_weight=tv_weight, scale=1.0, iterations=30, **settings)
    seconds = time.perf_counter() - started
    values = (found.transmission.values * lit.values).astype(np.complex64)
    reached = score(case, transmitted_part(lit.with_values(values), engine))
    return [
        Row(f"{name} ({len(found.misfit)} iterations)", reached, at_least=at_least),
        Row("  an iteration", seconds / len(found.misfit), "s", at_most=0.8),
    ]


def dual_plane(name: str, case: Case, recorded: Sequence[Measurement]) -> list[Row]:
    """Appendix A, from the forward model's field, an even and a random phase."""
    engine, lit = twin()
    grid = engine.scene.exit_grid
    first = recorded[0].amplitude
    scale = np.float32(64.0 / np.median(first[first > 1e-4 * first.max()]))
    planes = [Measurement(p.distance_mm, scale * p.amplitude) for p in recorded]
    model = engine.forward(lit)
    starts: dict[str, Any] = {
        "forward model": model.with_values(scale * model.values),
        "even": "uniform",
        "random": "random",
    }
    rows = []
    for start, field in starts.items():
        found = retrieve(grid, 0.532, planes, field, iterations=RETRIEVAL_ITERATIONS)
        rows += [
            Row(
                f"{name}: Appendix A, {RETRIEVAL_ITERATIONS} iterations, start {start}",
                score(case, engine.adjoint(found.field)),
            ),
            Row("  its CC (A6)", found.correlation[-1]),
        ]
    return rows


def score(case: Case, found: Field) -> float:
    """Correlation inside the field stop with the object as the lens passes it."""
    engine, lit = twin()
    truth = transmitted_part(lit.with_values((lit.values * case.transmission).astype(np.complex64)), engine)
    return object_correlation(found, truth, transmitted_part(lit, engine), np.abs(lit.values) > 0.0)


if __name__ == "__main__":
    main()
