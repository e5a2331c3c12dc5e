"""A source as directions and wavelengths: their weights and what they average."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j1

from lensdesign.errors import InputError
from wavesim.scene.source import POINT, Source, SourceMode


def test_a_point_is_one_direction() -> None:
    assert POINT.modes(0.5) == [SourceMode(1.0, (0.0, 0.0), 0.5)]


@pytest.mark.parametrize("distance", [0.5, 1.5, 3.0])
def test_a_disc_has_the_coherence_of_its_closed_form(distance: float) -> None:
    """Van Cittert and Zernike: 2 J1(x) / x between two points; x is the phase across half the source."""
    modes = Source(width_deg=2.0).modes(0.5)
    assert sum(mode.weight for mode in modes) == pytest.approx(1.0)
    found = sum(mode.weight * np.exp(1j * distance * mode.tilt_deg[0]) for mode in modes)
    assert found == pytest.approx(2.0 * j1(distance) / distance, abs=2e-3)


@pytest.mark.parametrize("distance", [0.5, 1.5, 3.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_seven_directions_have_nearly_the_coherence_of_a_disc(distance: float, axis: int) -> None:
    modes = Source(width_deg=2.0).few_modes(0.5)
    assert len(modes) == 7
    assert sum(mode.weight for mode in modes) == pytest.approx(1.0)
    found = sum(mode.weight * np.exp(1j * distance * mode.tilt_deg[axis]) for mode in modes)
    assert found == pytest.approx(2.0 * j1(distance) / distance, abs=0.015)
    assert POINT.few_modes(0.5) == POINT.modes(0.5)


BAND = Source(bandwidth_nm=20.0)


@pytest.mark.parametrize(
    ("modes", "delay_waves"),
    [
        (BAND.modes(0.5), 10.0),
        (BAND.modes(0.5), 30.0),
        (BAND.few_modes(0.5), 10.0),
        (BAND.few_modes(0.5, samples=80), 40.0),
        (BAND.few_modes(0.5, samples=300), 150.0),
    ],
)
def test_a_band_has_the_coherence_of_its_closed_form(modes: list[SourceMode], delay_waves: float) -> None:
    """Steepest light is delayed by half a wave for each sample of the object."""
    found = sum(m.weight * np.exp(2j * np.pi * delay_waves * (m.wavelength_um / 0.5 - 1.0)) for m in modes)
    assert found == pytest.approx(np.sinc(0.04 * delay_waves), abs=0.01)


def test_a_wide_polychromatic_source_has_all_pairs_of_direction_and_wavelength() -> None:
    modes = Source(width_deg=2.0, bandwidth_nm=20.0).few_modes(0.5)
    assert len(modes) == len(set(modes)) == 7 * 3
    assert sum(mode.weight for mode in modes) == pytest.approx(1.0)
    assert 0.5 in {mode.wavelength_um for mode in modes}


def test_sources_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="width_deg"):
        Source(width_deg=math.nan)
    with pytest.raises(InputError, match="below 0"):
        Source(bandwidth_nm=1200.0).modes(0.5)
    with pytest.raises(InputError, match="below 0"):
        Source(bandwidth_nm=1200.0).few_modes(0.5)


@pytest.mark.parametrize("source", [Source(2.0), Source(bandwidth_nm=20.0), Source(2.0, 20.0)])
def test_changes_of_few_modes_are_those_of_their_means(source: Source) -> None:
    """For an intensity whose mean over disc and band is known: 1 + |s|^2 (1 + x^2) + x^4, x in 10 nm."""

    def mean_of(width_deg: float, bandwidth_nm: float) -> float:
        radius_squared, half = (0.5 * width_deg) ** 2, 0.05 * bandwidth_nm
        return 1.0 + 0.5 * radius_squared * (1.0 + half**2 / 3.0) + half**4 / 5.0

    def intensity(mode: SourceMode) -> float:
        x = 100.0 * (mode.wavelength_um - 0.5)
        return 1.0 + (mode.tilt_deg[0] ** 2 + mode.tilt_deg[1] ** 2) * (1.0 + x**2) + x**4

    modes = source.few_modes(0.5, samples=80)
    changes = source.few_mode_changes(0.5, samples=80)
    step = 1e-5
    for factors, name in zip(changes, ("width_deg", "bandwidth_nm"), strict=True):
        widths = {"width_deg": source.width_deg, "bandwidth_nm": source.bandwidth_nm}
        found = sum(factor * intensity(mode) for factor, mode in zip(factors, modes, strict=True))
        if widths[name] == 0.0:
            assert found == 0.0
            continue
        after = widths | {name: math.sqrt(widths[name] ** 2 + step)}
        assert found == pytest.approx((mean_of(**after) - mean_of(**widths)) / step, rel=1e-3)
