"""Annular slices: the paper's lens, the dielectric cylinder, tilted surfaces, and what is refused."""

import math
import warnings
from collections.abc import Sequence

import numpy as np
import pytest
from engine_checks import dot_product_mismatch, engine_peak_bytes
from numpy.typing import NDArray
from places import DESIGNS
from scipy.interpolate import CubicSpline
from small_twins import small_spot, stopped_down

from lensdesign import Pose, load_design
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.raytrace.bundles import launch_compiled
from lensdesign.raytrace.rays import trace_compiled
from wavesim.analytic.cylinder import cylinder_scene
from wavesim.analytic.registry import AnalyticCase
from wavesim.engines.slices.compensation import COMPENSATIONS, centre_rays
from wavesim.engines.slices.engine import AnnularSlices
from wavesim.engines.slices.samples import IlluminatedArea
from wavesim.engines.wpm.engine import WavePropagation
from wavesim.fields.field import Field, Grid, correlation, relative_error
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.scene.scene import Scene

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PAPER = load_design(DESIGNS / "paper_singlet.toml")
WAVELENGTH_UM = 0.532
K_PER_MM = 2e3 * math.pi / WAVELENGTH_UM

pytestmark = pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")


@pytest.fixture(scope="module")
def paper_line() -> Scene:
    """The paper's lens and one object point, to 2 mm behind the exit vertex."""
    return Scene(PAPER, Grid((1024,), 1.33e-4, -13.5), Grid((34000,), 5e-4, 11.7), WAVELENGTH_UM)


def line_source(grid: Grid) -> Field:
    """Even plane waves up to a sine of 0.5, in phase on the axis."""
    sine, step = np.linspace(-0.5, 0.5, 2001, retstep=True)
    values = np.exp(1j * K_PER_MM * np.outer(grid.y_mm, sine)).sum(axis=1) * step
    return Field(grid, values, WAVELENGTH_UM)


def along_rays(scene: Scene) -> tuple[Complex, Array]:
    """Geometric field of the line source on the exit grid, and the object-side cosine of its rays."""
    pupil = np.column_stack([np.zeros(4001), np.linspace(-1.0, 1.0, 4001)])
    stop = scene.lens.stop_semi_diameter_mm * (1.0 - 1e-9)
    start, heading = launch_compiled(
        scene.system, [(0.0, 0.0)], pupil, scene.object_grid.z_mm, scene.lens.stop_index, stop
    )
    rays = trace_compiled(scene.system, start, heading, scene.exit_grid.z_mm)
    order = np.argsort(rays.position[:, 1])
    y, sine = rays.position[order, 1], heading[order, 1]
    amplitude = np.sqrt(np.abs(np.gradient(sine, y)) * heading[order, 2] / rays.direction[order, 2])
    there = scene.exit_grid.y_mm
    inside = (there >= y[0]) & (there <= y[-1])
    phase = np.mod(K_PER_MM * CubicSpline(y, rays.opl[order])(there), 2.0 * np.pi)
    field = np.where(inside, CubicSpline(y, amplitude)(there) * np.exp(1j * phase), 0.0)
    return field, np.interp(there, y, heading[order, 2])


def refocused(field: Complex, truth: Complex, cosine: Array) -> float:
    """Correlation after the object point is moved along the axis to where it is greatest."""
    product = truth.conj() * field
    edges = np.linspace(cosine.min(), 1.0, 1001)
    parts = [np.histogram(cosine, edges, weights=w)[0] for w in (product.real, product.imag)]
    wave = K_PER_MM * 0.5 * (edges[1:] + edges[:-1])
    shifts = np.linspace(-0.6, 0.6, 1201)
    best = max(abs((parts[0] + 1j * parts[1]) @ np.exp(1j * wave * shift)) for shift in shifts)
    return float(best / (np.linalg.norm(field) * np.linalg.norm(truth)))


def flux(field: Field) -> float:
    """Integral of |u|^2 cos over the plane waves."""
    spectrum = np.abs(np.fft.fftn(field.values)) ** 2
    squared = np.asarray(K_PER_MM**2)
    for axis, n in enumerate(field.grid.shape):
        across = 2.0 * np.pi * np.fft.fftfreq(n, field.grid.pitch_mm)
        squared = squared - np.expand_dims(across**2, tuple(a for a in range(spectrum.ndim) if a != axis))
    kz = np.sqrt(np.maximum(squared, 0.0)) / K_PER_MM
    return float((spectrum * kz).sum()) / spectrum.size * field.grid.cell


