"""What the paper and the standards define, against literal values.

Everything else is tested against what it follows from. A definition follows from nothing: were it changed,
the program and a test that takes it from the program would change together. So each stands here once more, as
it is printed.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from lensdesign.analysis.space_bandwidth import (
    highest_frequency_lp_per_mm,
    sbp_object,
    sbp_sensor,
    smallest_exit_beam_diameter_mm,
    spread_limit_sine,
)
from lensdesign.lens.coatings.coating import CoatingName
from lensdesign.lens.glass import LINE_C_UM, LINE_D_UM, LINE_F_UM, get_material
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.poses import rotation_matrix
from lensdesign.lens.surface import Surface
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.lens.zernikes import zernike
from lensdesign.manufacture.drawing.tolerances import GENERAL
from tolerancing.perturbations.distributions import (
    EndPoint,
    Normal,
    Parabolic,
    Triangular,
    TruncatedNormal,
    Uniform,
)
from tolerancing.perturbations.grades import FRINGE_UM
from tolerancing.statistics.yields import CONFIDENCE, yield_of
from wavesim.fields.field import Grid, correlation, relative_error
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.metrics.similarity import psnr_db
from wavesim.pupil.pupil import PupilGrid, ReconstructionPupil, mtf, rms_waves, strehl
from wavesim.rays.interfaces import transmission
from wavesim.reconstruction.phase_retrieval import FEEDBACK, TV_STEP
from wavesim.reconstruction.refocusing import svfg
from wavesim.scene.scene import Scene
from wavesim.sensor.camera_noise import Electronics, SaturationWarning, expose
from wavesim.targets.bars import RESOLVED_CONTRAST
from wavesim.targets.usaf import usaf_elements, usaf_line_width_um


class TestMatching:
    """Eqs. 1 and 2, Section 2.A of the paper; the numbers are Table 1's lens."""

    def test_space_bandwidth_products(self) -> None:
        assert sbp_object(3.0, 0.5, 0.532) == pytest.approx(math.pi**2 * 1.5**2 * (0.5 / 0.532e-3) ** 2)
        assert sbp_object(3.0, 0.5, 0.532) == pytest.approx(1.96155e7, rel=1e-5)
        assert sbp_sensor(22.4, 3.2) == pytest.approx(3.02257e7, rel=1e-5)

    def test_spread_angle(self) -> None:
        assert highest_frequency_lp_per_mm(3.2) == pytest.approx(156.25)
        assert math.degrees(math.asin(spread_limit_sine(0.532, 3.2))) == pytest.approx(4.7682, abs=5e-5)

    def test_lagrange_bound(self) -> None:
        assert smallest_exit_beam_diameter_mm(3.0, 0.5, 0.083125) == pytest.approx(18.0451, abs=5e-5)


class TestGlass:
    """Schott's data sheet of N-BK7; the Fraunhofer lines of helium and hydrogen."""

    def test_lines(self) -> None:
        assert (LINE_F_UM, LINE_D_UM, LINE_C_UM) == (0.4861327, 0.5875618, 0.6562725)
        assert TEST_WAVELENGTH_UM == 0.6328

    def test_n_bk7(self) -> None:
        glass = get_material("N-BK7")
        n_f, n_d, n_c = (glass.index(line) for line in (LINE_F_UM, LINE_D_UM, LINE_C_UM))
        assert n_d == pytest.approx(1.51680, abs=5e-6)
        assert (n_d - 1.0) / (n_f - n_c) == pytest.approx(64.17, abs=5e-3)
        assert glass.index(0.532) == pytest.approx(1.5194726, abs=5e-8)


