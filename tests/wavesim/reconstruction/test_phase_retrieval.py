"""Dual-plane phase retrieval."""

import itertools

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields import angular_spectrum
from wavesim.fields.field import Field, Grid, correlation
from wavesim.fields.plane_waves import PlaneWaves
from wavesim.fields.propagator import propagate
from wavesim.reconstruction import appendix_a
from wavesim.reconstruction.appendix_a import replace_amplitude
from wavesim.reconstruction.phase_retrieval import (
    FEEDBACK,
    STAGNATION_ITERATIONS,
    RetrievalState,
    Retrieved,
    agreement,
    residual,
    residual_and_map,
    retrieve,
    stagnation,
)
from wavesim.sensor.measurement import Measurement

GRID = Grid((96, 96), 4e-3, 0.0)
WAVELENGTH = 0.532
DISTANCES = (0.4, 3.0)


def truth(seed: int = 3) -> Field:
    """A smooth speckle field in a soft disc, dark at the grid's borders."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape)
    cycles = np.hypot(*np.meshgrid(*[np.fft.fftfreq(n, GRID.pitch_mm) for n in GRID.shape]))
    smooth = np.fft.ifft2(np.fft.fft2(noise) * np.exp(-((cycles / 12.0) ** 2)))
    radius = np.sqrt(GRID.radius_squared_mm2())
    values = (0.3 + smooth / np.abs(smooth).max()) * np.exp(-((radius / 0.09) ** 8))
    return Field(GRID, 40.0 * values, WAVELENGTH)


def recorded(field: Field, distances: tuple[float, ...] = DISTANCES) -> list[Measurement]:
    pad = tuple(2 * n for n in GRID.shape)
    return [Measurement(d, np.abs(propagate(field, d, pad=pad, check=False).values)) for d in distances]


def off(field: Field) -> Field:
    """The field with errors in its phase, as a forward model of another object would have it."""
    y, x = GRID.y_mm[:, None], GRID.x_mm
    return field.with_values(field.values * np.exp(1.2j * np.cos(60.0 * y + 35.0 * x)))


def test_a_good_start_ends_at_the_truth() -> None:
    field = truth()
    planes = recorded(field, (*DISTANCES, 6.0))
    found = retrieve(
        GRID, WAVELENGTH, planes[:2], off(field), iterations=250, tv_step=0.0, held_out=planes[2]
    )
    before = correlation(off(field).values, field.values)
    after = correlation(found.field.values, field.values)
    assert after > 0.99 > 0.8 > before
    assert found.correlation[-1] > 0.999
    assert max(found.residuals) < 0.05
    assert found.held_out_residual is not None
    assert found.held_out_residual < 0.1
    assert len(found.correlation) == 250


def test_the_truth_stays() -> None:
    field = truth()
    wrapped = [
        Measurement(d, np.abs(propagate(field, d, pad=GRID.shape, band_limit=False, check=False).values))
        for d in DISTANCES
    ]
    found = retrieve(GRID, WAVELENGTH, wrapped, field, iterations=20, tv_step=0.0)
    np.testing.assert_allclose(found.field.values, field.values, atol=1e-9 * np.abs(field.values).max())
    assert max(found.residuals) < 1e-9


def test_the_printed_equations_literally() -> None:
    """A1 to A5 written out once more, without the means of the module."""
    field, (a, b), t = truth(), FEEDBACK, 0.05
    planes = recorded(field)
    cycles = [np.fft.fftfreq(n, GRID.pitch_mm) for n in GRID.shape]
    squared = (1e3 / WAVELENGTH) ** 2 - cycles[0][:, None] ** 2 - cycles[1] ** 2
    history = [off(field).values]
    for k in range(1, 6):
        parts = []
        for plane in planes:
            way = np.exp(2j * np.pi * np.sqrt(squared) * plane.distance_mm)
            c = np.fft.ifft2(np.fft.fft2(history[-1]) * way)
            c = plane.amplitude * c / np.abs(c)
            g = np.fft.ifft2(np.fft.fft2(c) / way)
            size = np.abs(g) + 1e-6 * np.sqrt(np.mean(np.abs(g) ** 2))
            div = np.zeros_like(g)
            for axis in (0, 1):
                step = np.roll(g, -1, axis) - g
                edge = (-1, slice(None)) if axis == 0 else (slice(None), -1)
                step[edge] = 0.0
                flow = step / size
                div += flow - np.roll(flow, 1, axis)
            parts.append(g + 0.5 * t * div)
        mean = 0.5 * (parts[0] + parts[1])
        history.append(mean if k <= 2 else (1 + a + b) * mean - a * history[-1] - b * history[-2])
    found = retrieve(GRID, WAVELENGTH, planes, off(field), iterations=5)
    # In the dark A4 divides by next to nothing, and rounding grows.
    np.testing.assert_allclose(found.field.values, history[-1], atol=1e-5 * np.abs(history[-1]).max())


def test_single_precision_stays_single() -> None:
    field = truth()
    planes = [Measurement(p.distance_mm, p.amplitude.astype(np.float32)) for p in recorded(field)]
    found = retrieve(GRID, WAVELENGTH, planes, off(field), iterations=10, tv_step=0.0)
    double = retrieve(GRID, WAVELENGTH, recorded(field), off(field), iterations=10, tv_step=0.0)
    assert found.field.values.dtype == np.complex64
    assert correlation(found.field.values, double.field.values) > 1.0 - 1e-6


def test_starts_are_reproducible_and_told_apart() -> None:
    planes = recorded(truth())

    def run(start: str, seed: int = 0) -> Retrieved:
        return retrieve(GRID, WAVELENGTH, planes, start, iterations=3, seed=seed)  # type: ignore[arg-type]

    assert np.array_equal(run("random", 1).field.values, run("random", 1).field.values)
    fields = [run("random", 1).field, run("random", 2).field, run("uniform").field]
    assert agreement(fields) < 0.9
    assert agreement([fields[0], fields[0].with_values(2j * fields[0].values)]) == pytest.approx(1.0)


def test_residual_is_relative_to_the_field() -> None:
    field = truth()
    assert residual(field, Measurement(0.0, np.abs(field.values))) < 1e-12
    assert residual(field, Measurement(0.0, 2.0 * np.abs(field.values))) == pytest.approx(0.5)


def test_stagnation_is_seen() -> None:
    falling = 1.0 - 0.5 * 0.99 ** np.arange(200)
    assert stagnation(falling) is None
    stuck = np.concatenate([falling[:100], np.full(100, falling[99])])
    assert stagnation(stuck) == pytest.approx(99, abs=STAGNATION_ITERATIONS)
    assert stagnation(falling[:10]) is None


def test_progress_is_told() -> None:
    calls: list[int] = []
    retrieve(GRID, WAVELENGTH, recorded(truth()), iterations=4, progress=lambda k, _: calls.append(k))
    assert calls == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recorded": []}, r"0 plane\(s\) recorded"),
        ({"recorded": [Measurement(1.0, np.ones((3, 3)))] * 2}, "shape"),
        ({"recorded": [Measurement(1.0, np.ones(GRID.shape))] * 2}, "same distance_mm"),
        ({"recorded": [Measurement(d, np.full(GRID.shape, np.nan)) for d in DISTANCES]}, "finite"),
        ({"recorded": [Measurement(d, -np.ones(GRID.shape)) for d in DISTANCES]}, "not negative"),
        (
            {"recorded": [Measurement(d, np.ones(GRID.shape), shift_mm=(0.0, d)) for d in DISTANCES]},
            "Appendix A supports neither shifts nor backgrounds",
        ),
        ({"recorded": [Measurement(d, np.zeros(GRID.shape)) for d in DISTANCES]}, "amplitudes are 0"),
        ({"recorded": [Measurement(d, np.ones(GRID.shape)) for d in (1.0, np.inf)]}, "distance_mm = inf"),
        ({"iterations": 0}, "iterations = 0"),
        ({"tv_step": -1.0}, "tv_step = -1.0"),
        ({"feedback": (np.nan, 0.0)}, "feedback"),
        (
            {"recorded": [Measurement(p.distance_mm, 0.01 * p.amplitude) for p in recorded(truth())]},
            "destroy plane 1",
        ),
        (
            {"recorded": [Measurement(p.distance_mm, 1e30 * p.amplitude) for p in recorded(truth())]},
            r"plane 1: amplitudes reach .*e\+3\d",
        ),
        ({"start": "guess"}, "start = 'guess'"),
        ({"start": Field(GRID.at(1.0), np.ones(GRID.shape, complex), 0.532)}, "start: its grid"),
    ],
)
def test_refused(change: dict, message: str) -> None:
    arguments = {"recorded": recorded(truth()), "iterations": 1} | change
    with pytest.raises(InputError, match=message):
        retrieve(GRID, WAVELENGTH, **arguments)


def test_pixels_that_are_not_known_are_left_as_they_are() -> None:
    """Saturated pixels spoil the field, unless their sigma says that they are not known."""
    field = truth()
    dead = np.random.default_rng(5).random(GRID.shape) < 0.05
    spoiled, masked = [], []
    for plane in recorded(field):
        wrong = np.where(dead, 4.0 * plane.amplitude.max(), plane.amplitude)
        spoiled.append(Measurement(plane.distance_mm, wrong))
        masked.append(Measurement(plane.distance_mm, wrong, np.where(dead, np.inf, 1.0)))
    found = [
        retrieve(GRID, WAVELENGTH, planes, off(field), iterations=150, tv_step=0.0)
        for planes in (spoiled, masked)
    ]
    reached = [correlation(one.field.values, field.values) for one in found]
    assert reached[0] < 0.8
    assert reached[1] > 0.98
    assert found[1].residuals[0] == pytest.approx(found[1].residual_curve[-1], rel=0.2)
    assert found[1].correlation[-1] > 0.99
    assert len(found[1].residual_curve) == 150


def plainly(
    grid: Grid, planes: list[Measurement], start: np.ndarray, iterations: int, step: float
) -> tuple[np.ndarray, list[float], list[float]]:
    """Appendix A by whole arrays: what is done in blocks elsewhere."""
    now, before, (a, b) = start, start, FEEDBACK
    met, left = [], []
    for k in range(iterations):
        mean = np.zeros_like(now)
        for plane in planes:
            known = np.ones(grid.shape, bool) if plane.known is None else plane.known
            way = PlaneWaves.of(grid, WAVELENGTH).transfer_function(plane.distance_mm)
            there = np.fft.ifftn(np.fft.fftn(now) * way)
            seen, wanted = np.abs(there)[known], plane.amplitude[known]
            if plane is planes[0]:
                met.append(np.corrcoef(seen, wanted)[0, 1])
                left.append(np.linalg.norm(seen - wanted) / np.linalg.norm(wanted))
            there[known] = wanted * np.exp(1j * np.angle(there[known]))
            field = np.fft.ifftn(np.fft.fftn(there) * way.conj())
            size = np.abs(field) + 1e-6 * np.sqrt(np.mean(np.abs(field) ** 2))
            mean += field / len(planes)
            for axis in range(field.ndim):
                flow = np.diff(field, axis=axis)
                flow *= 0.5 * step / np.take(size, range(field.shape[axis] - 1), axis)
                ends = [[(0, 1) if n == axis else (0, 0) for n in range(field.ndim)] for _ in (0, 1)]
                ends[1][axis] = (1, 0)
                mean += (np.pad(flow, ends[0]) - np.pad(flow, ends[1])) / len(planes)
        after = mean if k < 2 else (1 + a + b) * mean - a * now - b * before
        before, now = now, after
    return now, met, left


@pytest.mark.parametrize("shape", [(40, 54), (37, 29), (64,), (33,)])
@pytest.mark.parametrize("distances", [(0.4, 3.0), (0.0, 2.0), (2.0, 0.0, 5.0)])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("step", [0.0, 0.3])
def test_blocks_do_what_whole_arrays_do(
    monkeypatch: pytest.MonkeyPatch,
    shape: tuple[int, ...],
    distances: tuple[float, ...],
    masked: bool,
    step: float,
) -> None:
    """Whatever the numbers of samples, planes and blocks; pixels that are not known; the plane sought."""
    for module in (appendix_a, angular_spectrum):
        monkeypatch.setattr(module, "rows_in", lambda bytes_of_row: 1)
    monkeypatch.setattr(angular_spectrum, "COLUMNS", 5)
    rng, grid = np.random.default_rng(9), Grid(shape, 4e-3, 0.0)
    start = 64.0 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    planes = [
        Measurement(
            d,
            60.0 + 9.0 * rng.random(shape),
            np.where(rng.random(shape) < 0.1, np.inf, 1.0) if masked else None,
        )
        for d in distances
    ]
    wanted, met, left = plainly(grid, planes, start, 6, step)
    found = retrieve(grid, WAVELENGTH, planes, Field(grid, start, WAVELENGTH), iterations=6, tv_step=step)
    np.testing.assert_allclose(found.field.values, wanted, atol=1e-8 * np.abs(wanted).max())
    np.testing.assert_allclose(found.correlation, met, atol=1e-9)
    np.testing.assert_allclose(found.residual_curve, left, rtol=1e-9)


def test_waves_that_decay_are_left_out_in_the_plane_sought_too() -> None:
    """On a grid finer than half the wavelength a plane at distance 0 is no other than one nearby."""
    grid = Grid((40, 40), 2e-4, 0.0)
    rng = np.random.default_rng(2)
    start = 64.0 * (rng.standard_normal(grid.shape) + 1j * rng.standard_normal(grid.shape))
    planes = [Measurement(d, 60.0 + 9.0 * rng.random(grid.shape)) for d in (0.0, 0.01)]
    found = retrieve(grid, WAVELENGTH, planes, Field(grid, start, WAVELENGTH), iterations=4)
    wanted = plainly(grid, planes, start, 4, 0.05)[0]
    np.testing.assert_allclose(found.field.values, wanted, atol=1e-8 * np.abs(wanted).max())


def test_single_precision_errs_by_rounding_alone() -> None:
    field = truth()
    planes = recorded(field, (0.0, 3.0))
    single = [Measurement(p.distance_mm, p.amplitude.astype(np.float32)) for p in planes]
    wanted, met, left = plainly(GRID, planes, off(field).values, 10, 0.0)
    found = retrieve(GRID, WAVELENGTH, single, off(field), iterations=10, tv_step=0.0)
    assert found.field.values.dtype == np.complex64
    assert np.linalg.norm(found.field.values - wanted) < 2e-5 * np.linalg.norm(wanted)
    np.testing.assert_allclose(found.correlation, met, atol=1e-6)
    np.testing.assert_allclose(found.residual_curve, left, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_an_amplitude_is_replaced_and_the_phase_stays(dtype: type) -> None:
    rng = np.random.default_rng(4)
    field = (rng.standard_normal((5, 7)) + 1j * rng.standard_normal((5, 7))).astype(dtype)
    field[2, 3] = field[1, 1] = 0.0
    field[0, 0] = 1e-25j
    amplitude = rng.random((5, 7)).astype(field.real.dtype)
    known = rng.random((5, 7)) < 0.7
    known[2, 3], known[1, 1], known[0, 0] = True, False, True
    phase = np.where(field == 0.0, 1.0, np.exp(1j * np.angle(field)))
    expected = np.where(known, amplitude * phase, field)
    replace_amplitude(field, amplitude, known)
    np.testing.assert_allclose(field, expected, rtol=1e-6)
    replace_amplitude(field, amplitude)
    np.testing.assert_allclose(np.abs(field), amplitude, rtol=1e-6)


def test_a_run_that_was_cut_off_ends_as_an_unbroken_one() -> None:
    """Exactly, wherever it was cut off, A5's first iterations among it."""
    planes, states = recorded(truth()), []

    def keep(state: RetrievalState) -> None:
        states.append(RetrievalState(state.now.copy(), state.before.copy(), *list(vars(state).values())[2:]))

    whole = retrieve(GRID, WAVELENGTH, planes, off(truth()), iterations=6, keep=keep)
    for done, state in enumerate(states, start=1):
        assert len(state.correlation) == done
        calls: list[int] = []
        rest = retrieve(
            GRID, WAVELENGTH, planes, iterations=6, resume=state, progress=lambda k, _, t=calls: t.append(k)
        )
        assert calls == list(range(done, 6))
        np.testing.assert_array_equal(rest.field.values, whole.field.values)
        assert (rest.correlation, rest.residual_curve) == (whole.correlation, whole.residual_curve)
        assert rest.residuals == whole.residuals
    wrong = RetrievalState(np.zeros((3, 3), complex), np.zeros((3, 3), complex), (), ())
    with pytest.raises(InputError, match="resume: its shape"):
        retrieve(GRID, WAVELENGTH, planes, resume=wrong)


def test_arguments_stay_as_they_were() -> None:
    planes, start = recorded(truth(), (0.0, 3.0)), off(truth())
    copies = [p.amplitude.copy() for p in planes] + [start.values.copy()]
    retrieve(GRID, WAVELENGTH, planes, start, iterations=4)
    for now, then in itertools.zip_longest([*(p.amplitude for p in planes), start.values], copies):
        np.testing.assert_array_equal(now, then)


def test_what_is_left_on_a_plane() -> None:
    field, (plane, *_) = truth(), recorded(truth())
    there = propagate(field, plane.distance_mm, pad=GRID.shape, band_limit=False, check=False)
    brighter = Measurement(plane.distance_mm, 1.1 * np.abs(there.values))
    figure, left = residual_and_map(field, brighter)
    assert figure == pytest.approx(0.1 / 1.1) == residual(field, brighter)
    np.testing.assert_allclose(left, np.abs(there.values) - brighter.amplitude, atol=1e-9 * 40.0)
