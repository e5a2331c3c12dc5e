"""Illumination: directions, the paraxial beam against propagation, measured fields, field stops."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Grid, relative_error
from wavesim.fields.propagator import propagate
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.targets.illumination import (
    StopShape,
    field_stop,
    gaussian_beam,
    measured_field,
    plane_wave,
    point_source,
    speckle,
)

GRID = Grid((120, 140), 1e-3, -1.0, (0.2, -0.1))
WAVELENGTH_UM = 0.532


def test_collimated_light_is_one_everywhere() -> None:
    for grid in (GRID, Grid((50,), 1e-3, -1.0)):
        np.testing.assert_array_equal(plane_wave(grid, WAVELENGTH_UM).values, 1.0)


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(1.0, 1.4))
@settings(max_examples=40, deadline=None)
def test_a_tilted_wave_has_its_direction(tilt_x: float, tilt_y: float, index: float) -> None:
    values = plane_wave(GRID, WAVELENGTH_UM, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y, index=index).values
    np.testing.assert_allclose(abs(values), 1.0, atol=1e-12)
    k = 2e3 * math.pi * index / WAVELENGTH_UM
    step_x, step_y = np.angle(values[0, 1] / values[0, 0]), np.angle(values[1, 0] / values[0, 0])
    p, q = step_x / GRID.pitch_mm / k, step_y / GRID.pitch_mm / k
    cosine = math.sqrt(1.0 - p**2 - q**2)
    assert math.degrees(math.atan2(p, cosine)) == pytest.approx(tilt_x, abs=1e-9)
    assert math.degrees(math.atan2(q, cosine)) == pytest.approx(tilt_y, abs=1e-9)


def test_a_tilt_beyond_the_grid_is_refused() -> None:
    limit = math.degrees(math.asin(0.5 * WAVELENGTH_UM))
    plane_wave(GRID, WAVELENGTH_UM, tilt_x_deg=0.99 * limit)
    with pytest.raises(SamplingError, match=r"tilt_x_deg = .* pitch"):
        plane_wave(GRID, WAVELENGTH_UM, tilt_x_deg=1.01 * limit)
    for bad in (90.0, math.nan):
        with pytest.raises(InputError, match="tilt_y_deg"):
            plane_wave(GRID, WAVELENGTH_UM, tilt_y_deg=bad)
    with pytest.raises(InputError, match="no x"):
        plane_wave(Grid((50,), 1e-3, -1.0), WAVELENGTH_UM, tilt_x_deg=1.0)


@pytest.mark.parametrize("distance", [0.0, 0.3, -0.3])
def test_a_gaussian_beam_keeps_its_energy_and_width(distance: float) -> None:
    waist = 0.02
    beam = gaussian_beam(GRID, WAVELENGTH_UM, waist, distance)
    assert beam.energy == pytest.approx(0.5 * math.pi * waist**2, rel=1e-6)
    rayleigh = 1e3 * math.pi * waist**2 / WAVELENGTH_UM
    power = abs(beam.values) ** 2
    second = (power.sum(axis=0) @ (GRID.x_mm - GRID.centre_mm[0]) ** 2) / power.sum()
    assert 2.0 * math.sqrt(second) == pytest.approx(waist * math.hypot(1.0, distance / rayleigh), rel=1e-4)


@pytest.mark.parametrize("shape", [(256, 256), (256,)])
def test_a_gaussian_beam_agrees_with_propagation_from_its_waist(shape: tuple[int, ...]) -> None:
    grid, distance = Grid(shape, 1e-3, 0.0), 1.0
    carried = propagate(gaussian_beam(grid, WAVELENGTH_UM, 0.02), distance)
    piston = np.exp(1j * carried.wavenumber_per_mm * distance)
    closed = gaussian_beam(grid, WAVELENGTH_UM, 0.02, distance).values * piston
    assert relative_error(carried.values, closed) < 1e-4


def test_a_beam_too_narrow_is_refused() -> None:
    with pytest.raises(InputError, match=r"waist_radius_mm = 0.001: must be"):
        gaussian_beam(GRID, WAVELENGTH_UM, 1e-3)
    with pytest.raises(SamplingError, match="a Gaussian waist"):
        gaussian_beam(Grid((50, 50), 5e-3, -1.0), WAVELENGTH_UM, 8e-3)


@pytest.mark.parametrize("shape", [(256, 256), (256,)])
@pytest.mark.parametrize("distance", [20.0, -20.0])
def test_a_point_source_has_the_wavefront_of_a_gaussian_beam_far_from_its_waist(
    shape: tuple[int, ...], distance: float
) -> None:
    grid, waist = Grid(shape, 1e-3, 0.0), 0.01
    beam = gaussian_beam(grid, WAVELENGTH_UM, waist, distance)
    rayleigh = 1e3 * math.pi * waist**2 / WAVELENGTH_UM
    curvature_radius = distance * (1.0 + (rayleigh / distance) ** 2)
    light = point_source(grid, WAVELENGTH_UM, curvature_radius)
    middle = tuple(count // 2 for count in shape)
    np.testing.assert_allclose(light.values[middle], 1.0, atol=1e-3)
    between = np.angle(beam.values / light.values * np.conj(beam.values[middle] / light.values[middle]))
    assert np.abs(between).max() < 1e-3
    assert np.angle(light.values / light.values[middle]).std() > 0.1


def test_a_point_source_is_a_spherical_wave_of_its_index() -> None:
    light = point_source(GRID, WAVELENGTH_UM, 0.5, index=1.33)
    y, x = GRID.y_mm[3] - GRID.centre_mm[1], GRID.x_mm[7] - GRID.centre_mm[0]
    length = math.sqrt(x**2 + y**2 + 0.5**2)
    closed = 0.5 / length * np.exp(2e3j * math.pi * 1.33 / WAVELENGTH_UM * (length - 0.5))
    assert light.values[3, 7] == pytest.approx(closed, abs=1e-9)
    converging = point_source(GRID, WAVELENGTH_UM, -0.5, index=1.33)
    np.testing.assert_allclose(converging.values, light.values.conj(), atol=1e-12)


def test_a_point_source_too_near_is_refused() -> None:
    grid = Grid((200, 200), 1e-3, 0.0)
    limit = 0.1 / math.tan(math.asin(0.5 * WAVELENGTH_UM))
    point_source(grid, WAVELENGTH_UM, 1.01 * limit)
    with pytest.raises(SamplingError, match=r"distance_mm = .* pitch"):
        point_source(grid, WAVELENGTH_UM, 0.99 * limit)
    for bad in (0.0, math.inf, math.nan):
        with pytest.raises(InputError, match="distance_mm"):
            point_source(grid, WAVELENGTH_UM, bad)


def test_speckle_fills_its_cone_evenly_and_has_the_statistics_of_a_diffuser() -> None:
    grid = Grid((512, 512), 5e-4, 0.0)
    light = speckle(grid, WAVELENGTH_UM, 0.3, seed=2)
    intensity = np.abs(light.values) ** 2
    assert intensity.mean() == pytest.approx(1.0, abs=0.02)  # of some 20,000 grains
    assert np.mean(intensity > 1.0) == pytest.approx(math.exp(-1.0), abs=0.01)
    window = np.outer(*(np.hanning(512),) * 2)
    power = np.abs(np.fft.fft2(light.values * window)) ** 2
    cycles = np.fft.fftfreq(512, 5e-4)
    sine = 1e-3 * WAVELENGTH_UM * np.hypot(cycles[:, None], cycles)
    assert power[sine > 0.31].sum() < 1e-5 * power.sum()
    inner, outer = (power[(sine > low) & (sine < high)].mean() for low, high in ((0.0, 0.15), (0.15, 0.28)))
    assert inner == pytest.approx(outer, rel=0.1)
    np.testing.assert_array_equal(light.values, speckle(grid, WAVELENGTH_UM, 0.3, seed=2).values)
    assert relative_error(speckle(grid, WAVELENGTH_UM, 0.3, seed=3).values, light.values) > 1.0


def test_speckle_is_the_same_light_on_all_grids() -> None:
    values = speckle(Grid((200, 200), 4e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    wider = speckle(Grid((202, 206), 4e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    np.testing.assert_allclose(wider[1:-1, 3:-3], values, atol=1e-12)
    beside = speckle(Grid((60, 80), 4e-4, 0.0, (0.02, -0.016)), WAVELENGTH_UM, 0.4, seed=2).values
    np.testing.assert_allclose(beside, values[30:90, 110:190], atol=1e-12)
    odd = Grid((101, 101), 4e-4, 0.0)
    finer = speckle(Grid((201, 201), 2e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    np.testing.assert_allclose(finer[::2, ::2], speckle(odd, WAVELENGTH_UM, 0.4, seed=2).values, atol=1e-12)
    # The pattern has the size of the grains: twice the wavelength and twice the pitch give equal samples.
    scaled = speckle(Grid((101, 101), 8e-4, 0.0), 2.0 * WAVELENGTH_UM, 0.4, seed=2).values
    np.testing.assert_allclose(scaled, speckle(odd, WAVELENGTH_UM, 0.4, seed=2).values, atol=1e-9)


def test_speckle_on_a_line_is_the_same_light_at_all_pitches() -> None:
    coarse = speckle(Grid((101,), 4e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    finer = speckle(Grid((401,), 1e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    np.testing.assert_allclose(finer[::4], coarse, atol=1e-12)
    many = speckle(Grid((40_000,), 4e-4, 0.0), WAVELENGTH_UM, 0.4, seed=2).values
    assert np.mean(np.abs(many) ** 2) == pytest.approx(1.0, abs=0.03)


def test_speckle_has_no_error_of_interpolation() -> None:
    """Samples of a fine grid have no waves beyond the cone, as images of the nodes' spectrum would be."""
    light = speckle(Grid((600, 600), 5e-5, 0.0), WAVELENGTH_UM, 0.4).values
    window = np.blackman(600)
    power = np.abs(np.fft.fft2(light * np.outer(window, window))) ** 2
    cycles = np.fft.fftfreq(600, 5e-5)
    beyond = 1e-3 * WAVELENGTH_UM * np.hypot(cycles[:, None], cycles) > 1.0
    assert power[beyond].sum() < 1e-9 * power.sum()