def error(case: AnalyticCase, **settings: object) -> float:
    engine = AnnularSlices(case.scene, **settings)  # type: ignore[arg-type]
    return relative_error(engine.forward(case.object_field).values, case.exact.values)


def test_oblique_slices_of_the_papers_lens(paper_line: Scene) -> None:
    truth, _ = along_rays(paper_line)
    source = line_source(paper_line.object_grid)
    found = {}
    for slices in (10, 30, 100):
        field = AnnularSlices(paper_line, slices, "oblique").forward(source)
        assert np.all(np.isfinite(field.values))
        found[slices] = correlation(field.values, truth)
    assert found[10] > 0.99
    assert found[30] > 0.995
    assert found[100] > 0.999


def test_vertical_slices_of_the_papers_lens(paper_line: Scene) -> None:
    truth, cosine = along_rays(paper_line)
    source = line_source(paper_line.object_grid)
    fields = {n: AnnularSlices(paper_line, n).forward(source).values for n in (10, 30, 200, 800)}
    plain = {n: correlation(field, truth) for n, field in fields.items()}
    assert plain[10] == pytest.approx(0.146, abs=0.02)
    assert plain[30] < 0.3
    assert plain[200] == pytest.approx(0.34, abs=0.03)
    assert plain[800] == pytest.approx(0.82, abs=0.03)
    # What is smooth in the error of vertical compensation is mostly defocus.
    assert refocused(fields[200], truth, cosine) == pytest.approx(0.575, abs=0.03)
    assert refocused(fields[800], truth, cosine) > 0.99


@pytest.mark.parametrize(("radius_mm", "slices"), [(0.1, 200), (0.2, 400), (0.8, 800)])
def test_oblique_slices_converge_to_the_cylinder(radius_mm: float, slices: int) -> None:
    case = cylinder_scene(radius_mm)
    assert error(case, slices=slices, compensation="oblique") < 1e-2
    assert error(case, slices=2, compensation="oblique") < 2.5e-2
    assert error(case, slices=2, compensation="vertical") > 0.3


def order(slices: Sequence[int], errors: Sequence[float]) -> float:
    """Power of one over the number of slices with which the error falls."""
    return -float(np.polyfit(np.log(slices), np.log(errors), 1)[0])


def test_both_compensations_converge_with_the_first_power() -> None:
    case = cylinder_scene(0.1)
    thin, thick = [100, 200, 400, 800], [3, 5, 10]
    assert 0.9 < order(thin, [error(case, slices=n, compensation="oblique") for n in thin]) < 1.4
    assert 0.8 < order(thick, [error(case, slices=n, compensation="vertical") for n in thick]) < 1.4


def test_few_oblique_slices_err_with_the_second_power() -> None:
    case = cylinder_scene(0.8)
    counts = [1, 2, 3]
    assert order(counts, [error(case, slices=n, compensation="oblique") for n in counts]) > 1.9


@pytest.mark.parametrize("compensation", ["vertical", "oblique"])
def test_neglected_is_more_than_what_is_wrong(compensation: str) -> None:
    case = cylinder_scene(0.1)
    for slices in (2, 20, 200):
        engine = AnnularSlices(case.scene, slices, compensation)  # type: ignore[arg-type]
        said = [n.relative_error for n in engine.error_terms()]
        assert said == sorted(said, reverse=True)
        assert relative_error(engine.forward(case.object_field).values, case.exact.values) < math.hypot(*said)


def test_a_tilted_and_decentered_lens_on_the_plane() -> None:
    moved = {1: SurfacePerturbation(tilt_x_deg=0.5, decenter_x_mm=0.004)}
    scene = stopped_down(0.05, pose=Pose(tilt_y_deg=1.0, decenter_y_mm=0.01), surface_perturbations=moved)
    source = small_spot(scene.object_grid, 0.006)
    truth = WavePropagation(scene).forward(source).values
    straight = AnnularSlices(stopped_down(0.05), 20, "oblique").forward(source).values
    oblique = AnnularSlices(scene, 20, "oblique").forward(source)
    vertical = AnnularSlices(scene, 20, "vertical").forward(source)
    assert relative_error(straight, truth) > 0.5
    assert relative_error(oblique.values, truth) < 5e-3
    assert relative_error(vertical.values, truth) < 3e-2


