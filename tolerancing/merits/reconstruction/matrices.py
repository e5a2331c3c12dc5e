"""Matrices of engines on a line, cached by each process for all trials that use them."""

from __future__ import annotations

import time
import warnings
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.scene.engine import Engine, Grids


@dataclass(frozen=True, eq=False)
class MatrixOperator:
    """Matrix of an engine on a line, for repeated use of a slow engine.

    Attributes
    ----------
    scene : Grids
        Object grid and exit grid.
    matrix : ndarray of complex64, shape (exit samples, object samples)
        Matrix of the linear operator.
    """

    scene: Grids
    matrix: NDArray[np.complex64]

    @classmethod
    def of(cls, engine: Engine) -> MatrixOperator:
        """Compute the matrix of an engine by propagating each object sample."""
        scene = engine.scene
        matrix = np.empty((scene.exit_grid.size, scene.object_grid.size), np.complex64)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # a study may use few slices on purpose
            for column in range(scene.object_grid.size):
                values = np.zeros(scene.object_grid.size, complex)
                values[column] = 1.0
                field = Field(scene.object_grid, values, scene.wavelength_um)
                matrix[:, column] = engine.forward(field).values
        return cls(scene, matrix)

    def forward(self, field: Field) -> Field:
        """Return the field on the exit grid."""
        values = self.matrix @ field.values.astype(np.complex64)
        return Field(self.scene.exit_grid, values.astype(complex), field.wavelength_um)

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint for the inner product <f, g> = cell * sum(conj(f) g)."""
        cells = self.scene.exit_grid.cell / self.scene.object_grid.cell
        values = (field.values.conj().astype(np.complex64) @ self.matrix).conj()
        return Field(self.scene.object_grid, cells * values.astype(complex), field.wavelength_um)


class Matrices:
    """Cache of matrices by the keys of their engines, with an estimate of computing times."""

    def __init__(self) -> None:
        self._cache: OrderedDict[str, MatrixOperator] = OrderedDict()
        self._estimated_seconds = self._measured_seconds = 0.0

    def __contains__(self, key: str) -> bool:
        return key in self._cache

    def matrix(self, engine: Engine) -> MatrixOperator:
        """Return the matrix of an engine, computed at its first use."""
        key = engine.key()
        if key not in self._cache:
            start = time.perf_counter()
            self._cache[key] = MatrixOperator.of(engine)
            self._measured_seconds += time.perf_counter() - start
            self._estimated_seconds += _engine_seconds(engine)
            # Memory limit of a process's matrices; the least recently used one is dropped first.
            most_bytes = 1_500_000_000
            while len(self._cache) > 1 and sum(m.matrix.nbytes for m in self._cache.values()) > most_bytes:
                self._cache.popitem(last=False)
        self._cache.move_to_end(key)
        return self._cache[key]

    def seconds(self, engine: Engine) -> float:
        """Return the time to compute a matrix: the engine's estimate, corrected by measured times."""
        ratio = self._measured_seconds / self._estimated_seconds if self._estimated_seconds > 0.0 else 1.0
        return ratio * _engine_seconds(engine)


def _engine_seconds(engine: Engine) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cost = engine.cost()
    return cost.setup_seconds + engine.scene.object_grid.size * cost.seconds


MATRICES = Matrices()
"""Cache of this process."""
