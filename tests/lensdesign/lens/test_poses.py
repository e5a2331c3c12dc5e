"""Poses: right-handed, about a pivot that moves with the decenter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_lenses import numbers, poses

from lensdesign import Pose, SurfacePerturbation
from lensdesign.errors import InputError
from lensdesign.lens.poses import trial_count


def moved(pose: Pose, point: tuple[float, float, float]) -> np.ndarray:
    """A point of the part, in the fixed frame."""
    rotation, shift = pose.transform()
    return rotation[0] @ np.array(point) + shift[0]


def test_tilt_about_x_is_right_handed() -> None:
    assert moved(Pose(tilt_x_deg=90.0), (0.0, 1.0, 0.0)) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert moved(Pose(tilt_x_deg=90.0), (0.0, 0.0, 1.0)) == pytest.approx([0.0, -1.0, 0.0], abs=1e-15)


def test_tilt_about_y_is_right_handed() -> None:
    assert moved(Pose(tilt_y_deg=90.0), (0.0, 0.0, 1.0)) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)


def test_second_tilt_is_about_the_axis_that_turned_with_the_first() -> None:
    both = moved(Pose(tilt_x_deg=90.0, tilt_y_deg=90.0), (0.0, 0.0, 1.0))
    assert both == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
    about_turned_y = moved(Pose(tilt_x_deg=90.0, tilt_y_deg=30.0), (0.0, 1.0, 0.0))
    assert about_turned_y == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)


@given(pose=poses(None))
def test_pivot_moves_with_the_decenter_and_nothing_else(pose: Pose) -> None:
    point = moved(pose, (0.0, 0.0, float(pose.pivot_z_mm)))
    expected = [pose.decenter_x_mm, pose.decenter_y_mm, pose.despace_mm + pose.pivot_z_mm]
    assert point == pytest.approx(expected, abs=1e-14)


@given(pose=poses(7))
def test_trials_hold_one_proper_rotation_each(pose: Pose) -> None:
    rotation, shift = pose.transform()
    assert rotation.shape == (7, 3, 3)
    assert shift.shape == (7, 3)
    assert np.allclose(rotation @ np.swapaxes(rotation, 1, 2), np.eye(3), atol=1e-15)
    assert np.allclose(np.linalg.det(rotation), 1.0, atol=1e-14)


@given(angle=numbers(-180.0, 180.0))
def test_a_tilt_undoes_its_opposite(angle: float) -> None:
    forth, back = Pose(tilt_x_deg=angle).transform()[0], Pose(tilt_x_deg=-angle).transform()[0]
    assert np.allclose(forth[0] @ back[0], np.eye(3), atol=1e-15)


def test_trials_are_counted() -> None:
    assert trial_count(Pose(), SurfacePerturbation(radius_mm=0.1)) is None
    assert trial_count(Pose(decenter_x_mm=np.zeros(4)), SurfacePerturbation()) == 4
    with pytest.raises(InputError, match="one length"):
        trial_count(Pose(decenter_x_mm=np.zeros(4)), SurfacePerturbation(conic=np.zeros(3)))


@pytest.mark.parametrize("kind", [Pose, SurfacePerturbation])
@pytest.mark.parametrize("value", [np.nan, np.inf, np.zeros((2, 2)), "1", None, np.array([0.0, np.nan])])
def test_values_that_are_no_numbers_are_refused(kind: type, value: object) -> None:
    with pytest.raises(InputError, match=rf"(?s){kind.__name__}.tilt_x_deg = .*: must be a finite number"):
        kind(tilt_x_deg=value)


def test_arrays_of_different_lengths_are_refused_at_once() -> None:
    with pytest.raises(InputError, match="one length"):
        Pose(decenter_x_mm=np.zeros(2), tilt_x_deg=np.zeros(3))


@given(values=st.lists(numbers(-1.0, 1.0), min_size=5, max_size=5))
def test_the_rigid_part_of_a_surface_perturbation(values: list[float]) -> None:
    assert SurfacePerturbation(*values, radius_mm=1.0, thickness_mm=2.0).pose() == Pose(*values)
