"""Derivatives of pupils: what registration takes out, and pupils that were traced."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens
from lensdesign.errors import DesignError
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.perturbations.batch import batch_of
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.derivatives import ARMS, RINGS, differentials, nominal_paths, weights_over_stop
from tolerancing.prediction.system import amounts_of
from wavesim import PupilSampler, refocus, rms_waves

FIELD = (0.4, 1.1)


def asked(*names: tuple[str, str]) -> list[PerturbedParameter]:
    return [PerturbedParameter(target=target, parameter=name) for target, name in names]


def test_a_moved_object_leaves_nothing_once_registered(lens: Lens) -> None:
    """Shifts are taken out exactly, refocusing to first order."""
    moved = asked(("object", "decenter_x_mm"), ("object", "decenter_y_mm"), ("object", "working_distance_mm"))
    (field,) = differentials(lens, moved, np.full(3, 0.01), [FIELD]).fields
    assert np.max(np.abs(field.first)) > 100.0
    np.testing.assert_allclose(field.registered, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("target", "name", "size"),
    [
        ("lens", "tilt_y_deg", 0.1),
        ("surface 2", "conic", 1e-3),
        ("element 1", "roll_x_deg", 0.1),
        ("surface 1", "irregularity_rms_waves", 0.2),
    ],
)
def test_traced_pupils_agree(lens: Lens, target: str, name: str, size: float) -> None:
    perturbed = [
        p.model_copy(update={"seat": "back"}) if "roll" in name else p for p in asked((target, name))
    ]
    batch = batch_of(perturbed, np.array([[size]]), 0.0, seed=3)
    (state,) = batch.states(lens, 0.532)
    pupil = refocus(PupilSampler(lens, FIELD, samples=96).pupil(state)).pupil
    known = differentials(lens, perturbed, np.array([size]), [FIELD])
    amounts, (field,) = amounts_of(batch)[0], known.fields
    (waves,) = field.waves(amounts[None])
    # The traced pupil's square samples at the rim are what differs.
    assert np.sqrt(field.weights @ waves**2) == pytest.approx(rms_waves(pupil), rel=6e-3)


def test_weights_are_areas_of_direction_cosines(lens: Lens) -> None:
    """By them the mean of a linear function over the pupil is that over an even grid of cosines."""
    stop = pupil_rings(RINGS, ARMS)
    paths = nominal_paths(lens, [FIELD], stop, 0.532, 3.0)
    weights = weights_over_stop(paths.cosines, stop)
    grid = PupilSampler(lens, FIELD, samples=256).grid
    assert np.sum(weights) == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ paths.cosines[:, :2], grid.cosines.mean(axis=0), atol=2e-4)
    np.testing.assert_allclose(
        weights @ paths.cosines[:, :2] ** 2, np.mean(grid.cosines**2, axis=0), rtol=4e-3
    )


def test_second_derivatives_are_left_out_where_nobody_asks(lens: Lens) -> None:
    known = differentials(lens, asked(("lens", "tilt_x_deg")), np.ones(1), [FIELD], second=False)
    assert known.fields[0].second.shape == (RINGS * ARMS, 0)


def test_a_field_point_that_is_vignetted_is_refused(lens: Lens) -> None:
    with pytest.raises(DesignError, match=r"object point \(0, 9\) mm"):
        differentials(lens, asked(("lens", "tilt_x_deg")), np.ones(1), [(0.0, 9.0)])
