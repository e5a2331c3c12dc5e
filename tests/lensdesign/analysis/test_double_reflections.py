"""Ghosts of lens, cover glass and sensor against a trace that is written out here, ray by ray."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import (
    Coating,
    CoatingLayer,
    CoverGlass,
    InputError,
    Pose,
    SurfacePerturbation,
    load_design,
)
from lensdesign.analysis import GhostSampling, ghost_paths
from lensdesign.analysis.double_reflections import field_rays, sensor_system
from lensdesign.raytrace.ghosts import ghost_system
from lensdesign.raytrace.polarization import jones_matrices
from lensdesign.raytrace.rays import trace_compiled

PAPER = load_design("designs/paper_singlet.toml")
FILM = (1.38, 0.0964)
COATED = Coating(layers=(CoatingLayer(index=FILM[0], thickness_nm=1e3 * FILM[1]),))


def with_sensor(lens, coating="bare"):
    glass = CoverGlass(thickness_mm=0.7, material=1.52, distance_mm=0.5, coating=coating)
    surfaces = tuple(surface.replaced(coating=coating) for surface in lens.surfaces)
    return lens.replaced(surfaces=surfaces, sensor=lens.sensor.replaced(cover_glass=glass, reflectance=0.05))


def fresnel(n1, c1, n2, c2, film):
    """Amplitudes (r, t) of fields along s and along p; one film by Airy's sum, or none."""

    def bare(a, ca, b, cb):
        rs, rp = (a * ca - b * cb) / (a * ca + b * cb), (b * ca - a * cb) / (b * ca + a * cb)
        return (rs, 2.0 * a * ca / (a * ca + b * cb)), (rp, 2.0 * a * ca / (b * ca + a * cb))

    if film is None:
        return bare(n1, c1, n2, c2)
    n, d = film
    c = np.sqrt(1.0 - (n1 / n) ** 2 * (1.0 - c1**2) + 0j)
    across = np.exp(2j * np.pi / 0.532 * n * c * d)
    found = []
    for (r1, t1), (r2, t2) in zip(bare(n1, c1, n, c), bare(n, c, n2, c2), strict=True):
        total = 1.0 + r1 * r2 * across**2
        found.append(((r1 + r2 * across**2) / total, t1 * t2 * across / total))
    return found


