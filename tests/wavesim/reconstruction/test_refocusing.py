"""Digital refocusing by the singular values of the gradient."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.propagator import propagate
from wavesim.reconstruction import refocusing
from wavesim.reconstruction.refocusing import refocus_field, svfg

GRID = Grid((128, 144), 4e-4, -13.5)


def bars() -> Field:
    """Bars of several widths on a dark ground, held to NA 0.5."""
    rng = np.random.default_rng(2)
    y, x = GRID.y_mm[:, None], GRID.x_mm
    values = np.zeros(GRID.shape, complex)
    for _ in range(8):
        width, cy, cx = rng.uniform(0.8e-3, 2e-3), *rng.uniform(-0.012, 0.012, 2)
        for bar in (-1, 0, 1):
            values[(np.abs(x - cx - 2 * bar * width) < 0.5 * width) & (np.abs(y - cy) < 2.5 * width)] = 1.0
    cycles = [np.fft.fftfreq(n, GRID.pitch_mm) for n in GRID.shape]
    held = np.hypot(cycles[0][:, None], cycles[1]) < 0.5 / 0.532e-3
    return Field(GRID, np.fft.ifft2(np.fft.fft2(values) * held), 0.532)


@settings(max_examples=6)
@given(st.floats(-0.03, 0.03))
def test_the_focus_is_found(off_mm: float) -> None:
    blurred = propagate(bars(), off_mm, pad=(512, 512), check=False)
    found = refocus_field(blurred, (-0.04, 0.04))
    assert found.distance_mm == pytest.approx(-off_mm, abs=5e-4)
    assert svfg(found.field.values) >= found.svfg.max() * (1.0 - 1e-9)
    assert found.field.grid.z_mm == pytest.approx(GRID.z_mm, abs=5e-4)


def test_the_middle_of_a_large_field_tells_its_focus(monkeypatch: pytest.MonkeyPatch) -> None:
    blurred = propagate(bars(), 0.012, pad=(512, 512), check=False)
    monkeypatch.setattr(refocusing, "MOST_JUDGED", 100)
    found = refocus_field(blurred, (-0.03, 0.03))
    assert found.distance_mm == pytest.approx(-0.012, abs=1e-3)
    there = propagate(blurred, found.distance_mm, check=False)
    assert relative_error(found.field.values, there.values) < 1e-9
    assert found.field.grid == there.grid


def test_svfg_is_the_nuclear_norm() -> None:
    slope = np.add.outer(np.arange(20.0), np.zeros(20)).astype(complex)
    # Gradient of modulus 1 everywhere: one singular value, 20.
    assert svfg(3j * slope) == pytest.approx(3.0)
    assert svfg(np.ones((5, 7), complex)) == 0.0


def test_progress_is_told() -> None:
    calls: list[tuple[int, int]] = []
    refocus_field(bars(), (-0.01, 0.01), 5e-3, lambda done, total: calls.append((done, total)))
    assert calls == [(i, 5) for i in range(1, 6)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0.1, -0.1),), "interval_mm"),
        (((0.0, np.inf),), "interval_mm"),
        (((-0.1, 0.1), 0.0), "step_mm = 0.0"),
        (((-0.1, 0.1), 1.0), "step_mm = 1.0"),
    ],
)
def test_refused(arguments: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        refocus_field(bars(), *arguments)


def test_a_line_is_refused() -> None:
    line = Grid((8,), 1e-3, 0.0)
    with pytest.raises(InputError, match="plane"):
        refocus_field(Field(line, np.ones(8, complex), 0.5), (-0.1, 0.1))
    with pytest.raises(InputError, match="2 x 2"):
        svfg(np.ones((1, 5), complex))
