"""Motions of which changes are made, and the chain rule from one to the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import Lens
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.derivatives import nominal_paths
from tolerancing.prediction.motions import Motions, motions_of, pair_weights, second_by_pairs
from tolerancing.prediction.paths import SagErrors
from tolerancing.prediction.system import Changes, changes_of

ASKED = [
    ("lens", "tilt_x_deg"),
    ("surface 2", "decenter_y_mm"),
    ("surface 2", "conic"),
    ("surface 1", "index"),
    ("sensor", "tilt_y_deg"),
    ("light", "wavelength_um"),
]


@pytest.fixture(scope="module")
def changes(lens: Lens) -> Changes:
    asked = [PerturbedParameter(target=target, parameter=name) for target, name in ASKED]
    return changes_of(lens, asked, np.full(len(ASKED), 1e-2), 0.0, 0.532)


def test_pairs_are_the_chain_rule(lens: Lens, changes: Changes) -> None:
    paths = nominal_paths(lens, [(0.3, 1.0)], pupil_rings(2, 5), 0.532, 3.0)
    by_motions, moved = Motions(paths).second, motions_of(changes)
    np.testing.assert_allclose(by_motions, np.swapaxes(by_motions, 1, 2), atol=1e-9)
    i, j = np.triu_indices(changes.count)
    dense = np.einsum("nab,ad,be->nde", by_motions, moved, moved)[:, i, j]
    dense += (changes.second @ paths.by_parameters.T).T
    np.testing.assert_allclose(second_by_pairs(paths, pair_weights(changes)), dense, atol=1e-12)


def test_a_figure_acts_as_the_term_whose_sag_it_has(lens: Lens, changes: Changes) -> None:
    """A change of conic, given as sag and slopes at the rays; the sag's own bend by the conic apart."""
    paths = nominal_paths(lens, [(0.3, 1.0)], pupil_rings(2, 5), 0.532, 3.0)
    term = ASKED.index(("surface 2", "conic"))
    predicted = second_by_pairs(paths, pair_weights(changes))
    unit = SagErrors(
        1, slice(term, term + 1), *(part[:, None] for part in paths.term_derivatives(1, "conic"))
    )
    first = changes.first.copy()
    first[:, term] = 0.0
    # Only its place among the changes counts here: sags are given at the rays.
    by_sag_error = replace(changes, first=first, figures=((1, unit.columns, None),))  # type: ignore[arg-type]
    found = second_by_pairs(paths, pair_weights(by_sag_error), [unit])
    i, j = np.triu_indices(changes.count)
    others = (i != term) | (j != term)
    np.testing.assert_allclose(found[:, others], predicted[:, others], atol=1e-9)
