"""Ghosts against reflections written out."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Pose, load_design
from lensdesign.errors import InputError
from lensdesign.raytrace.bundles import launch_compiled
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.ghosts import ghost_system
from lensdesign.raytrace.rays import trace_compiled

PAPER = load_design("designs/paper_singlet.toml")
PLANE_Z_MM = PAPER.exit_vertex_z_mm + 2.0


def met(point, heading, vertex_z, radius, conic):
    """Distance along a ray to a conic by its quadratic equation, and the normal there."""
    c, k = 1.0 / radius, 1.0 + conic
    p = point - [0.0, 0.0, vertex_z]
    form = np.diag([1.0, 1.0, k])
    a = c * heading @ form @ heading
    b = 2.0 * (c * p @ form @ heading - heading[2])
    ways = np.roots([a, b, c * p @ form @ p - 2.0 * p[2]])
    hits = [p + t.real * heading for t in ways]
    t, hit = min(zip(ways.real, hits, strict=True), key=lambda found: abs(found[1][2]))
    normal = np.array([c * hit[0], c * hit[1], c * k * hit[2] - 1.0])
    return t, normal / np.linalg.norm(normal)


def refracted(heading, normal, ratio):
    normal = normal * np.sign(normal @ heading)
    cosine = normal @ heading
    return ratio * heading + (np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine) * normal


def written_out(origin, heading, n):
    """Refraction, two mirrors, refraction: point, direction and path on the plane."""
    front, back = (0.0, 42.3, 0.0), (9.7, -12.0, -0.89862)
    point, path = origin, 0.0
    for surface, index, event in ((front, 1.0, 1.0 / n), (back, n, None), (front, n, None), (back, n, n)):
        t, normal = met(point, heading, *surface)
        assert t > 0.0
        point, path = point + t * heading, path + index * t
        if event is None:
            heading = heading - 2.0 * (heading @ normal) * normal
        else:
            heading = refracted(heading, normal, event)
    t = (PLANE_Z_MM - point[2]) / heading[2]
    return point + t * heading, heading, path + t


def rays_of(system, field_mm):
    pupil = np.array([[0.0, 0.0], [0.2, 0.1], [-0.3, 0.4], [0.0, 0.7]])
    return launch_compiled(
        system, [field_mm], pupil, PAPER.object_z_mm, PAPER.stop_index, PAPER.stop_semi_diameter_mm
    )


@pytest.mark.parametrize("field_mm", [(0.0, 0.0), (0.3, 1.4)])
def test_real_rays(field_mm) -> None:
    system = compile_system(PAPER, 0.532)
    origins, directions = rays_of(system, field_mm)
    rays = trace_compiled(ghost_system(system), origins, directions, PLANE_Z_MM)
    assert rays.ok.all()
    n = float(system.index[0, 1])
    for i, (origin, heading) in enumerate(zip(origins, directions, strict=True)):
        point, direction, path = written_out(origin, heading, n)
        assert rays.position[i] == pytest.approx(point, abs=1e-11)
        assert rays.direction[i] == pytest.approx(direction, abs=1e-12)
        assert rays.opl[i] == pytest.approx(path, abs=1e-11)


def test_a_ghost_of_a_moved_lens_is_the_moved_ghost() -> None:
    """Lens, rays and plane moved and turned together."""
    system = compile_system(PAPER, 0.532)
    moved = compile_system(PAPER, 0.532, Pose(decenter_x_mm=0.4, tilt_y_deg=20.0))
    turn, shift = moved.rotation[0, 0], moved.vertex[0, 0]
    origins, directions = rays_of(system, (0.3, 1.0))
    here = trace_compiled(ghost_system(system), origins, directions)
    there = trace_compiled(ghost_system(moved), origins @ turn.T + shift, directions @ turn.T)
    assert there.position == pytest.approx(here.position @ turn.T + shift, abs=1e-12)
    assert there.direction == pytest.approx(here.direction @ turn.T, abs=1e-12)
    assert there.opl == pytest.approx(here.opl, abs=1e-12)


def test_surfaces_that_are_not_there() -> None:
    system = compile_system(PAPER, 0.532)
    for front, back in ((1, 1), (0, 2), (-1, 1)):
        with pytest.raises(InputError, match="must be two surfaces from 1 to 2"):
            ghost_system(system, front, back)
