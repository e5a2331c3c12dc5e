"""Rays on a sensor with a cover glass, beside single steps through the faces of the plate."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import CoverGlass, Lens
from lensdesign.lens.poses import rotation_matrix
from lensdesign.raytrace.bundles import launch, pupil_rings
from lensdesign.raytrace.rays import trace
from tolerancing.merits.sensor_rays import arriving_rays
from tolerancing.perturbations.batch import batch_of
from tolerancing.perturbations.parameters import PerturbedParameter

FIELDS = ((0.3, 1.0), (-1.0, 0.2))
INDEX = 1.6


def refracted(direction: np.ndarray, normal: np.ndarray, ratio: float) -> np.ndarray:
    """Return directions behind a plane by Snell's law in vector form; ratio is n before over n behind."""
    cosine = direction @ normal
    behind = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
    return np.asarray(ratio * direction + (behind - ratio * cosine)[:, None] * normal)


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (3.0, 0.0), (-2.0, 4.0)])
def test_the_plate_tilts_with_the_sensor(paper_lens: Lens, tilt_deg: tuple[float, float]) -> None:
    glass = CoverGlass(thickness_mm=0.7, material=INDEX, distance_mm=0.5)
    lens = paper_lens.replaced(sensor=paper_lens.sensor.replaced(cover_glass=glass))
    parameters = [
        PerturbedParameter(target="sensor", parameter=name) for name in ("tilt_x_deg", "tilt_y_deg")
    ]
    samples = pupil_rings(2, 5)
    batch = batch_of(parameters, np.array([tilt_deg]), 0.0, seed=0)
    found = arriving_rays(lens, batch, FIELDS, samples.points, 0.532)
    assert np.all(found.ok)

    rotation = rotation_matrix(*np.deg2rad(tilt_deg))
    centre, normal = np.array([0.0, 0.0, lens.sensor_z_mm[0]]), rotation[:, 2]
    rays = trace(paper_lens, *launch(paper_lens, FIELDS, samples.points, 0.532), 0.532)
    points, heading = rays.position, rays.direction
    for depth_mm, ratio in ((1.2, 1.0 / INDEX), (0.5, INDEX), (0.0, 1.0)):
        face = centre - depth_mm * normal
        points = points + (((face - points) @ normal) / (heading @ normal))[:, None] * heading
        heading = refracted(heading, normal, ratio)
    own = (points - centre) @ rotation
    np.testing.assert_allclose(found.position_mm[0], own[:, :2], rtol=0.0, atol=1e-11)
