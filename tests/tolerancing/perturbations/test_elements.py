"""Elements that move as one, against poses of a lens of one element, and wedges against their geometry."""

import math

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import DesignError, Pose, launch, load_design, pupil_hexapolar, trace
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter


def batch(*parameters):
    """One lens with parameters (target, parameter, value, further keys)."""
    made = tuple(PerturbedParameter(target=t, parameter=p, **keys) for t, p, _, keys in parameters)
    return PerturbationBatch(made, np.array([[value for _, _, value, _ in parameters]]))


def rays(lens, pose, surfaces):
    origins, directions = launch(lens, [[0.3, 1.1]], 0.9 * pupil_hexapolar(3).points, 0.532)
    traced = trace(lens, origins, directions, 0.532, pose, plane_z_mm=20.0, surface_perturbations=surfaces)
    return traced.position, traced.opl


@pytest.mark.parametrize("seat", ["front", "back", 3.5])
def test_a_lens_of_one_element_moves_as_the_lens_does(paper_lens, seat):
    """Decenter and tilts about x and the turned y, about the same point."""
    pivot = {"front": 0.0, "back": 9.7}.get(seat, seat)
    moves = {"decenter_x_mm": 0.02, "decenter_y_mm": -0.03, "despace_mm": 0.05}
    tilts = {"tilt_x_deg": 0.4, "tilt_y_deg": -0.7}
    moved = batch(
        *(("element 1", name, value, {}) for name, value in moves.items()),
        *(("element 1", name, value, {"seat": seat}) for name, value in tilts.items()),
    )
    surfaces = moved.surface_perturbations(paper_lens, 0.532)
    found = rays(paper_lens, Pose(), surfaces)
    expected = rays(paper_lens, Pose(**moves, **tilts, pivot_z_mm=pivot), {})
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(np.squeeze(one), np.squeeze(other), atol=1e-12)


def test_a_roll_leaves_the_sphere_that_lies_on_the_seat_where_it_is(paper_lens):
    """Its front is a sphere: only the back has moved, about the front's centre of curvature."""
    rolled = batch(("element 1", "roll_x_deg", 0.3, {}))
    surfaces = rolled.surface_perturbations(paper_lens, 0.532)
    found = rays(paper_lens, Pose(), surfaces)
    back_alone = rays(paper_lens, Pose(), {1: surfaces[1]})
    for one, other in zip(found, back_alone, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-11)
    angle, arm = math.radians(0.3), 42.3 - 9.7
    assert float(surfaces[1].decenter_y_mm[0]) == pytest.approx(arm * math.sin(angle))
    assert float(surfaces[1].despace_mm[0]) == pytest.approx(arm * (1.0 - math.cos(angle)))


def test_what_stands_behind_an_element_stays():
    lens = load_design(DESIGNS / "moulded_pair.toml")
    surfaces = batch(("element 1", "despace_mm", 0.1, {})).surface_perturbations(lens, 0.55)
    assert sorted(surfaces) == [lens.glass_fronts[0], lens.glass_fronts[0] + 1]
    second = batch(("element 2", "decenter_x_mm", 0.1, {})).surface_perturbations(lens, 0.55)
    assert sorted(second) == [lens.glass_fronts[1], lens.glass_fronts[1] + 1]


@pytest.mark.parametrize(
    ("target", "parameter", "reach"),
    [("surface 2", "tir", 10.0), ("element 1", "edge_difference", 10.0), ("surface 1", "tir", 8.26)],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_a_wedge_lifts_the_rim_on_one_side(paper_lens, target, parameter, reach, axis):
    """Both rims of a flat disc, turned as the surface is."""
    moved = batch((target, f"{parameter}_{'xy'[axis]}_mm", 0.02, {}))
    ((number, surface),) = moved.surface_perturbations(paper_lens, 0.532).items()
    assert number == (0 if target == "surface 1" else 1)
    rotation, shift = surface.pose().transform()
    rim = np.zeros(3)
    rim[axis] = reach
    ends = [rotation[0] @ (sign * rim) + shift[0] for sign in (1.0, -1.0)]
    assert ends[0][2] - ends[1][2] == pytest.approx(0.02, abs=1e-12)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"target": "element 2", "parameter": "decenter_x_mm"}, r"no such element.*element 1"),
        ({"target": "element 1", "parameter": "radius_mm"}, r"no such parameter.*decenter_x_mm"),
        ({"target": "element 1", "parameter": "despace_mm", "seat": "back"}, "only tilts and rolls of"),
        ({"target": "lens", "parameter": "tilt_x_deg", "seat": "back"}, "only tilts and rolls of"),
        ({"target": "element 1", "parameter": "roll_x_deg", "seat": 2.0}, "seat = 2: a roll needs a surface"),
        ({"target": "element 1", "parameter": "roll_x_deg"}, "the front of element 1 is a plane"),
    ],
)
def test_what_an_element_does_not_have_is_refused(paper_lens, keys, message):
    lens = paper_lens.with_surface(0, radius_mm=None)
    with pytest.raises((DesignError, ValueError), match=message):
        PerturbedParameter(**keys).check(lens)
