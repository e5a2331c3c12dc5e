"""Figures of surfaces: the spline against what it stands for, and rays against surfaces that need none."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_lenses import lenses, poses, random_rays
from reference_trace import trace_numpy
from scipy.interpolate import make_interp_spline

from lensdesign import Lens, ObjectSpace, Sensor, Surface, SurfacePerturbation, trace
from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.errors import InputError
from lensdesign.lens import SurfaceFigure, surface_figure_from_grid, surface_figure_from_zernike
from lensdesign.lens.zernikes import HIGHEST_INDEX, zernike
from lensdesign.raytrace.bundles import launch
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace_compiled
from lensdesign.raytrace.status import Status

SEEDS = st.integers(0, 2**32 - 1)
SEMI_MM = 4.0


def disc(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Polar coordinates of points all over the unit disc, some on its rim."""
    rng = np.random.default_rng(seed)
    rho = np.sqrt(rng.random(count))
    rho[: count // 10] = 1.0
    return rho, 2.0 * np.pi * rng.random(count)


def on_grid(sag: Any, nodes: int = 81, half_mm: float = 1.2 * SEMI_MM) -> SurfaceFigure:
    """Figure of a function of x and y."""
    at = np.linspace(-half_mm, half_mm, nodes)
    return surface_figure_from_grid(sag(at, at[:, None]), at[1] - at[0], SEMI_MM)


# The spline.


@pytest.mark.parametrize("index", [0, 1, 2, 4, 7, 12, 20, 24, 27, 40, 44, 60, 84, HIGHEST_INDEX])
def test_spline_of_a_zernike_polynomial_is_within_a_millionth(index: int) -> None:
    rho, theta = disc(index, 5000)
    figure = surface_figure_from_zernike({index: 1.0}, SEMI_MM)
    found = figure.sag(SEMI_MM * rho * np.cos(theta), SEMI_MM * rho * np.sin(theta))
    assert np.max(np.abs(1e3 * found - zernike(index, rho, theta))) < 1e-6


@given(seed=SEEDS)
def test_figure_is_linear_in_its_coefficients(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given_um = dict(zip(rng.choice(30, 4, replace=False).tolist(), rng.normal(size=4).tolist(), strict=True))
    rho, theta = disc(seed, 200)
    figure = surface_figure_from_zernike(given_um, SEMI_MM)
    found = figure.sag(SEMI_MM * rho * np.cos(theta), SEMI_MM * rho * np.sin(theta))
    right = sum(1e-3 * value * zernike(index, rho, theta) for index, value in given_um.items())
    assert found == pytest.approx(right, abs=5e-9)


@given(seed=SEEDS, rows=st.integers(8, 14), columns=st.integers(8, 14))
def test_spline_through_a_grid_is_scipys(seed: int, rows: int, columns: int) -> None:
    rng = np.random.default_rng(seed)
    values, spacing = rng.normal(size=(rows, columns)), rng.uniform(0.1, 2.0)
    figure = surface_figure_from_grid(values, spacing, 0.5 * spacing * (min(rows, columns) - 1))
    y, x = (spacing * (np.arange(n) - 0.5 * (n - 1)) for n in (rows, columns))
    assert figure.sag(x, y[:, None]) == pytest.approx(values, abs=1e-12)
    fine_y, fine_x = np.linspace(y[0], y[-1], 37), np.linspace(x[0], x[-1], 31)
    right = make_interp_spline(x, make_interp_spline(y, values)(fine_y), axis=1)(fine_x)
    assert figure.sag(fine_x, fine_y[:, None]) == pytest.approx(right, abs=1e-11)


@given(seed=SEEDS)
def test_slopes_are_derivatives_of_the_sag(seed: int) -> None:
    rng = np.random.default_rng(seed)
    figure = surface_figure_from_grid(rng.normal(size=(11, 9)), 0.5, 1.5)
    x, y = rng.uniform(-1.99, 1.99, 300), rng.uniform(-2.49, 2.49, 300)
    sag, by_x, by_y = figure.sag_and_slopes(x, y)
    assert np.array_equal(sag, figure.sag(x, y))
    assert by_x == pytest.approx((figure.sag(x + 1e-6, y) - figure.sag(x - 1e-6, y)) / 2e-6, abs=1e-7)
    assert by_y == pytest.approx((figure.sag(x, y + 1e-6) - figure.sag(x, y - 1e-6)) / 2e-6, abs=1e-7)
    assert by_x == pytest.approx(figure.sag(x + 1e-30j, y).imag / 1e-30, abs=1e-13)


def test_sag_goes_on_beyond_the_grid_as_at_its_edge() -> None:
    figure = on_grid(lambda x, y: 1e-3 * x * y + 0.0 * x)
    sag, by_x, by_y = figure.sag_and_slopes(np.array([100.0, 1.0]), np.array([2.0, -1e300]))
    assert sag == pytest.approx([9.6e-3, -4.8e-3])
    assert by_x == pytest.approx([0.0, -4.8e-3])
    assert by_y == pytest.approx([4.8e-3, 0.0])


def test_figures_of_many_trials() -> None:
    coefficients = {4: np.array([0.1, 0.2, -0.3]), 7: np.array([0.0, 1.0, 2.0]), 2: 0.5}
    many = surface_figure_from_zernike(coefficients, SEMI_MM)
    assert many.trials == 3
    x, y = np.array([1.0, -2.0]), np.array([0.5, 3.0])
    for i in range(3):
        one = surface_figure_from_zernike(
            {j: np.broadcast_to(c, 3)[i] for j, c in coefficients.items()}, SEMI_MM
        )
        assert many.sag(x, y)[i] == pytest.approx(one.sag(x, y), abs=1e-16)
        assert many.trial(i).sag(x, y) == pytest.approx(one.sag(x, y), abs=1e-16)


# Holes, and what is no figure.


def test_holes_outside_the_disc_take_the_nearest_value() -> None:
    at = np.linspace(-6.0, 6.0, 61)
    values = 1e-3 * np.exp(-0.05 * (at**2 + at[:, None] ** 2))
    holed = np.where(np.hypot(at, at[:, None]) <= 5.0, values, np.nan)
    figure, whole = (
        surface_figure_from_grid(holed, 0.2, SEMI_MM),
        surface_figure_from_grid(values, 0.2, SEMI_MM),
    )
    rho, theta = disc(1, 500)
    x, y = SEMI_MM * rho * np.cos(theta), SEMI_MM * rho * np.sin(theta)
    assert figure.sag(x, y) == pytest.approx(whole.sag(x, y), abs=5e-8)
    assert np.all(np.isfinite(figure.coefficients))
    assert figure.sag(6.0, 0.0) == pytest.approx(1e-3 * math.exp(-0.05 * 25.0), rel=1e-6)


def test_holes_inside_the_disc_are_counted() -> None:
    values = np.zeros((41, 41))
    values[20, 18:21] = np.nan
    values[0, 0] = np.nan
    with pytest.raises(InputError, match=r"figure: 3 of \d+ points.*4 mm"):
        surface_figure_from_grid(values, 0.25, SEMI_MM)


@pytest.mark.parametrize(
    ("values", "spacing", "semi", "message"),
    [
        (np.zeros((21, 41)), 0.25, 4.0, r"2\.5 mm from the vertex.* 4 mm"),
        (np.zeros((7, 41)), 0.25, 0.5, "both at least 8"),
        (np.zeros(41), 0.25, 4.0, r"shape \(41,\)"),
        (np.zeros((41, 41)), 0.0, 4.0, r"spacing_mm = 0.0"),
        (np.zeros((41, 41)), 0.25, math.nan, "semi_diameter_mm = nan"),
    ],
)
def test_what_is_no_grid_is_refused(values: Any, spacing: float, semi: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        surface_figure_from_grid(values, spacing, semi)


@pytest.mark.parametrize(
    ("coefficients", "semi", "message"),
    [
        ({400: 0.1}, 4.0, "Zernike index 400"),
        ({4: math.inf}, 4.0, "coefficient 4 is not finite"),
        ({4: np.zeros(2), 5: np.zeros(3)}, 4.0, "shapes"),
        ({4: 0.1}, -4.0, "semi_diameter_mm = -4"),
    ],
)
def test_what_are_no_coefficients_is_refused(coefficients: Any, semi: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        surface_figure_from_zernike(coefficients, semi)


# Rays.


def singlet(**front: Any) -> Lens:
    """A lens of two surfaces, the first as given."""
    return Lens(
        wavelengths_um=(0.532,),
        object=ObjectSpace(field_diameter_mm=2.0, numerical_aperture=0.1, working_distance_mm=20.0),
        sensor=Sensor(pixel_pitch_um=3.2, pixels=(1000, 1000), plane_distances_mm=(3.0,)),
        surfaces=(
            Surface(**{"thickness_mm": 5.0, "material": 1.5, "semi_diameter_mm": SEMI_MM} | front),
            Surface(radius_mm=-30.0, semi_diameter_mm=6.0),
        ),
    )


def same_rays(lens: Lens, figure: SurfaceFigure, other: Lens, other_change: SurfacePerturbation) -> float:
    """Largest difference in place, direction or path between two ways to say the same first surface."""
    origins, directions = launch(lens, [(0.0, 0.0), (0.7, -0.4)], np.array(disc(5, 200)).T * 0.15, 0.532)
    one = trace(
        lens,
        origins,
        directions,
        0.532,
        plane_z_mm=9.0,
        surface_perturbations={0: SurfacePerturbation(figure=figure)},
    )
    two = trace(other, origins, directions, 0.532, plane_z_mm=9.0, surface_perturbations={0: other_change})
    assert one.ok.all()
    assert two.ok.all()
    parts = [getattr(one, n) - getattr(two, n) for n in ("position", "direction", "opl")]
    return max(float(np.max(np.abs(part))) for part in parts)


def test_a_figure_of_pure_tilt_is_a_wedge() -> None:
    angle = math.radians(0.2)
    figure = on_grid(lambda x, y: math.tan(angle) * y + 0.0 * x)
    plane = singlet(radius_mm=None)
    assert same_rays(plane, figure, plane, SurfacePerturbation(tilt_x_deg=0.2)) < 1e-12
    assert same_rays(plane, figure, plane, SurfacePerturbation()) > 1e-3


def test_a_figure_of_pure_power_is_another_radius() -> None:
    """Exact on a paraboloid, whose sag is r^2 / (2 R)."""
    figure = on_grid(lambda x, y: (x * x + y * y) * (0.5 / 39.0 - 0.5 / 40.0))
    lens, other = (singlet(radius_mm=r, conic=-1.0) for r in (40.0, 39.0))
    assert same_rays(lens, figure, other, SurfacePerturbation()) < 1e-12


def test_zernike_spherical_aberration_is_an_asphere() -> None:
    um = 2.0
    lens = singlet(radius_mm=40.0, conic=-1.0)
    scale = 1e-3 * um * math.sqrt(5.0)
    curvature = 1.0 / 40.0 - 2.0 * 6.0 * scale / SEMI_MM**2
    other = singlet(radius_mm=1.0 / curvature, conic=-1.0, asphere=(6.0 * scale / SEMI_MM**4,))
    figure = surface_figure_from_zernike({12: um}, SEMI_MM)
    assert same_rays(lens, figure, other, SurfacePerturbation(despace_mm=scale)) < 2e-7
    assert same_rays(lens, figure, lens, SurfacePerturbation()) > 1e-3


def one_trial(system: Any, t: int) -> Any:
    """A single lens out of many."""

    def own(array: np.ndarray) -> np.ndarray:
        return array[t : t + 1] if len(array) > 1 else array

    names = ("rotation", "vertex", "index")
    figures = tuple(tuple(f.trial(t) for f in some) for some in system.figures)
    shapes = tuple(shape.trial(t) for shape in system.shapes)
    return replace(
        system, trials=None, figures=figures, shapes=shapes, **{n: own(getattr(system, n)) for n in names}
    )


@settings(max_examples=60)
@given(data=st.data(), trials=st.sampled_from([None, 3]), seed=SEEDS, clip=st.booleans())
def test_kernel_equals_numpy(data: st.DataObject, trials: int | None, seed: int, clip: bool) -> None:
    lens = data.draw(lenses())
    rng = np.random.default_rng(seed)
    changes = {
        i: SurfacePerturbation(
            figure=surface_figure_from_zernike(
                {j: rng.normal(0.0, 0.3, trials if i % 2 else None) for j in rng.choice(15, 3)},
                surface.semi_diameter_mm or 3.0,
            )
        )
        for i, surface in enumerate(lens.surfaces)
    }
    system = compile_system(lens, 0.55, data.draw(poses(trials)), changes)
    origins, directions = random_rays(seed, 100)
    rays = trace_compiled(system, origins, directions, 60.0, clip=clip, record_hits=True)
    for t in range(trials or 1):
        own: Any = (lambda a, t=t: a[t]) if trials else (lambda a: a)
        _, direction, opl, status, failed, hits = trace_numpy(
            one_trial(system, t), origins, directions, 60.0, clip
        )
        # Where Newton's method wanders, rounding decides in which of two ways a ray does not get through.
        wandering = own(rays.status) != status
        assert np.isin(
            [own(rays.status)[wandering], status[wandering]], [Status.MISSED, Status.NOT_CONVERGED]
        ).all()
        assert np.sum(wandering) <= 1
        assert np.array_equal(own(rays.failed_surface), failed)
        scale = 1.0 + np.maximum(np.abs(opl), np.abs(hits).max(axis=(1, 2)))
        off = np.abs(own(rays.hits) - hits).max(axis=(1, 2)) / scale
        off = np.maximum(off, np.abs(own(rays.opl) - opl) / scale)
        off = np.maximum(off, np.abs(own(rays.direction) - direction).max(axis=1))[~wandering]
        # A ray that grazes a surface magnifies rounding.
        assert np.quantile(off, 0.97) < 1e-12
        assert np.max(off) < 1e-10


def test_threads_give_each_trial_its_own_figure() -> None:
    lens = singlet(radius_mm=40.0)
    figures = surface_figure_from_zernike({5: np.linspace(-1.0, 1.0, 7)}, SEMI_MM)
    origins, directions = launch(lens, [(0.0, 0.0)], [(0.3, 0.1), (-0.2, 0.9)], 0.532)
    change = {0: SurfacePerturbation(figure=figures)}
    one, three = (
        trace(lens, origins, directions, 0.532, surface_perturbations=change, threads=n) for n in (1, 3)
    )
    assert np.array_equal(one.direction, three.direction)
    for i in range(7):
        alone = {0: SurfacePerturbation(figure=figures.trial(i))}
        single = trace(lens, origins, directions, 0.532, surface_perturbations=alone)
        assert np.array_equal(one.direction[i], single.direction)


def test_rays_go_through_their_points_of_a_figured_stop() -> None:
    lens = singlet(radius_mm=40.0, conic=0.5)
    figure = surface_figure_from_zernike({9: 3.0, 4: -2.0}, SEMI_MM)
    change = {0: SurfacePerturbation(figure=figure)}
    pupil = np.array([(0.3, 0.1), (-0.2, 0.9), (0.0, 0.0), (0.0, 1.0)])
    origins, directions = launch(lens, [(0.0, 0.5)], pupil, 0.532, surface_perturbations=change)
    rays = trace(lens, origins, directions, 0.532, surface_perturbations=change, record_hits=True)
    assert rays.hits is not None
    x, y = SEMI_MM * pupil.T
    height = lens.surfaces[0].sag_mm(np.hypot(x, y)) + figure.sag(x, y)
    assert rays.hits[:, 0] == pytest.approx(np.column_stack([x, y, height]), abs=1e-12)


def test_measured_and_added_figures_add() -> None:
    measured = {"semi_diameter_mm": 5.0, "zernike_um": {5: 0.4}}
    lens = singlet(radius_mm=40.0, figure=measured)
    system = compile_system(
        lens,
        0.532,
        surface_perturbations={0: SurfacePerturbation(figure=surface_figure_from_zernike({8: 0.3}, 6.0))},
    )
    x, y = np.array([1.0, 2.0]), np.array([-3.0, 0.5])
    right = surface_figure_from_zernike({5: 0.4}, 5.0).sag(x, y) + surface_figure_from_zernike(
        {8: 0.3}, 6.0
    ).sag(x, y)
    assert system.sag(0, x, y) - lens.surfaces[0].sag_mm(np.hypot(x, y)) == pytest.approx(right, abs=1e-14)
    assert np.array_equal(system.sag_and_slopes(0, x, y)[0], system.sag(0, x, y))


def test_a_figure_of_lesser_size_than_the_surface_is_refused() -> None:
    change = {0: SurfacePerturbation(figure=surface_figure_from_zernike({5: 0.1}, 3.0))}
    with pytest.raises(InputError, match=r"surface 1: .*figure.* 3 mm"):
        compile_system(singlet(radius_mm=40.0), 0.532, surface_perturbations=change)


def test_as_many_figures_as_trials() -> None:
    figure = surface_figure_from_zernike({5: np.zeros(3)}, SEMI_MM)
    with pytest.raises(InputError, match="one length"):
        SurfacePerturbation(figure=figure, conic=np.zeros(2))


def test_fields_of_every_azimuth_count_where_a_figure_breaks_symmetry() -> None:
    """Astigmatism along x makes the spread largest for fields along x, far from where it is sought else."""
    lens = singlet(radius_mm=40.0)
    change = {0: SurfacePerturbation(figure=surface_figure_from_zernike({5: -20.0}, SEMI_MM))}
    found = largest_spread_angle(lens, field_heights_mm=[1.0], surface_perturbations=change)
    turned = {0: SurfacePerturbation(figure=surface_figure_from_zernike({5: 20.0}, SEMI_MM))}
    other = largest_spread_angle(lens, field_heights_mm=[1.0], surface_perturbations=turned)
    assert found.spread_deg == pytest.approx(other.spread_deg, abs=1e-5)
    assert abs(abs(found.field_mm[0]) - abs(other.field_mm[0])) == pytest.approx(1.0, abs=1e-2)
