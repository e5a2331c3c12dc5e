"""Dual-plane phase retrieval."""

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields import Field, Grid, correlation
from wavesim.free_space import propagate
from wavesim.retrieval import (
    FEEDBACK,
    WATCHED,
    Recorded,
    Retrieved,
    agreement,
    amplitude_correlation,
    recorded_intensity,
    residual,
    retrieve,
    stagnation,
    weights_of,
)

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


def recorded(field: Field, distances: tuple[float, ...] = DISTANCES) -> list[Recorded]:
    pad = tuple(2 * n for n in GRID.shape)
    return [Recorded(d, np.abs(propagate(field, d, pad=pad, check=False).values)) for d in distances]


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
        Recorded(d, np.abs(propagate(field, d, pad=GRID.shape, band_limit=False, check=False).values))
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
    planes = [Recorded(p.distance_mm, p.amplitude.astype(np.float32)) for p in recorded(field)]
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


def test_correlation_and_residual() -> None:
    x = np.arange(12.0).reshape(3, 4)
    assert amplitude_correlation(x, 3.0 * x + 1.0) == pytest.approx(1.0)
    assert amplitude_correlation(x, -x) == pytest.approx(-1.0)
    assert amplitude_correlation(x, np.ones_like(x)) == 0.0
    field = truth()
    assert residual(field, Recorded(0.0, np.abs(field.values))) < 1e-12
    assert residual(field, Recorded(0.0, 2.0 * np.abs(field.values))) == pytest.approx(0.5)


def test_stagnation_is_seen() -> None:
    falling = 1.0 - 0.5 * 0.99 ** np.arange(200)
    assert stagnation(falling) is None
    stuck = np.concatenate([falling[:100], np.full(100, falling[99])])
    assert stagnation(stuck) == pytest.approx(99, abs=WATCHED)
    assert stagnation(falling[:10]) is None


def test_progress_is_told() -> None:
    told: list[int] = []
    retrieve(GRID, WAVELENGTH, recorded(truth()), iterations=4, progress=lambda k, _: told.append(k))
    assert told == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recorded": []}, "two at least"),
        ({"recorded": [Recorded(1.0, np.ones((3, 3)))] * 2}, "shape"),
        ({"recorded": [Recorded(1.0, np.ones(GRID.shape))] * 2}, "same distance_mm"),
        ({"recorded": [Recorded(d, np.full(GRID.shape, np.nan)) for d in DISTANCES]}, "finite"),
        ({"recorded": [Recorded(d, -np.ones(GRID.shape)) for d in DISTANCES]}, "not negative"),
        ({"recorded": [Recorded(d, np.zeros(GRID.shape)) for d in DISTANCES]}, "all dark"),
        ({"recorded": [Recorded(d, np.ones(GRID.shape)) for d in (1.0, np.inf)]}, "distance_mm = inf"),
        ({"iterations": 0}, "iterations = 0"),
        ({"tv_step": -1.0}, "tv_step = -1.0"),
        ({"feedback": (np.nan, 0.0)}, "feedback"),
        (
            {"recorded": [Recorded(p.distance_mm, 0.01 * p.amplitude) for p in recorded(truth())]},
            "destroy plane 1",
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
        spoiled.append(Recorded(plane.distance_mm, wrong))
        masked.append(Recorded(plane.distance_mm, wrong, np.where(dead, np.inf, 1.0)))
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


def test_amplitudes_of_an_estimated_intensity() -> None:
    """Bright pixels: half the intensity's deviation over the amplitude. Dark ones: what noise leaves."""
    rng = np.random.default_rng(6)
    for intensity, deviation in ((400.0, 3.0), (0.0, 2.0)):
        drawn = intensity + deviation * rng.standard_normal(200_000)
        made = recorded_intensity(0.5, drawn, np.full(drawn.shape, deviation**2))
        error = np.sqrt(np.mean((made.amplitude - np.sqrt(intensity)) ** 2))
        at_truth = recorded_intensity(0.5, np.array([intensity]), np.array([deviation**2]))
        assert at_truth.sigma is not None
        assert at_truth.sigma[0] == pytest.approx(error, rel=0.03)
    saturated = recorded_intensity(0.5, np.array([4.0, 9.0]), np.array([1.0, np.inf]))
    assert saturated.sigma is not None
    assert saturated.known is not None
    np.testing.assert_array_equal(saturated.known, [True, False])
    np.testing.assert_allclose(saturated.amplitude, [2.0, 3.0])
    assert saturated.sigma[0] == pytest.approx(0.25)


def test_weights_are_relative_to_the_best_pixel_of_all_planes() -> None:
    planes = [
        Recorded(0.0, np.ones(2), np.array([0.5, 1.0])),
        Recorded(1.0, np.ones(2), np.array([2.0, np.inf])),
        Recorded(2.0, np.ones(2)),
    ]
    first, second, third = weights_of(planes)
    assert first is not None
    assert second is not None
    assert third is None
    np.testing.assert_allclose(first, [1.0, 0.25])
    np.testing.assert_allclose(second, [0.0625, 0.0])


def test_an_intensity_without_a_usable_variance_is_refused() -> None:
    for variance in (np.zeros(3), np.ones(4), np.full(3, np.nan)):
        with pytest.raises(InputError, match="variance"):
            recorded_intensity(0.0, np.ones(3), variance)