class TestGeometry:
    """Signs of the design file: right-handed about x, then about the turned y axis."""

    def test_rotations(self) -> None:
        quarter, none = np.array(0.5 * math.pi), np.array(0.0)
        axis = np.array([0.0, 0.0, 1.0])
        assert rotation_matrix(quarter, none) @ axis == pytest.approx([0.0, -1.0, 0.0])
        assert rotation_matrix(none, quarter) @ axis == pytest.approx([1.0, 0.0, 0.0])
        assert rotation_matrix(quarter, quarter) @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0])

    def test_zernike_polynomials(self) -> None:
        """OSA/ANSI order and norm: defocus is 4, primary spherical aberration 12, x astigmatism 5."""
        assert zernike(4, 1.0, 0.3) == pytest.approx(math.sqrt(3.0))
        assert zernike(12, 0.0, 0.0) == pytest.approx(math.sqrt(5.0))
        assert zernike(12, math.sqrt(0.5), 0.0) == pytest.approx(-0.5 * math.sqrt(5.0))
        assert zernike(5, 1.0, 0.0) == pytest.approx(math.sqrt(6.0))
        assert zernike(3, 1.0, 0.25 * math.pi) == pytest.approx(math.sqrt(6.0))
        assert zernike(1, 1.0, 0.5 * math.pi) == pytest.approx(2.0)


def plate_scene(coating: CoatingName, dimensions: int) -> Scene:
    """A plate of index 1.5 in air."""
    lens = Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=0.1, numerical_aperture=0.1, working_distance_mm=1.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(9, 9), plane_distances_mm=(1.0,)),
        surfaces=(Surface(material=1.5, thickness_mm=1.0, semi_diameter_mm=1.0, stop=True), Surface()),
    )
    before, behind = (Grid((5,) * dimensions, 1e-3, z) for z in (-1.0, 2.0))
    return Scene(lens, before, behind, 0.5, coating=coating)


class TestSurfaces:
    """Fresnel's coefficients between air and a glass of index 1.5."""

    def test_normal_incidence(self) -> None:
        one = np.ones(1)
        assert transmission(plate_scene("bare", 1), 0, one, one) == pytest.approx([0.8])
        assert transmission(plate_scene("bare", 2), 1, one, one) == pytest.approx([1.2])
        assert transmission(plate_scene("ideal", 2), 0, one, one) == pytest.approx([math.sqrt(1.0 / 1.5)])

    def test_brewsters_angle(self) -> None:
        """There all of TM passes, and of TE the flux 1 - ((n^2 - 1) / (n^2 + 1))^2."""
        n = 1.5
        incidence, refraction = np.array([1.0 / math.hypot(1.0, n)]), np.array([n / math.hypot(1.0, n)])
        flux = n * refraction / incidence
        te = transmission(plate_scene("bare", 1), 0, incidence, refraction) ** 2 * flux
        assert te == pytest.approx([1.0 - (1.25 / 3.25) ** 2])
        mean = transmission(plate_scene("bare", 2), 0, incidence, refraction) ** 2 * flux
        assert mean == pytest.approx(0.5 * (1.0 + te))


class TestFreeSpace:
    """A wave along +z is exp(+i k z): time runs as exp(-i w t)."""

    def test_a_plane_wave_under_an_angle(self) -> None:
        """Over z a plane wave gains exp(2 pi i z sqrt(1 / wavelength^2 - f^2)) (Section 2.B's P)."""
        grid, wavelength, z = Grid((64, 64), 0.5e-3, 0.0), 0.5, 3.3e-3
        frequency = 8.0 / (64 * 0.5e-3)  # a whole number of periods
        wave = np.broadcast_to(np.exp(2j * np.pi * frequency * grid.x_mm), grid.shape)
        found = FreeSpacePropagator(grid, grid.at(z), wavelength, pad=(64, 64), band_limit=False).forward(
            wave
        )
        gained = np.exp(2j * np.pi * z * math.sqrt((1e3 / wavelength) ** 2 - frequency**2))
        assert found == pytest.approx(gained * wave, abs=1e-9)