def written_out(lens, plane_distance_mm, path, origin, heading, film):
    """Mean transmittance of a ray along a path of surfaces (index, whether it reflects); None if clipped."""
    n = float(lens.indices(0.532)[1])
    glass = lens.sensor.cover_glass
    z = [0.0, 9.7, 9.7 + plane_distance_mm - 1.2, 9.7 + plane_distance_mm - 0.5, 9.7 + plane_distance_mm]
    radii, conics = [42.3, -12.0, None, None, None], [0.0, -0.89862, 0.0, 0.0, 0.0]
    semi = [8.26, 10.0, np.inf, np.inf, np.inf]
    behind = [n, 1.0, glass.material, 1.0, 1.0]
    point, k, medium = np.array(origin, float), np.array(heading, float), 1.0
    helper = np.array([0.0, 0.0, 1.0]) if abs(k[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = np.cross(k, helper) / np.linalg.norm(np.cross(k, helper))
    fields, flux = [first + 0j, np.cross(k, first) + 0j], 1.0
    for i, reflects in path:
        c, q = (0.0 if radii[i] is None else 1.0 / radii[i]), 1.0 + conics[i]
        p = point - [0.0, 0.0, z[i]]
        form = np.diag([1.0, 1.0, q])
        a, b, g = c * k @ form @ k, 2.0 * (c * p @ form @ k - k[2]), c * p @ form @ p - 2.0 * p[2]
        roots = np.roots([a, b, g]) if abs(a) > 1e-14 else np.array([-g / b])
        if np.any(np.abs(roots.imag) > 1e-9):
            return None
        t = min(roots.real, key=lambda s: abs((p + s * k)[2]))
        p = p + t * k
        if np.hypot(p[0], p[1]) > semi[i] * (1.0 + 1e-9):
            return None
        point = p + np.array([0.0, 0.0, z[i]])
        normal = np.array([-c * p[0], -c * p[1], 1.0 - c * q * p[2]])
        normal /= np.linalg.norm(normal)
        forward = k[2] > 0.0
        other = behind[i] if forward else (1.0 if i == 0 else behind[i - 1])
        normal = normal if normal @ k > 0.0 else -normal
        c1 = normal @ k
        square = 1.0 - (medium / other) ** 2 * (1.0 - c1**2)
        if square < 0.0 and not reflects:
            return None
        c2 = np.sqrt(square + 0j)
        s = np.cross(k, normal)
        s = s / np.linalg.norm(s) if np.linalg.norm(s) > 1e-12 else np.cross(k, first)
        if i == 4:  # the sensor: 5 % at all angles, with the signs of glass
            amplitudes = [(sign * np.sqrt(0.05), np.sqrt(0.95)) for sign in (-1.0, 1.0)]
        else:
            films = None if film is None else film
            amplitudes = fresnel(medium, c1, other, c2, films)
        new = (
            k - 2.0 * c1 * normal
            if reflects
            else (medium / other * k + (np.sqrt(max(square, 0.0)) - medium / other * c1) * normal)
        )
        before, after = np.cross(k, s), np.cross(new, s)
        chosen = [pair[0 if reflects else 1] for pair in amplitudes]
        fields = [chosen[0] * (f @ s) * s + chosen[1] * (f @ before) * after for f in fields]
        if not reflects and i != 4:
            flux *= other * c2.real / (medium * c1)
            medium = other
        k = new
    return 0.5 * flux * sum(float(np.sum(np.abs(f) ** 2)) for f in fields)


@pytest.mark.parametrize(("coating", "film"), [("bare", None), (COATED, FILM)])
def test_the_power_of_every_path_is_that_of_a_written_out_trace(coating, film):
    lens = with_sensor(PAPER, coating)
    system, names = sensor_system(lens, 0.532, 2.0)
    assert names == ("surface 1", "surface 2", "cover glass front", "cover glass rear", "sensor")
    random = np.random.default_rng(0)
    origins, directions = field_rays(lens)
    chosen = random.choice(len(origins), 40, replace=False)
    origins, directions = origins[chosen], directions[chosen]
    compared = 0
    for back in range(5):
        for front in range(back):
            ghost = ghost_system(system, front, back)
            rays = trace_compiled(ghost, origins, directions, record_hits=True)
            found = jones_matrices(ghost, origins, rays).transmittance
            path = [(i, False) for i in range(back)] + [(back, True)]
            path += [(i, False) for i in range(back - 1, front, -1)] + [(front, True)]
            path += [(i, False) for i in range(front + 1, 5)]
            for ray in range(len(origins)):
                expected = written_out(lens, 2.0, path, origins[ray], directions[ray], film)
                assert (expected is not None) == bool(rays.ok[ray])
                if expected is not None:
                    assert found[ray] == pytest.approx(expected, rel=1e-9)
                    compared += 1
    assert compared > 200


def test_paths_are_listed_by_their_power():
    found = ghost_paths(with_sensor(PAPER))
    assert not found.assumes_bare_surfaces
    assert len(found.paths) == 2 * 10
    for distance in PAPER.sensor.plane_distances_mm:
        powers = [path.power for path in found.paths if path.plane_distance_mm == distance]
        assert powers == sorted(powers, reverse=True)
        assert all(path.power_on_sensor <= path.power for path in found.paths)
    strongest = found.paths[0]
    assert (strongest.first, strongest.second) == ("surface 2", "surface 1")
    assert found.total(2.0) == pytest.approx(
        sum(path.power_on_sensor for path in found.paths if path.plane_distance_mm == 2.0), rel=1e-12
    )


def test_a_coating_weakens_ghosts_and_ideal_ones_are_taken_as_bare():
    bare, coated, ideal = (
        ghost_paths(PAPER.replaced(surfaces=tuple(s.replaced(coating=c) for s in PAPER.surfaces)))
        for c in ("bare", "mgf2", "ideal")
    )
    assert ideal.assumes_bare_surfaces
    assert ideal.paths == bare.paths
    assert coated.paths[0].power < 0.5 * bare.paths[0].power
    # On the axis both reflect as at normal incidence.
    n = float(PAPER.indices(0.532)[1])
    assert bare.paths[0].power > ((n - 1.0) / (n + 1.0)) ** 4


def test_light_between_parallel_faces_keeps_its_focus():
    """A ghost between both faces of the plate is focused behind by twice its reduced thickness."""
    lens = with_sensor(PAPER)
    system, names = sensor_system(lens, 0.532, 2.0)
    found = {(p.first, p.second): p for p in ghost_paths(lens).paths if p.plane_distance_mm == 2.0}
    inside = found["cover glass rear", "cover glass front"]
    beyond = found["sensor", "cover glass rear"]
    assert inside.focus_mm - beyond.focus_mm == pytest.approx(-2.0 * 0.7 / 1.52 + 2.0 * 0.5, abs=1e-4)
    assert len(names) == system.surfaces


def test_without_a_reflectance_the_sensor_has_no_ghosts():
    lens = with_sensor(PAPER)
    dark = lens.replaced(sensor=lens.sensor.replaced(reflectance=None))
    assert not any("sensor" in (path.first, path.second) for path in ghost_paths(dark).paths)
    bonded = lens.replaced(
        sensor=lens.sensor.replaced(cover_glass=lens.sensor.cover_glass.replaced(distance_mm=0.0))
    )
    assert "cover glass rear" not in {path.first for path in ghost_paths(bonded).paths}


def test_a_lens_that_passes_no_light_has_no_ghosts():
    narrow = PAPER.with_surface(1, semi_diameter_mm=1e-3).replaced(
        object=PAPER.object.replaced(field_diameter_mm=0.1)
    )
    with pytest.raises(InputError, match="no ray from the field"):
        ghost_paths(narrow)


def by_name(found):
    """Paths in an order that does not depend on rounding of equal powers."""
    return sorted(found.paths, key=lambda path: (path.plane_distance_mm, path.first, path.second))


def same_light(one, other):
    for a, b in zip(by_name(one), by_name(other), strict=True):
        assert (a.first, a.second) == (b.first, b.second)
        found = (a.power, a.power_on_sensor, a.radius_mm, a.relative_irradiance)
        assert found == pytest.approx(
            (b.power, b.power_on_sensor, b.radius_mm, b.relative_irradiance), rel=1e-6
        )
        assert a.focus_mm == pytest.approx(b.focus_mm, rel=1e-5)


def with_lengths(lens, working_distance_mm=0.0, thickness_mm=0.0, planes_mm=0.0):
    """The lens with changed distances, in place of poses and perturbations."""
    moved = lens.with_surface(0, thickness_mm=lens.surfaces[0].thickness_mm + thickness_mm)
    return moved.replaced(
        object=lens.object.replaced(
            working_distance_mm=lens.object.working_distance_mm + working_distance_mm
        ),
        sensor=lens.sensor.replaced(
            plane_distances_mm=tuple(z + planes_mm for z in lens.sensor.plane_distances_mm)
        ),
    )


def test_displaced_lenses_and_sensors_are_those_of_other_distances():
    lens = with_sensor(PAPER)
    away = ghost_paths(lens, sensor_poses=(Pose(despace_mm=0.25),) * 2)
    same_light(away, ghost_paths(with_lengths(lens, planes_mm=0.25)))
    nearer = ghost_paths(lens, pose=Pose(despace_mm=0.25))
    same_light(nearer, ghost_paths(with_lengths(lens, working_distance_mm=0.25, planes_mm=-0.25)))
    thicker = ghost_paths(lens, surface_perturbations={0: SurfacePerturbation(thickness_mm=0.25)})
    same_light(thicker, ghost_paths(with_lengths(lens, thickness_mm=0.25, planes_mm=-0.25)))


def test_a_system_that_turns_with_its_rays_has_the_same_ghosts():
    lens = with_sensor(PAPER)
    turned = Pose(0.1, -0.2, 0.05, tilt_x_deg=3.0, tilt_y_deg=-2.0, pivot_z_mm=4.0)
    rotation, shift = (array[0] for array in turned.transform())
    straight, names = sensor_system(lens, 0.532, 2.0)
    moved, _ = sensor_system(lens, 0.532, 2.0, turned, None, turned)
    origins, directions = field_rays(lens, fields=2, directions=64)
    for front, back in ((0, 1), (0, 2), (1, 4), (2, 4)):
        one, other = ghost_system(straight, front, back), ghost_system(moved, front, back)
        rays = trace_compiled(one, origins, directions, record_hits=True)
        origins_too, directions_too = origins @ rotation.T + shift, directions @ rotation.T
        found = trace_compiled(other, origins_too, directions_too, record_hits=True)
        assert np.array_equal(found.ok, rays.ok)
        assert np.count_nonzero(rays.ok) > 40
        assert found.position[rays.ok] == pytest.approx((rays.position @ rotation.T + shift)[rays.ok])
        expected = jones_matrices(one, origins, rays).transmittance[rays.ok]
        powers = jones_matrices(other, origins_too, found).transmittance[rays.ok]
        assert powers == pytest.approx(expected, rel=1e-9)
    assert len(names) == moved.surfaces


def test_a_tilted_sensor_turns_the_light_that_it_reflects_away():
    lens = with_sensor(PAPER)
    tilted = tuple(
        Pose(tilt_x_deg=8.0, pivot_z_mm=lens.exit_vertex_z_mm + z) for z in lens.sensor.plane_distances_mm
    )
    straight, found = (
        {(p.first, p.second): p for p in ghost_paths(lens, sensor_poses=poses).paths[10:]}
        for poses in ((), tilted)
    )
    between = ("sensor", "surface 1")
    assert found[between].power_on_sensor < 0.97 * straight[between].power_on_sensor
    inside = ("sensor", "cover glass rear")
    assert found[inside].power_on_sensor == pytest.approx(straight[inside].power_on_sensor, rel=0.02)


def test_a_sensor_beside_the_light_records_no_ghost():
    lens = with_sensor(PAPER)
    beside = ghost_paths(lens, sensor_poses=(Pose(decenter_x_mm=500.0),) * 2)
    assert beside.total() == 0.0
    assert [p.power for p in beside.paths] == pytest.approx([p.power for p in ghost_paths(lens).paths])


def test_fading_edges_give_powers_that_change_smoothly():
    lens = with_sensor(PAPER)
    fading = GhostSampling(fields=2, directions=800, edge_width=0.1)

    def powers(bend):
        bent = lens.with_surface(1, radius_mm=-12.0 - bend)
        return np.array(list(ghost_paths(bent, sampling=fading).totals.values()))

    assert powers(0.0) == pytest.approx(list(ghost_paths(lens).totals.values()), rel=0.025)
    start, near, far = powers(0.0), powers(1e-4), powers(2e-4)
    assert np.all(near != start)
    assert far - start == pytest.approx(2.0 * (near - start), rel=0.02)


def test_mirror_images_of_object_points_are_counted():
    """Only a rotationally symmetric system is traced from half of its object points."""
    lens = with_sensor(PAPER)
    hardly_moved = ghost_paths(lens, pose=Pose(decenter_x_mm=1e-12))
    same_light(ghost_paths(lens), hardly_moved)


def test_a_ghost_that_is_focused_near_a_plane_is_a_warning():
    (warning,) = ghost_paths(with_sensor(PAPER)).warnings
    assert "the ghost cover glass front - surface 1 is focused 0.508 mm in front of the plane at 2 mm" in (
        warning
    )
    assert "its irradiance is 0.056 of that of the direct light" in warning
    assert "or move the plane away from the focus" in warning
    assert ghost_paths(PAPER).warnings == ()


def test_values_for_json_have_totals_and_no_infinities():
    found = ghost_paths(with_sensor(PAPER))
    values = found.as_dict()
    assert [one["power_on_sensor"] for one in values["totals"]] == [found.total(2.0), found.total(22.0)]
    assert values["bare_surfaces"] is False
    assert values["includes_sensor"] is True
    assert values["warnings"] == list(found.warnings)
    assert ghost_paths(PAPER).as_dict()["includes_sensor"] is False


def test_impossible_displacements_are_refused():
    with pytest.raises(InputError, match=r"sensor_poses has 1 poses: must have one for each of the 2"):
        ghost_paths(PAPER, sensor_poses=(Pose(),))
    with pytest.raises(InputError, match="ghosts are those of a single lens"):
        ghost_paths(PAPER, pose=Pose(decenter_x_mm=np.zeros(3)))
