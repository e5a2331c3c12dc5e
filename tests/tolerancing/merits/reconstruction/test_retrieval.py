"""Retrieval on a line, of an operator that is known exactly."""

from types import SimpleNamespace

import numpy as np
import pytest

from tolerancing.merits.reconstruction.matrices import MatrixOperator
from tolerancing.merits.reconstruction.retrieval import LineModel, pixel_amplitude, retrieve_on_line
from wavesim.fields.field import Field, Grid
from wavesim.sensor.measurement import Measurement

COUNT, PIXELS = 24, 200


@pytest.fixture(scope="module")
def model():
    rng = np.random.default_rng(5)
    scene = SimpleNamespace(
        object_grid=Grid((COUNT,), 1e-3, -1.0), exit_grid=Grid((2 * PIXELS,), 1e-3, 1.0), wavelength_um=0.5
    )
    matrix = np.linalg.qr(
        rng.standard_normal((2 * PIXELS, COUNT)) + 1j * rng.standard_normal((2 * PIXELS, COUNT))
    )
    light = Field(scene.object_grid, np.ones(COUNT, complex), 0.5)
    return LineModel(MatrixOperator(scene, matrix[0].astype(np.complex64)), None, (None,), light)


def test_an_amplitude_object_is_found(model):
    true = np.where(np.arange(COUNT) % 7 < 2, 0.2, 1.0)
    recorded = [Measurement(0.0, pixel_amplitude(model.forward(true)))]
    found, misfit = retrieve_on_line(model, recorded, is_complex=False, iterations=200)
    assert misfit[-1] < 0.1 * misfit[0]
    assert np.corrcoef(found.real, true)[0, 1] > 0.97


def test_iterations_end_where_the_misfit_rests(model):
    recorded = [Measurement(0.0, pixel_amplitude(model.forward(np.ones(COUNT))) * 1.0)]
    noisy = [Measurement(0.0, recorded[0].amplitude * np.random.default_rng(1).uniform(0.5, 1.5, PIXELS))]
    _, misfit = retrieve_on_line(model, noisy, is_complex=False, iterations=500)
    assert len(misfit) < 100
