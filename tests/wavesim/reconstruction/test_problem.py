"""What frames of another model tell of ours: the bench that they state explains them."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from places import GOLDEN

from lensdesign import load_design
from lensdesign.lens.figure import figure_from_zernike
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from wavesim import read_frames
from wavesim.fields.files import read_field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.problem import ReconstructionProblem, reconstruction_problem
from wavesim.scene.bench import Bench, LightErrors
from wavesim.scene.placement import Placement
from wavesim.scene.settings import ReconstructionSettings
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.measurement import Measurement, noise_misfit
from wavesim.sensor.mounting import planes_at

BENCH = GOLDEN / "bench"
SETTINGS = ReconstructionSettings(kind="amplitude", patch_mm=0.16)


def stated(lens: Lens) -> Bench:
    """The errors of `set.json`, but for the bend of the light, whose form it does not say."""
    errors = json.loads((BENCH / "everything" / "set.json").read_text())["errors"]
    front, back = lens.surfaces
    waves = errors["surface_2_figure_zernike_waves_633nm"]
    assert front.radius_mm is not None
    assert back.radius_mm is not None
    assert back.semi_diameter_mm is not None
    figure = figure_from_zernike({int(j): 0.633 * w for j, w in waves.items()}, back.semi_diameter_mm)
    surfaces = {
        0: SurfacePerturbation(
            index=errors["index"],
            radius_mm=errors["surface_1_radius_relative"] * front.radius_mm,
            thickness_mm=errors["thickness_mm"],
        ),
        1: SurfacePerturbation(radius_mm=errors["surface_2_radius_relative"] * back.radius_mm, figure=figure),
    }
    # 1 - 0.05 (x^2 + 0.5 y + 0.2 x y), in Legendre polynomials.
    light = LightErrors(
        (errors["light_tilt_x_deg"], errors["light_tilt_y_deg"]),
        {(2, 0): -0.1 / 3.0, (0, 1): -0.025, (1, 1): -0.01},
    )
    placement = Placement(
        Pose(decenter_y_mm=errors["lens_decenter_y_mm"]),
        surface_perturbations=surfaces,
        plane_distances_mm=(0.0, errors["plane_2_distance_mm"]),
    )
    return Bench(placement, light, plane_backgrounds=(errors["background_share_of_mean"],) * 2)


def over_noise(case: ReconstructionProblem, recorded: list[Measurement], true: np.ndarray) -> float:
    """Misfit that the true object leaves, over that of the stated noise."""
    model = ForwardModel(case.engine, case.light, recorded, None, SETTINGS.fill_factor)
    model.fits_scale = True
    noise = noise_misfit(recorded)
    assert noise is not None
    return model.step(true)[1] / noise


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_frames_of_another_model_are_those_of_the_bench_that_they_state() -> None:
    lens = load_design(BENCH / "nominal.toml")
    frames = read_frames(sorted((BENCH / "everything").glob("frame_*.tif")), lens=lens)
    bench = stated(lens)
    case = reconstruction_problem(lens, frames, SETTINGS, None, bench, None)
    true = read_field(BENCH / "everything" / "object.npz")[0].real.astype(np.float32)
    recorded = recorded_planes(frames)
    assert over_noise(case, planes_at(recorded, bench), true) < 2.4

    farther = replace(bench, placement=replace(bench.placement, plane_distances_mm=(0.0, 0.02)))
    assert over_noise(case, planes_at(recorded, farther), true) > 3.0
    brighter = replace(bench, plane_backgrounds=(0.02, 0.02))
    assert over_noise(case, planes_at(recorded, brighter), true) > 3.0