class TestRetrieval:
    """Appendix A, and Eqs. 5 and 6."""

    def test_constants(self) -> None:
        """Weights a = 0.7 and b = 0.5 of A5, step t = 0.05 of A4."""
        assert FEEDBACK == (0.7, 0.5)
        assert TV_STEP == 0.05

    def test_singular_value_fusion_of_the_gradient(self) -> None:
        """|grad O| is the root of |d/dx|^2 + |d/dy|^2: 5 everywhere for O = 3 x + 4 i y, of which the only
        singular value is 5 M, and the mean over M samples along a side 5."""
        y, x = np.mgrid[:8, :8]
        assert svfg(3.0 * x + 4.0j * y) == pytest.approx(5.0)


class TestChart:
    """MIL-STD-150A: 2^(group + (element - 1) / 6) line pairs a millimetre, bars five times as long as wide,
    two widths between the sets of an element and from element to element."""

    def test_line_widths(self) -> None:
        assert usaf_line_width_um(4, 1) == pytest.approx(31.25)
        assert usaf_line_width_um(9, 3) == pytest.approx(0.7751, abs=5e-5)
        assert usaf_line_width_um(7, 6) == pytest.approx(2.1923, abs=5e-5)

    def test_a_set(self) -> None:
        (element,) = (one for one in usaf_elements((6, 7)) if (one.group, one.element) == (7, 2))
        width = 1e-3 * element.line_width_um
        for orientation in ("x", "y"):
            bars = element.bars(orientation)
            sides = [(bar.right_mm - bar.left_mm, bar.high_mm - bar.low_mm) for bar in bars]
            assert len(bars) == 3
            for side in sides:
                assert sorted(side) == pytest.approx([width, 5.0 * width])
        first, second, third = sorted(bar.left_mm for bar in element.bars("x"))
        assert (second - first, third - second) == pytest.approx((2.0 * width, 2.0 * width))

    def test_gaps(self) -> None:
        elements = {one.element: one for one in usaf_elements((6, 7)) if one.group == 7}
        for one in elements.values():
            sets = [one.bars("x"), one.bars("y")]
            lower, upper = sorted((min(b.left_mm for b in s), max(b.right_mm for b in s)) for s in sets)
            assert upper[0] - lower[1] == pytest.approx(2e-3 * one.line_width_um)
        for above, below in ((1, 2), (2, 3), (5, 6)):
            gap = elements[above].outline.low_mm - elements[below].outline.high_mm
            assert gap == pytest.approx(2e-3 * elements[above].line_width_um)

    def test_what_counts_as_resolved(self) -> None:
        assert RESOLVED_CONTRAST == 0.2


class TestPupil:
    """Strehl ratio, wavefront error and transfer as in Born and Wolf."""

    @staticmethod
    def pupil(steps_waves: tuple[float, float]) -> ReconstructionPupil:
        """A round pupil of NA 0.5 whose left and right half are flat, a step apart."""
        cosines = (np.arange(128) - 63.5) / 128.0
        inside = np.hypot(*np.meshgrid(cosines, cosines)) < 0.5
        grid = PupilGrid((0.0, 0.0), 1.0 / 128.0, inside, 0.5)
        left = grid.cosines[:, 0] < 0.0
        return ReconstructionPupil(grid, 0.5e-3 * np.where(left, *steps_waves), np.ones(len(left), bool))

    def test_two_halves(self) -> None:
        """A quarter of a wave apart: Strehl ratio |(1 + i) / 2|^2, and 1/8 of a wave rms."""
        pupil = self.pupil((0.0, 0.25))
        assert strehl(pupil) == pytest.approx(0.5)
        assert rms_waves(pupil) == pytest.approx(0.125)

    def test_transfer_of_a_clear_circle(self) -> None:
        """Cut off at 2 NA / wavelength; at half of that (2 / pi) (acos 1/2 - (1/2) sin(acos 1/2))."""
        half = 2.0 / math.pi * (math.pi / 3.0 - 0.25 * math.sqrt(3.0))
        found = mtf(self.pupil((0.0, 0.0)), [0.0, 1000.0, 2000.0])
        assert found == pytest.approx([1.0, half, 0.0], abs=5e-3)


