"""Waves on a meridian, against closed forms and against reconstruction pupils."""

import numpy as np
import pytest

from lensdesign import Pose, scaled
from lensdesign.errors import InputError
from wavesim import PupilSampler, SystemState
from wavesim.pupil import Meridian


@pytest.fixture(scope="module")
def twin(paper_lens):
    return scaled(paper_lens, 1 / 48)


@pytest.fixture(scope="module")
def along_x(twin):
    return Meridian(twin, (0.0, 0.0), 0.03)


def lit(plane):
    return np.abs(plane.matrix) > 0.0


def test_the_matrix_keeps_the_energy_of_light_within_the_aperture(along_x):
    x_um = 1e3 * along_x.coordinates_mm
    for sine in (0.0, 0.2, -0.3):
        beam = np.exp(-((x_um / 5.0) ** 2) + 2j * np.pi * sine * x_um / along_x.wavelength)
        for plane in along_x.planes:
            assert np.linalg.norm(plane.matrix @ beam) == pytest.approx(np.linalg.norm(beam), rel=5e-3)


def test_light_beyond_the_aperture_does_not_pass(along_x):
    x_um = 1e3 * along_x.coordinates_mm
    beam = np.exp(-((x_um / 5.0) ** 2) + 2j * np.pi * 0.58 * x_um / along_x.wavelength)
    assert np.linalg.norm(along_x.planes[0].matrix @ beam) < 0.05 * np.linalg.norm(beam)


def test_a_displaced_object_changes_the_path_by_its_cosine(along_x):
    move_mm = 2e-5
    for plane, waves in zip(
        along_x.planes, along_x.waves(SystemState(object_shift_mm=(move_mm, 0.0, 0.0))), strict=True
    ):
        expected = -move_mm * 0.5 * plane.cosines / (1e-3 * along_x.wavelength)
        rest = (waves - expected)[lit(plane)]
        assert np.std(rest) < 1e-3 * np.std(expected[lit(plane)])


def test_nothing_perturbed_changes_nothing(along_x):
    for plane, waves in zip(along_x.planes, along_x.waves(SystemState()), strict=True):
        assert np.max(np.abs(waves[lit(plane)])) < 1e-6


@pytest.mark.parametrize("pose", [Pose(tilt_y_deg=0.4), Pose(decenter_x_mm=1e-3, despace_mm=1e-3)])
def test_the_path_at_the_middle_is_that_of_the_reconstruction_pupil(twin, along_x, pose):
    first = twin.sensor.plane_distances_mm[0]
    pupil = PupilSampler(twin, plane_distance_mm=first, samples=65).pupil(pose)
    middle = (np.abs(pupil.cosines[:, 1]) < 1e-9) & pupil.valid
    x_mm = along_x.coordinates_mm
    plane, waves = along_x.planes[0], along_x.waves(SystemState(pose))[0]
    # Between the two samples about the line's middle.
    near = np.argsort(np.abs(x_mm))[:2] if len(x_mm) % 2 == 0 else [len(x_mm) // 2]
    both = np.all(lit(plane)[:, near], axis=1)
    p, w = (np.mean(part[both][:, near], axis=1) for part in (plane.cosines, waves))
    known = 1e3 * pupil.opd_mm[middle] / along_x.wavelength
    expected = np.interp(0.5 * p, pupil.cosines[middle, 0], known)
    inner = np.abs(p) < 0.95
    assert np.std((w - expected)[inner]) < 0.02 * np.std(expected[inner]) + 1e-3


def test_a_line_that_the_lens_does_not_see_is_refused(twin):
    with pytest.raises(InputError, match="rays of a line"):
        _ = Meridian(twin, (0.0, 5.0), 0.03).planes