def test_energy_on_the_plane() -> None:
    scene = stopped_down()
    source = small_spot(scene.object_grid, 0.004)
    kept = flux(AnnularSlices(scene, 10, "oblique").forward(source)) / flux(source)
    assert kept == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("compensation", ["vertical", "oblique"])
@pytest.mark.parametrize("spacing", ["equal", "paper", "equal-phase"])
def test_adjoint_on_a_line(compensation: str, spacing: str) -> None:
    engine = AnnularSlices(cylinder_scene(0.1).scene, 12, compensation, spacing)  # type: ignore[arg-type]
    assert dot_product_mismatch(engine) < 1e-10


@pytest.mark.parametrize("compensation", ["vertical", "oblique"])
def test_adjoint_on_a_plane(compensation: str) -> None:
    scene = stopped_down(0.05, pose=Pose(tilt_x_deg=2.0, decenter_x_mm=0.01), coating="bare")
    assert dot_product_mismatch(AnnularSlices(scene, 4, compensation)) < 1e-10  # type: ignore[arg-type]


def test_every_sample_of_a_tilted_surface_is_in_one_slice() -> None:
    engine = AnnularSlices(stopped_down(0.05, pose=Pose(tilt_x_deg=3.0)), 7)
    for i, surface in enumerate(engine._prepared.surfaces):
        reached = IlluminatedArea(engine.scene, i, engine.sides[i][0].grid, engine.light.reach_mm[i])
        z, lit = reached.heights(0, reached.shape[0])
        inside = lit > 0.0
        assert np.array_equal(inside, surface.indices != np.iinfo(surface.indices.dtype).max)
        assert np.array_equal(inside, surface.factors != 0.0)
        counted = np.zeros(inside.shape, int)
        parts = zip(surface.labels, surface.boxes, surface.before_mm, surface.behind_mm, strict=True)
        for label, box, low, high in parts:
            own = surface.indices[box] == label
            counted[box] += own
            assert np.all((z[box][own] >= low - 1e-12) & (z[box][own] <= high + 1e-12))
        assert np.array_equal(counted, inside)


def planes(scene: Scene, slices: int, compensation: str, spacing: str) -> list[Array]:
    engine = AnnularSlices(scene, slices, compensation, spacing)  # type: ignore[arg-type]
    return engine._nominal_planes


def test_equal_spacing(paper_line: Scene) -> None:
    for surface in planes(paper_line, 20, "vertical", "equal"):
        assert len(surface) == 21
        assert np.ptp(np.diff(surface)) < 1e-12


def test_the_papers_spacing_is_smaller_where_the_radius_is(paper_line: Scene) -> None:
    front, back = planes(paper_line, 200, "vertical", "paper")
    assert len(front) + len(back) == pytest.approx(402, abs=2)
    # A sphere of 42.3 mm, and a conic that has 12 mm at its vertex, where it reaches highest.
    assert np.diff(front) == pytest.approx(np.mean(np.diff(front)), rel=1e-3)
    assert np.diff(back)[-1] / np.mean(np.diff(front)) == pytest.approx(12.0 / 42.3, rel=0.05)
    assert np.all(np.diff(np.diff(back)) < 1e-9)


@pytest.mark.parametrize("compensation", ["vertical", "oblique"])
def test_slices_of_equal_phase(paper_line: Scene, compensation: str) -> None:
    rays = centre_rays(paper_line, (0.0, 0.0), fan=True)
    spread = {}
    for spacing in ("equal", "equal-phase"):
        largest = []
        for ray, cut in zip(rays, planes(paper_line, 15, compensation, spacing), strict=True):
            phase = COMPENSATIONS[compensation](ray).phase_error(cut, K_PER_MM)
            slot = np.searchsorted(cut[1:-1], ray.z_mm)
            largest += [np.max(phase[slot == i]) for i in np.unique(slot)[1:-1]]
        spread[spacing] = np.std(largest) / np.mean(largest)
    assert spread["equal-phase"] < 0.5 * spread["equal"]
    assert spread["equal-phase"] < 0.35


def test_equal_phase_helps_where_phase_is_what_is_wrong(paper_line: Scene) -> None:
    """Oblique compensation with few slices."""
    worst = {}
    for spacing in ("equal", "equal-phase"):
        engine = AnnularSlices(paper_line, 5, "oblique", spacing)
        worst[spacing] = next(n for n in engine.error_terms() if "within" in n.description).relative_error
    assert worst["equal-phase"] < worst["equal"]


