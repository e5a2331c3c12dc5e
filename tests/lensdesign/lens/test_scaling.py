"""Scaled twins."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import Coating, CoatingLayer, load_design, trace
from lensdesign.analysis.coatings import coating_report
from lensdesign.analysis.exit_beam import largest_spread_angle
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled, stopped_down
from lensdesign.raytrace.bundles import launch, pupil_hexapolar

PAPER = load_design("designs/paper_singlet.toml")
ASPHERIC = PAPER.replaced(surfaces=(PAPER.surfaces[0].replaced(asphere=(1e-6, -2e-9)), PAPER.surfaces[1]))


@given(st.floats(0.05, 20.0))
def test_rays_of_a_twin_are_those_of_the_lens_but_for_size(factor: float) -> None:
    twin = scaled(ASPHERIC, factor)
    pupil = pupil_hexapolar(3).points
    results = []
    for lens, size in ((ASPHERIC, 1.0), (twin, factor)):
        origins, directions = launch(lens, [[0.0, 1.2 * size]], pupil, 0.532)
        rays = trace(lens, origins, directions, 0.532, plane_z_mm=size * 20.0)
        results.append((rays.position / size, rays.direction, rays.opl / size))
    for a, b in zip(*results, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_spread_stays() -> None:
    angles = [largest_spread_angle(lens, 0.532).spread_deg for lens in (PAPER, scaled(PAPER, 0.125))]
    assert angles[1] == pytest.approx(angles[0], abs=1e-7)


def test_coatings_stay() -> None:
    """Their films have thicknesses of the wavelength, which stays."""
    layers = (CoatingLayer(index=1.38, thickness_nm=96.4), CoatingLayer(material="Ta2O5", quarter_waves=2.0))
    films = Coating(layers=layers, design_wavelength_um=0.5)
    lens = PAPER.with_coating("mgf2").with_surface(1, coating=films)
    twin = scaled(lens, 0.1)
    assert [s.coating for s in twin.surfaces] == [s.coating for s in lens.surfaces]
    small, large = (coating_report(one).centre for one in (twin, lens))
    assert small.transmittance == pytest.approx(large.transmittance, abs=1e-12)
    assert small.largest_retardance_deg == pytest.approx(large.largest_retardance_deg, abs=1e-9)


def test_there_and_back() -> None:
    back = scaled(scaled(ASPHERIC, 0.125), 8.0)
    assert back.sensor.pixels == ASPHERIC.sensor.pixels
    assert back.surfaces[0].asphere == pytest.approx(ASPHERIC.surfaces[0].asphere, rel=1e-12)
    assert isinstance(back, Lens)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf"), 1e12])
def test_refused(factor: float) -> None:
    with pytest.raises(DesignError):
        scaled(PAPER, factor)


def test_stopped_down() -> None:
    lens = stopped_down(PAPER, 0.25)
    tangents = [np.tan(np.arcsin(na)) for na in (0.25, 0.5)]
    assert lens.stop_semi_diameter_mm / PAPER.stop_semi_diameter_mm == pytest.approx(
        tangents[0] / tangents[1]
    )
    for wrong in (0.0, 0.6, np.nan):
        with pytest.raises(DesignError):
            stopped_down(PAPER, wrong)
