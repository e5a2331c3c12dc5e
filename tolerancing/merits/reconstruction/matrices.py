"""Engines on a line as matrices, which a process keeps for all trials that use them."""

from __future__ import annotations

import time
import warnings
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.fields.guards import SamplingWarning
from wavesim.scene.engine import Engine, Grids

MOST_BYTES = 1_500_000_000
"""Memory of the matrices that a process keeps; the one that was used longest ago is dropped first."""


@dataclass(frozen=True, eq=False)
class MatrixOperator:
    """An engine on a line as a matrix, for many uses of an engine that takes long.

    Attributes
    ----------
    scene : Grids
        Between which grids it carries.
    matrix : ndarray of complex64, shape (exit samples, object samples)
        The engine.
    """

    scene: Grids
    matrix: NDArray[np.complex64]

    @classmethod
    def of(cls, engine: Engine) -> MatrixOperator:
        """The matrix of an engine, which carries each object sample by itself."""
        scene = engine.scene
        matrix = np.empty((scene.exit_grid.size, scene.object_grid.size), np.complex64)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # few slices may be what a study is about
            for column in range(scene.object_grid.size):
                values = np.zeros(scene.object_grid.size, complex)
                values[column] = 1.0
                field = Field(scene.object_grid, values, scene.wavelength_um)
                matrix[:, column] = engine.forward(field).values
        return cls(scene, matrix)

    def forward(self, field: Field) -> Field:
        """A field on the exit grid."""
        values = self.matrix @ field.values.astype(np.complex64)
        return Field(self.scene.exit_grid, values.astype(complex), field.wavelength_um)

    def adjoint(self, field: Field) -> Field:
        """The adjoint, for <f, g> = cell * sum(conj(f) g)."""
        cells = self.scene.exit_grid.cell / self.scene.object_grid.cell
        values = (field.values.conj().astype(np.complex64) @ self.matrix).conj()
        return Field(self.scene.object_grid, cells * values.astype(complex), field.wavelength_um)


class Matrices:
    """Matrices by the keys of their engines, and how long they take to make."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, MatrixOperator] = OrderedDict()
        self._told = self._taken = 0.0

    def __contains__(self, key: str) -> bool:
        return key in self._kept

    def matrix(self, engine: Engine) -> MatrixOperator:
        """The matrix of an engine; made where it is not there."""
        key = engine.key()
        if key not in self._kept:
            start = time.perf_counter()
            self._kept[key] = MatrixOperator.of(engine)
            self._taken += time.perf_counter() - start
            self._told += _told_seconds(engine)
            while len(self._kept) > 1 and sum(one.matrix.nbytes for one in self._kept.values()) > MOST_BYTES:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]

    def seconds(self, engine: Engine) -> float:
        """Time that a matrix takes: what its engine states, corrected by what others took."""
        ratio = self._taken / self._told if self._told > 0.0 else 1.0
        return ratio * _told_seconds(engine)


def _told_seconds(engine: Engine) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cost = engine.cost()
    return cost.setup_seconds + engine.scene.object_grid.size * cost.seconds


MATRICES = Matrices()
"""Those of this process."""
