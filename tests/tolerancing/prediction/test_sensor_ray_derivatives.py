"""Derivatives of arriving rays, beside rays that are traced."""

from __future__ import annotations

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import CoverGlass, Lens, load_design
from lensdesign.errors import DesignError
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.merits.sensor_rays import arriving_rays
from tolerancing.perturbations.batch import batch_of
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.sensor_ray_derivatives import arrival_differentials
from tolerancing.prediction.system import amounts_of

ASKED = [
    ("lens", "decenter_x_mm", 0.02),
    ("lens", "tilt_x_deg", 0.1),
    ("surface 1", "tilt_y_deg", 0.1),
    ("surface 1", "radius_mm", 0.1),
    ("surface 2", "conic", 0.01),
    ("surface 1", "thickness_mm", 0.05),
    ("surface 1", "index", 0.001),
    ("surface 2", "irregularity_rms_waves", 0.5),
    ("object", "working_distance_mm", 0.05),
    ("object", "decenter_y_mm", 0.01),
    ("sensor", "tilt_x_deg", 0.3),
    ("sensor", "decenter_x_mm", 0.05),
    ("sensor", "distance_mm", 0.05),
    ("light", "wavelength_um", 0.001),
    ("environment", "temperature_c", 5.0),
]
FIELDS = ((0.3, 1.0), (-1.0, 0.2))


@pytest.mark.parametrize(("stop", "covered"), [(0, False), (1, False), (0, True)])
def test_what_first_order_leaves_falls_with_the_square(stop: int, covered: bool) -> None:
    lens = _with_stop(load_design(DESIGNS / "paper_singlet.toml"), stop)
    if covered:
        glass = CoverGlass(thickness_mm=1.2, material="N-BK7", distance_mm=0.3)
        lens = lens.replaced(sensor=lens.sensor.replaced(cover_glass=glass))
    parameters = [PerturbedParameter(target=target, parameter=name) for target, name, _ in ASKED]
    sizes = np.array([size for *_, size in ASKED])
    samples = pupil_rings(2, 5, edge=True)
    known = arrival_differentials(lens, parameters, sizes, FIELDS, samples)
    whole = np.concatenate([np.diag(sizes), sizes * np.random.default_rng(2).normal(size=(6, len(sizes)))])
    left = []
    for part in (0.1, 0.05):
        batch = batch_of(parameters, part * whole, 0.0, seed=3)
        traced = arriving_rays(lens, batch, FIELDS, samples.points, lens.wavelengths_um[0])
        assert np.all(traced.ok)
        predicted = known.arrival(amounts_of(batch))
        off = np.stack(
            [predicted.position_mm - traced.position_mm, (predicted.direction - traced.direction)[..., :2]]
        )
        moved = np.stack(
            [traced.position_mm - known.position_mm, traced.direction[..., :2] - known.direction]
        )
        left.append(np.max(np.abs(off), axis=(2, 3)))
        assert np.all(left[-1][:, len(sizes) :] < 0.05 * np.max(np.abs(moved), axis=(2, 3))[:, len(sizes) :])
    assert np.all(left[1] <= left[0] / 3.0 + 2e-9)


def test_rays_that_the_nominal_lens_clips_are_left_out() -> None:
    whole = load_design(DESIGNS / "paper_singlet.toml")
    narrow = whole.surfaces[1].model_copy(update={"semi_diameter_mm": 8.0})
    lens = whole.model_copy(update={"surfaces": (whole.surfaces[0], narrow)})
    moved = [PerturbedParameter(target="lens", parameter="decenter_x_mm")]
    samples = pupil_rings(2, 12, edge=True)
    all_rays, left = (
        len(arrival_differentials(one, moved, np.ones(1), FIELDS, samples).direction) for one in (whole, lens)
    )
    assert all_rays == 2 * len(samples.points)
    assert 0 < left < all_rays
    blind = whole.model_copy(
        update={"surfaces": (whole.surfaces[0], narrow.model_copy(update={"semi_diameter_mm": 1e-6}))}
    )
    with pytest.raises(DesignError, match="no ray"):
        arrival_differentials(blind, moved, np.ones(1), ((1.0, 1.0),), samples)


def _with_stop(lens: Lens, stop: int) -> Lens:
    surfaces = [s.model_copy(update={"stop": k == stop}) for k, s in enumerate(lens.surfaces)]
    surfaces[stop] = surfaces[stop].model_copy(update={"semi_diameter_mm": 6.0})
    return lens.model_copy(update={"surfaces": tuple(surfaces)})
