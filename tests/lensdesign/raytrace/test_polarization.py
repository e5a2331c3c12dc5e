"""Jones matrices along rays against Optiland, polarization ray-tracing matrices, and symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import (
    Coating,
    CoatingLayer,
    InputError,
    Pose,
    SurfacePerturbation,
    launch,
    load_design,
    pupil_hexapolar,
    trace_polarized,
)
from lensdesign.raytrace import (
    compile_system,
    ghost_system,
    jones_matrices,
    polarization_matrices,
    trace_compiled,
    transverse_basis,
)

PAPER = load_design("designs/paper_singlet.toml")
LAYERS = tuple(CoatingLayer(index=n, thickness_nm=d) for n, d in ((1.38, 100.0), (2.05, 130.0), (1.65, 85.0)))
# Matrices of Optiland 0.6.3 for the lens of the paper; `_flux` is n cos(t) behind over in front, of all
# surfaces, which its amplitudes of electric fields do not contain. The film's p amplitudes, which are those
# of the component along the surface, were multiplied by the ratio of cosines.
OPTILAND = dict(np.load("tests/golden/polarization_of_optiland.npz"))


def coated(coating, lens=PAPER):
    return lens.replaced(surfaces=tuple(surface.replaced(coating=coating) for surface in lens.surfaces))


def traced(lens, origins, directions, **displaced):
    system = compile_system(lens, 0.532, **displaced)
    return system, trace_compiled(system, origins, directions, record_hits=True)


def properties(jones):
    """Transmittance, diattenuation and retardance from singular values and eigenvalues."""
    left, size, right = np.linalg.svd(jones)
    squares, own = size**2, np.linalg.eigvals(left @ right)
    return (
        0.5 * squares.sum(axis=-1),
        (squares[:, 0] - squares[:, 1]) / squares.sum(axis=-1),
        np.abs(np.angle(own[:, 0] / own[:, 1])),
    )


@pytest.mark.parametrize(
    ("name", "coating", "perturbations"),
    [
        ("bare", "bare", {}),
        ("coated", Coating(layers=LAYERS), {}),
        ("decentered", "bare", {1: SurfacePerturbation(decenter_x_mm=0.2, decenter_y_mm=-0.1)}),
    ],
)
def test_rays_have_the_properties_that_optiland_finds(name, coating, perturbations):
    lens = coated(coating)
    origins, directions = OPTILAND["origins"], OPTILAND["directions"]
    found = trace_polarized(lens, origins, directions, 0.532, surface_perturbations=perturbations)
    across = np.swapaxes(transverse_basis(found.after), -1, -2), transverse_basis(found.before)
    theirs = across[0] @ OPTILAND[name] @ across[1] * np.sqrt(OPTILAND[f"{name}_flux"])[:, None, None]
    own = found.transmittance, found.diattenuation, found.retardance_rad
    assert np.all(np.isfinite(own))
    assert np.abs(np.array(own) - properties(theirs)).max() < 1e-12


@pytest.mark.parametrize("coating", ["ideal", "bare", "mgf2", Coating(layers=LAYERS)])
@pytest.mark.parametrize("is_ghost", [False, True])
def test_matrices_of_two_rows_are_those_of_three(coating, is_ghost):
    lens = coated(coating)
    origins, directions = launch(lens, [(0.0, 0.0), (0.7, -1.0)], 0.7 * pupil_hexapolar(5).points, 0.532)
    pose = Pose(decenter_x_mm=0.2, tilt_x_deg=1.0, tilt_y_deg=-0.7)
    system = compile_system(lens, 0.532, pose)
    system = ghost_system(system) if is_ghost else system
    rays = trace_compiled(system, origins, directions, record_hits=True)
    found, matrices = jones_matrices(system, origins, rays), polarization_matrices(system, origins, rays)
    assert rays.throughput > 0.9
    across = np.swapaxes(transverse_basis(found.after), -1, -2), transverse_basis(found.before)
    expected = across[0] @ matrices @ across[1]
    assert np.abs(expected - found.jones)[rays.ok].max() < 1e-14
    carried = np.einsum("nij,nj->ni", matrices, found.before.astype(complex))
    assert np.abs(carried - found.after)[rays.ok].max() < 1e-14


def test_a_rotation_of_lens_and_rays_changes_nothing():
    lens = coated("bare")
    origins, directions = launch(lens, [(0.3, 0.5)], 0.9 * pupil_hexapolar(4).points, 0.532)
    pose = Pose(decenter_x_mm=0.3, decenter_y_mm=-0.2, tilt_x_deg=3.0, tilt_y_deg=-2.0, pivot_z_mm=4.0)
    rotation, shift = (one[0] for one in pose.transform())
    straight = traced(lens, origins, directions)
    turned = traced(lens, origins @ rotation.T + shift, directions @ rotation.T, pose=pose)
    expected = polarization_matrices(straight[0], origins, straight[1])
    found = polarization_matrices(turned[0], origins @ rotation.T + shift, turned[1])
    assert np.abs(rotation.T @ found @ rotation - expected).max() < 1e-13


@given(st.floats(-1.5, 1.5), st.floats(-0.9, 0.9), st.floats(0.0, 2.0 * np.pi))
def test_an_ideal_coating_keeps_the_flux_of_every_polarization(field, radius, angle):
    origins, directions = launch(
        PAPER, [(0.0, field)], [(radius * np.cos(angle), radius * np.sin(angle))], 0.532
    )
    jones = trace_polarized(PAPER, origins, directions, 0.532).jones[0]
    assert np.abs(jones.conj().T @ jones - np.eye(2)).max() < 1e-13


def test_light_on_the_axis_and_in_the_meridional_plane():
    lens = coated("bare")
    n = float(lens.indices(0.532)[1])
    origins, directions = launch(lens, [(0.0, 0.0)], [(0.0, 0.0), (0.0, 1.0)], 0.532)
    found = trace_polarized(lens, origins, directions, 0.532)
    assert found.jones[0] == pytest.approx((1.0 - ((n - 1.0) / (n + 1.0)) ** 2) * np.eye(2), abs=1e-14)
    # In the meridional plane x is s and y is p: they do not mix, and p passes better.
    (xx, xy), (yx, yy) = found.jones[1]
    assert max(abs(xy), abs(yx)) < 1e-15
    assert abs(yy) > abs(xx)


def test_trials_and_rays_that_fail():
    lens = coated("mgf2")
    origins, directions = launch(lens, [(0.0, 0.0)], [(0.0, 0.5), (0.0, 1.3)], 0.532)
    pose = Pose(decenter_y_mm=np.array([0.0, 0.1, 0.2]))
    together = trace_polarized(lens, origins, directions, 0.532, pose)
    assert together.jones.shape == (3, 2, 2, 2)
    assert np.isnan(together.jones[:, 1]).all()
    assert np.isnan(together.diattenuation[:, 1]).all()
    alone = trace_polarized(lens, origins, directions, 0.532, Pose(decenter_y_mm=0.2))
    assert together.jones[2, 0] == pytest.approx(alone.jones[0], abs=1e-15)


def test_a_surface_without_films_has_no_thickness_to_change():
    changed = {1: SurfacePerturbation(coating_thickness_percent=1.0)}
    with pytest.raises(InputError, match="surface 2: coating_thickness_percent: the coating of this surface"):
        compile_system(coated("bare"), 0.532, surface_perturbations=changed)


def test_thickness_errors_of_a_coating_change_its_light_and_not_the_rays():
    lens = coated("mgf2")
    origins, directions = launch(lens, [(0.0, 0.0)], [(0.0, 0.0)], 0.532)
    errors = np.array([-10.0, 0.0, 10.0])
    changed = {1: SurfacePerturbation(coating_thickness_percent=errors)}
    transmittance = trace_polarized(
        lens, origins, directions, 0.532, surface_perturbations=changed
    ).transmittance[:, 0]
    assert transmittance[1] > max(transmittance[0], transmittance[2])  # a quarter wave is the best
    thicker = Coating(layers=(CoatingLayer(material="MgF2", quarter_waves=1.1),), design_wavelength_um=0.532)
    expected = trace_polarized(lens.with_surface(1, coating=thicker), origins, directions, 0.532)
    assert transmittance[2] == pytest.approx(expected.transmittance[0], abs=1e-12)


def test_films_have_a_thickness_left():
    origins, directions = launch(PAPER, [(0.0, 0.0)], [(0.0, 0.0)], 0.532)
    gone = {1: SurfacePerturbation(coating_thickness_percent=-150.0)}
    with pytest.raises(InputError, match="surface 2: coating_thickness_percent = -150: must be above -100"):
        trace_polarized(coated("mgf2"), origins, directions, 0.532, surface_perturbations=gone)


def test_hits_are_needed():
    system = compile_system(PAPER, 0.532)
    origins, directions = launch(PAPER, [(0.0, 0.0)], [(0.0, 0.0)], 0.532)
    with pytest.raises(InputError, match="record_hits"):
        jones_matrices(system, origins, trace_compiled(system, origins, directions))
