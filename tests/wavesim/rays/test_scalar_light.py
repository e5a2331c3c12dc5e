"""Error of scalar waves for unpolarized light: closed forms of plates, and fields with all components."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lensdesign import Lens, ObjectSpace, Pose, Sensor, Surface, load_design, scaled
from lensdesign.lens.coatings.coating import CoatingName
from wavesim import Field, Grid, Scene, engine_for, patch_scene
from wavesim.rays.scalar_light import MARGIN, scalar_light_term

INDEX, APERTURE = 1.5, 0.1


def plate(coating: CoatingName) -> Scene:
    """A plate whose stop passes the numerical aperture from the axis."""
    lens = Lens(
        wavelengths_um=(0.5,),
        object=ObjectSpace(field_diameter_mm=1.0, numerical_aperture=APERTURE, working_distance_mm=10.0),
        sensor=Sensor(pixel_pitch_um=1.0, pixels=(64, 64), plane_distances_mm=(1.0,)),
        surfaces=(
            Surface(
                thickness_mm=2.0,
                material=INDEX,
                semi_diameter_mm=10.0 * math.tan(math.asin(APERTURE)),
                stop=True,
                coating=coating,
            ),
            Surface(semi_diameter_mm=3.0, coating=coating),
        ),
    )
    return Scene(lens, Grid((8, 8), 1e-3, -10.0), Grid((8, 8), 1e-2, 3.0), 0.5)


def test_a_line_has_no_error() -> None:
    scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.02, meridional=True)
    assert scalar_light_term(replace(scene, coating="bare")) is None


def test_an_ideal_plate_has_no_error() -> None:
    term = scalar_light_term(plate("ideal"))
    assert term is not None
    assert term.relative_error < 1e-12


def test_a_bare_plate_has_the_mean_over_its_pupil() -> None:
    """By Fresnel's formulas tp / ts = 1 / cos(i - r) at each surface, and i - r is about (1 - 1/n) sin i.

    The components of s and p light differ from their mean by half of (1 - 1/n)^2 sin^2 i. The mean of sin^4 i
    over the aperture is NA^4 / 3.
    """
    term = scalar_light_term(plate("bare"))
    assert term is not None
    expected = 0.5 * (1.0 - 1.0 / INDEX) ** 2 * APERTURE**2 / math.sqrt(3.0)
    assert term.relative_error == pytest.approx(MARGIN * expected, rel=0.02)


def measured_error(scene: Scene) -> float:
    """Error of scalar waves, with noise as the object and on samples that are spread over the footprint."""
    end, random = scene.exit_grid, np.random.default_rng(2)
    scene = replace(scene, exit_grid=Grid((80, 80), end.pitch_mm * end.shape[0] / 80, end.z_mm))
    noise = random.standard_normal((2, *scene.object_grid.shape))
    light = Field(scene.object_grid, noise[0] + 1j * noise[1], scene.wavelength_um)
    # So narrow that the matrices of a tile's centre suffice.
    width_mm = 0.26 * scene.object_grid.pitch_mm * scene.object_grid.shape[0]
    scalar, engine = (
        engine_for(replace(scene, polarization=kind), "eikonal", tile_width_mm=width_mm, error=0.3)
        for kind in ("scalar", "unpolarized")
    )
    expected = math.sqrt(0.5) * scalar.forward(light).values
    fields = [field.values for field in engine.forward_components(light)]
    different = [*(field - expected for field in fields[::2]), *fields[1::2]]
    return float(np.linalg.norm(different) / np.linalg.norm(fields))


@pytest.mark.parametrize("coating", ["ideal", "bare", "mgf2"])
@pytest.mark.parametrize("at_mm", [0.0, 0.03])
def test_fields_with_all_components_have_the_error(coating: CoatingName, at_mm: float) -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
    scene = patch_scene(lens, 0.02, at_mm, plane_distance_mm=1 / 16)
    scene = replace(scene, coating=coating, pose=Pose(tilt_x_deg=0.8, decenter_y_mm=0.004))
    term = scalar_light_term(scene)
    assert term is not None
    assert 1.0 < term.relative_error / measured_error(scene) < 1.2
