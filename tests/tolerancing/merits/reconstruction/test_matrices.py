"""Engines as matrices."""

import numpy as np
import pytest

from lensdesign import scaled
from tolerancing.merits.reconstruction.matrices import Matrices, MatrixOperator
from wavesim import engine_for, patch_scene
from wavesim.fields.field import Field, relative_error


@pytest.fixture(scope="module")
def engine(paper_lens):
    scene = patch_scene(scaled(paper_lens, 1 / 48), 0.01, meridional=True)
    return engine_for(scene, "slices", slices=3, compensation="oblique")


def test_a_matrix_is_its_engine(engine):
    matrix, rng = MatrixOperator.of(engine), np.random.default_rng(1)
    for way, grid in (("forward", engine.scene.object_grid), ("adjoint", engine.scene.exit_grid)):
        field = Field(grid, rng.standard_normal(grid.size) + 0j, 0.532)
        exact = getattr(engine, way)(field)
        assert relative_error(getattr(matrix, way)(field).values, exact.values) < 1e-5


def test_a_matrix_is_made_once_and_tells_what_another_takes(engine):
    matrices = Matrices()
    assert engine.key() not in matrices
    predicted = matrices.seconds(engine)
    assert matrices.matrix(engine) is matrices.matrix(engine)
    assert engine.key() in matrices
    assert predicted > 0.0 < matrices.seconds(engine)