def test_speckle_that_the_grid_cannot_hold_is_refused() -> None:
    grid = Grid((100, 100), 1e-3, 0.0)
    with pytest.raises(SamplingError, match=r"numerical_aperture = 0\.3: .* pitch below"):
        speckle(grid, WAVELENGTH_UM, 0.3)
    with pytest.raises(InputError, match="grains are larger than the grid"):
        speckle(grid, WAVELENGTH_UM, 1e-3)
    for bad in (0.0, 1.0, math.nan):
        with pytest.raises(InputError, match="numerical_aperture"):
            speckle(grid, WAVELENGTH_UM, bad)


def smooth(grid: Grid) -> np.ndarray:
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    return np.exp(-(x**2 + 2.0 * y**2) / 0.05**2 + 40j * x + 300j * x * y)


def test_a_measured_field_is_carried_to_another_pitch(tmp_path: Path) -> None:
    fine = Grid((160, 180), 1.0e-3, -1.0)
    np.save(tmp_path / "field.npy", smooth(fine))
    target = Grid((100, 90), 1.3e-3, -1.0)
    field = measured_field(tmp_path / "field.npy", target, WAVELENGTH_UM, 1.0)
    assert relative_error(field.values, smooth(target)) < 1e-4
    np.savez(tmp_path / "field.npz", values=smooth(fine), pitch_um=1.0, wavelength_um=WAVELENGTH_UM)
    again = measured_field(tmp_path / "field.npz", target, WAVELENGTH_UM)
    np.testing.assert_array_equal(again.values, field.values)
    same = measured_field(tmp_path / "field.npz", fine, WAVELENGTH_UM)
    np.testing.assert_array_equal(same.values, smooth(fine))