def test_warns_of_too_few_slices(paper_line: Scene) -> None:
    source = line_source(paper_line.object_grid)
    with pytest.warns(SamplingWarning, match="slices = 20: .*vertical .* waves .* more slices"):
        AnnularSlices(paper_line, 20).forward(source)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SamplingWarning)
        AnnularSlices(paper_line, 30, "oblique").forward(source)


def test_refuses_grids_that_cannot_hold_the_field() -> None:
    case = cylinder_scene(0.1)
    with pytest.raises(SamplingError, match="too coarse"):
        error(case, pitch_mm=5e-4)
    with pytest.raises(SamplingError, match="too narrow"):
        error(case, half_width_mm=0.05)


def tilted_back(tilt_deg: float) -> Scene:
    """The cylinder, its exit surface turned."""
    return Scene(
        cylinder_scene(0.1).scene.lens,
        Grid((32,), 1.33e-4, -0.05),
        Grid((400,), 2.5e-4, 0.21),
        WAVELENGTH_UM,
        surface_perturbations={1: SurfacePerturbation(tilt_x_deg=tilt_deg)},
    )


@pytest.mark.filterwarnings("ignore::wavesim.engines.surfaces.grids.TotalReflectionWarning")
@pytest.mark.parametrize("compensation", ["vertical", "oblique"])
def test_refuses_total_reflection(compensation: str) -> None:
    scene, source = tilted_back(2.0), small_spot(tilted_back(2.0).object_grid, 0.001)
    truth = WavePropagation(scene).forward(source).values
    field = AnnularSlices(scene, 400, compensation).forward(source).values  # type: ignore[arg-type]
    assert relative_error(field, truth) < 2e-2
    with pytest.raises(InputError, match="total reflection of"):
        AnnularSlices(tilted_back(40.0), 400, compensation).forward(source)  # type: ignore[arg-type]


def test_refuses_the_papers_lens_on_the_plane() -> None:
    scene = Scene(PAPER, Grid((64, 64), 1e-3, -13.5), Grid((64, 64), 1e-3, 11.7), WAVELENGTH_UM)
    engine = AnnularSlices(scene, 200)
    cost = engine.cost()
    assert all(front.grid.shape[0] > 31_000 for front, _ in engine.sides)
    assert cost.seconds > 3600.0
    assert cost.peak_bytes > 31_000**2 * 16
    with pytest.raises(SamplingError, match=r"samples .*bytes.*force"):
        engine.forward(small_spot(scene.object_grid, 0.01))


def test_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wavesim.engines.surfaces.grids.LARGEST_BYTES", 1000)
    case = cylinder_scene(0.1)
    with pytest.raises(SamplingError, match="force"):
        error(case)
    assert error(case, force=True) < 0.1


@pytest.mark.parametrize(
    "settings",
    [
        {"slices": 0},
        {"slices": 2.5},
        {"slices": True},
        {"compensation": "tilted"},
        {"spacing": "even"},
        {"precision": "half"},
        {"pitch_mm": 0.0},
        {"half_width_mm": math.nan},
    ],
)
def test_refuses_bad_settings(settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(settings))):
        error(cylinder_scene(0.1), **settings)


@pytest.mark.parametrize("where", ["line", "plane"])
def test_predicts_its_memory(paper_line: Scene, where: str) -> None:
    scene = paper_line if where == "line" else stopped_down(0.05)
    source = small_spot(scene.object_grid, 0.003)
    engine = AnnularSlices(scene, 3, "oblique")
    cost = engine.cost()
    peak = engine_peak_bytes(engine, source)
    assert cost.peak_bytes == pytest.approx(peak, rel=0.3)


@pytest.mark.parametrize("spacing", ["equal", "equal-phase"])
def test_predicts_its_time(paper_line: Scene, spacing: str) -> None:
    """It grows with the slices; benchmarks.chooser holds it against the time that is taken."""
    few, many = (
        AnnularSlices(paper_line, n, "oblique", spacing).cost().seconds  # type: ignore[arg-type]
        for n in (20, 60)
    )
    assert 1.5 * few < many < 4.5 * few


def test_settings(paper_line: Scene) -> None:
    found = AnnularSlices(paper_line, 12, "oblique", "paper").settings()
    assert (found["slices"], found["compensation"], found["spacing"]) == (12, "oblique", "paper")
    assert 0.0 < found["pitch_mm"] < 5.32e-4
    assert found["half_width_mm"] > 10.0
