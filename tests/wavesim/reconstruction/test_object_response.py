"""The object's response to a change of the bench."""

from __future__ import annotations

import numpy as np

from wavesim.reconstruction.object_response import possible_change
from wavesim.scene.settings import Kind


def test_a_phase_object_follows_a_change_along_the_unit_circle() -> None:
    values = np.exp(1j * np.array([[0.0, 0.3], [2.0, -1.0]]))
    change = np.array([[1.0 + 2.0j, 1.0], [0.5j, -2.0 + 1.0j]])
    cases: tuple[tuple[Kind, np.ndarray], ...] = (("complex", change), ("amplitude", change.real))
    for kind, expected in cases:
        np.testing.assert_array_equal(possible_change(kind, values, change), expected)
    along = possible_change("phase", values, change)
    np.testing.assert_allclose((values.conj() * along).real, 0.0, atol=1e-12)
    np.testing.assert_allclose((values.conj() * along).imag, (values.conj() * change).imag, atol=1e-12)