def test_a_measured_field_too_fine_for_splines_or_the_grid_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rough = rng.normal(size=(64, 64)) + 1j * rng.normal(size=(64, 64))
    np.save(tmp_path / "rough.npy", rough)
    with pytest.raises(SamplingError, match=r"lies above .* pitch of"):
        measured_field(tmp_path / "rough.npy", Grid((40, 40), 0.9e-3, -1.0), WAVELENGTH_UM, 1.0)
    kept = measured_field(tmp_path / "rough.npy", Grid((64, 64), 1e-3, -1.0), WAVELENGTH_UM, 1.0)
    np.testing.assert_array_equal(kept.values, rough)
    slanted = plane_wave(Grid((128, 128), 1e-3, -1.0), WAVELENGTH_UM, tilt_x_deg=3.0)
    np.save(tmp_path / "slanted.npy", slanted.values)
    with pytest.raises(SamplingError, match="pitch of 6 µm"):
        measured_field(tmp_path / "slanted.npy", Grid((15, 15), 6e-3, -1.0), WAVELENGTH_UM, 1.0)
    mixed = np.ones((128, 128), complex) + 0.02 * rng.normal(size=(128, 128))
    np.save(tmp_path / "mixed.npy", mixed)
    with pytest.warns(SamplingWarning, match="lies above .* pitch of"):
        measured_field(tmp_path / "mixed.npy", Grid((60, 60), 0.9e-3, -1.0), WAVELENGTH_UM, 1.0)