class TestFields:
    """Figures that compare fields."""

    def test_correlation_and_error(self) -> None:
        truth = np.array([1.0, 1.0j])
        assert correlation(2.0j * truth, truth) == pytest.approx(1.0)
        assert correlation(np.array([1.0, 0.0]), truth) == pytest.approx(math.sqrt(0.5))
        assert relative_error(1.1 * truth, truth) == pytest.approx(0.1)

    def test_peak_signal_to_noise_ratio(self) -> None:
        truth = np.full((16, 16), 0.5)
        assert psnr_db(truth + 0.1, truth) == pytest.approx(20.0)
        assert psnr_db(truth + 0.1, truth, full_scale=10.0) == pytest.approx(40.0)


class TestCamera:
    """EMVA 1288: electrons are Poisson distributed; a count is full well over 2^bits - 1."""

    def test_counts(self) -> None:
        camera = Electronics(full_well_electrons=10_000.0, read_noise_electrons=0.0, bits=12)
        half = np.full((4, 4), 5_000.0)
        dark = np.zeros((4, 4))
        assert expose(dark, 1.0, camera, None) == pytest.approx(64.0)
        assert expose(half, 1.0, camera, None) == pytest.approx(64.0 + 0.5 * (4095.0 - 64.0), abs=0.51)
        assert expose(2.0 * half, 1.0, camera, None) == pytest.approx(4095.0)
        fine = Electronics(full_well_electrons=60_000.0, bits=12, gain_electrons_per_count=1.0)
        with pytest.warns(SaturationWarning):
            assert np.all(expose(half, 1.0, fine, None) == 4095)

    def test_shot_noise(self) -> None:
        camera = Electronics(
            full_well_electrons=60_000.0, read_noise_electrons=30.0, bits=16, gain_electrons_per_count=1.0
        )
        counts = expose(np.full((400, 400), 10_000.0), 1.0, camera, 1).astype(float)
        assert counts.mean() == pytest.approx(10_064.0, abs=2.0)
        assert counts.var() == pytest.approx(10_000.0 + 30.0**2, rel=0.02)


class TestStatistics:
    """Yield as Wilson (1927); fringes as ISO 10110-5; Table 1 of ISO 10110-11:1996; variances of the
    distributions that tolerances have."""

    def test_yield(self) -> None:
        assert CONFIDENCE == 0.95
        found = yield_of(np.arange(10) < 8)
        assert found is not None
        assert (found.fraction, found.low, found.high) == pytest.approx((0.8, 0.4902, 0.9433), abs=5e-5)

    def test_fringes(self) -> None:
        assert pytest.approx(0.273035) == FRINGE_UM

    def test_general_tolerances(self) -> None:
        """Thickness in mm, A and B of 3/A(B) in fringes, and the angle of 4/ in minutes."""
        table = {
            10.0: (0.1, 5.0, 1.0, 30.0),
            30.0: (0.2, 10.0, 2.0, 20.0),
            100.0: (0.4, 10.0, 2.0, 10.0),
            300.0: (0.8, 10.0, 2.0, 10.0),
        }
        assert list(GENERAL) == list(table)
        for up_to_mm, row in GENERAL.items():
            form = row.left
            found = row.thickness_mm, form.radius_fringes, form.irregularity_fringes, form.centring_arcmin
            assert found == pytest.approx(table[up_to_mm])

    def test_standard_deviations(self) -> None:
        """Of the usual distributions, from their half width or sigma."""
        assert Uniform(half_width=2.0).standard_deviation == pytest.approx(2.0 / math.sqrt(3.0))
        assert Triangular(half_width=2.0).standard_deviation == pytest.approx(2.0 / math.sqrt(6.0))
        assert Parabolic(half_width=2.0).standard_deviation == pytest.approx(2.0 / math.sqrt(5.0))
        assert EndPoint(half_width=2.0).standard_deviation == pytest.approx(2.0)
        assert TruncatedNormal(sigma=1.0, limit=2.0).standard_deviation == pytest.approx(0.87963, abs=1e-5)
        assert Normal(sigma=2.0).quantile(np.array([0.8413447])) == pytest.approx([2.0], abs=1e-5)