def test_files_that_hold_no_field_are_refused(tmp_path: Path) -> None:
    grid, values = Grid((8, 8), 1e-3, -1.0), np.ones((8, 8), complex)

    def assert_refused(name: str, message: str, pitch_um: float | None = 1.0) -> None:
        with pytest.raises(InputError, match=message):
            measured_field(tmp_path / name, grid, WAVELENGTH_UM, pitch_um)

    assert_refused("none.npy", "No such file")
    (tmp_path / "text.npy").write_text("no array")
    assert_refused("text.npy", "cannot read the measured field")
    np.save(tmp_path / "cut.npy", values)
    (tmp_path / "cut.npy").write_bytes((tmp_path / "cut.npy").read_bytes()[:400])
    assert_refused("cut.npy", "cannot read the measured field")
    np.save(tmp_path / "object.npy", np.array([{}]), allow_pickle=True)
    assert_refused("object.npy", "cannot read the measured field")
    np.save(tmp_path / "real.npy", values.real)
    assert_refused("real.npy", "give a complex array")
    np.save(tmp_path / "nan.npy", values * math.nan)
    assert_refused("nan.npy", "not finite")
    np.savez(tmp_path / "other.npz", field=values)
    assert_refused("other.npz", "no array `values`")
    np.savez_compressed(tmp_path / "damaged.npz", values=values)
    damaged = bytearray((tmp_path / "damaged.npz").read_bytes())
    for place in range(60, 100):
        damaged[place] ^= 0xFF
    (tmp_path / "damaged.npz").write_bytes(damaged)
    assert_refused("damaged.npz", "cannot read the measured field")
    np.savez(tmp_path / "stated.npz", values=values, pitch_um=2.0)
    assert_refused("stated.npz", "states pitch_um = 2, not the given 1")
    np.savez(tmp_path / "colour.npz", values=values, pitch_um=1.0, wavelength_um=0.6)
    assert_refused("colour.npz", "states wavelength_um")
    np.save(tmp_path / "good.npy", values)
    assert_refused("good.npy", "does not state its pitch; give pitch_um", None)
    assert_refused("good.npy", "larger measurement", 0.5)
    np.save(tmp_path / "dark.npy", 0.0 * values)
    assert_refused("dark.npy", "dark", 2.0)


@pytest.mark.parametrize(("shape", "area"), [("disc", 0.25 * math.pi), ("square", 1.0)])
def test_a_field_stop_has_its_area_with_hard_and_soft_edges(shape: StopShape, area: float) -> None:
    width, edge = 0.0833, 0.02
    hard = field_stop(GRID, shape, width)
    assert hard.sum() * GRID.cell == pytest.approx(area * width**2, rel=1e-9)
    soft = field_stop(GRID, shape, width, edge)
    # A symmetric edge leaves the square's area; a disc's gains pi times the variance of the edge's place.
    variance = edge**2 * (0.25 - 2.0 / math.pi**2)
    extra = math.pi * variance if shape == "disc" else 0.0
    assert soft.sum() * GRID.cell == pytest.approx(area * width**2 + extra, rel=1e-4)
    for stop in (hard, soft):
        np.testing.assert_allclose(stop, stop[::-1, ::-1], atol=1e-12)
        assert 0.0 <= stop.min() < stop.max() <= 1.0 + 1e-12
    middle = hard.shape[0] // 2
    assert np.count_nonzero((hard[middle] > 1e-9) & (hard[middle] < 1.0 - 1e-9)) <= 4
    assert np.count_nonzero((soft[middle] > 1e-9) & (soft[middle] < 1.0 - 1e-9)) >= 36


def test_field_stops_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="wider than the grid's"):
        field_stop(GRID, "disc", 0.13)
    with pytest.raises(InputError, match="edge_mm"):
        field_stop(GRID, "disc", 0.05, -0.1)
    with pytest.raises(SamplingError, match="a soft edge"):
        field_stop(GRID, "square", 0.05, 1e-3)
    with pytest.raises(InputError, match="allowed: disc, square"):
        field_stop(GRID, "oval", 0.05)  # type: ignore[arg-type]
