"""Lenses laid out as arrays, nominal and perturbed."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign import Lens, Pose, Surface, SurfacePerturbation
from lensdesign.errors import InputError
from lensdesign.lens import surface_figure_from_zernike
from lensdesign.raytrace.compiled import compile_system


def test_the_nominal_lens(paper_lens: Lens) -> None:
    system = compile_system(paper_lens, 0.532)
    assert system.trials is None
    assert system.surfaces == 2
    assert system.vertex.tolist() == [[[0.0, 0.0, 0.0], [0.0, 0.0, 9.7]]]
    codes, _, terms = system.packed_shapes
    assert codes.tolist() == [0, 0]
    assert terms[0, :, 0] == pytest.approx([1 / 42.3, -1 / 12.0])
    assert terms[0, :, 1].tolist() == [0.0, -0.89862]
    assert system.semi_diameter.tolist() == [8.26, 10.0]
    assert np.array_equal(system.rotation[0], np.stack([np.eye(3)] * 2))
    assert not system.tilted.any()


def test_a_surface_without_semi_diameter_clips_nothing(paper_lens: Lens) -> None:
    assert compile_system(paper_lens.with_surface(1, semi_diameter_mm=None), 0.532).semi_diameter[1] == np.inf


def test_asphere_terms_are_padded_to_the_longest(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(0, asphere=(1e-6, 2e-8)).with_surface(1, asphere=(3e-6,))
    codes, _, terms = compile_system(lens, 0.532).packed_shapes
    assert codes.tolist() == [1, 1]
    assert terms[0, :, 2:].tolist() == [[1e-6, 2e-8], [3e-6, 0.0]]


def test_a_thickness_moves_every_surface_behind(paper_lens: Lens) -> None:
    middle = paper_lens.surfaces[1].model_copy(update={"thickness_mm": 2.0, "material": 1.6})
    three = paper_lens.replaced(surfaces=(paper_lens.surfaces[0], middle, Surface(semi_diameter_mm=10.0)))
    system = compile_system(three, 0.532, surface_perturbations={0: SurfacePerturbation(thickness_mm=0.1)})
    assert system.vertex[0, :, 2] == pytest.approx([0.0, 9.8, 11.8])
    system = compile_system(three, 0.532, surface_perturbations={1: SurfacePerturbation(despace_mm=0.1)})
    assert system.vertex[0, :, 2] == pytest.approx([0.0, 9.8, 11.7])


def test_perturbed_radius_conic_and_index(paper_lens: Lens) -> None:
    change = SurfacePerturbation(
        radius_mm=np.array([0.3, 0.0]), conic=np.array([0.0, 0.01]), index=np.array([0.001, 0.0])
    )
    system = compile_system(paper_lens, 0.532, surface_perturbations={0: change})
    assert system.trials == 2
    *_, terms = system.packed_shapes
    assert terms[:, 0, 0] == pytest.approx([1 / 42.6, 1 / 42.3])
    assert terms[:, 0, 1].tolist() == [0.0, 0.01]
    assert np.diff(system.index[:, 1]) == pytest.approx(-0.001)
    assert system.index[:, [0, 2]].tolist() == [[1.0, 1.0], [1.0, 1.0]]


def test_a_shape_is_perturbed_as_if_the_design_said_so(paper_lens: Lens) -> None:
    biconic = paper_lens.with_surface(1, shape_type="biconic", radius_x_mm=-14.0, conic_x=-1.2)
    change = SurfacePerturbation(conic=0.1, shape={"radius_x_mm": np.array([0.2, 0.0]), "conic_x": 0.3})
    found = compile_system(biconic, 0.532, surface_perturbations={1: change})
    designed = biconic.with_surface(1, radius_x_mm=-13.8, conic=biconic.surfaces[1].conic + 0.1, conic_x=-0.9)
    assert found.trials == 2
    assert found.shapes[1].trial(0).terms == pytest.approx(designed.surfaces[1].shape.terms, rel=1e-15)
    assert found.shapes[1].trial(1).term("curvature_x") == -1.0 / 14.0
    asphere = paper_lens.with_surface(0, asphere=(1e-6, 2e-8))
    change = SurfacePerturbation(shape={"asphere_6": 1e-9})
    found = compile_system(asphere, 0.532, surface_perturbations={0: change})
    assert found.shapes[0].term("asphere_6") == pytest.approx(2.1e-8, rel=1e-12)


def test_a_surface_turns_about_its_own_vertex_before_the_lens_turns_about_its_pivot(paper_lens: Lens) -> None:
    system = compile_system(
        paper_lens,
        0.532,
        Pose(tilt_x_deg=90.0, pivot_z_mm=9.7),
        {1: SurfacePerturbation(tilt_y_deg=10.0, decenter_x_mm=0.5)},
    )
    assert system.vertex[0, 1] == pytest.approx([0.5, 0.0, 9.7], abs=1e-14)
    assert system.vertex[0, 0] == pytest.approx([0.0, 9.7, 9.7], abs=1e-14)
    own = Pose(tilt_y_deg=10.0).transform()[0][0]
    whole = Pose(tilt_x_deg=90.0).transform()[0][0]
    assert np.allclose(system.rotation[0, 1], whole @ own, atol=1e-15)
    assert system.tilted.all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({2: SurfacePerturbation()}, "there is no surface 2; allowed: 0 to 1"),
        ({1: SurfacePerturbation(radius_mm=12.0)}, "surface 2: a radius_mm delta of 12 or beyond"),
        (
            {1: SurfacePerturbation(shape={"conic_x": 0.1})},
            r"surface 2: conic_x is no parameter of its shape \(conic\); allowed: radius_mm, conic",
        ),
        ({1: SurfacePerturbation(conic=3.0)}, r"surface 2: .*semi_diameter_mm of 10"),
        (
            {0: SurfacePerturbation(index=np.zeros(2)), 1: SurfacePerturbation(conic=np.zeros(3))},
            "one length",
        ),
    ],
)
def test_perturbations_that_make_no_lens_are_refused(
    paper_lens: Lens, changes: dict[int, SurfacePerturbation], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        compile_system(paper_lens, 0.532, surface_perturbations=changes)


def test_the_radius_of_a_plane_cannot_change(paper_lens: Lens) -> None:
    lens = paper_lens.with_surface(0, radius_mm=None)
    with pytest.raises(InputError, match="surface 1 is a plane"):
        compile_system(lens, 0.532, surface_perturbations={0: SurfacePerturbation(radius_mm=0.1)})


def test_the_kernel_gets_only_what_the_surfaces_need(paper_lens: Lens) -> None:
    codes, formulas, _, _, figures = compile_system(paper_lens, 0.532).for_kernel
    assert codes is None
    assert figures is None
    assert not any(formulas)
    figure = surface_figure_from_zernike({5: 1.0}, 30.0)
    changed = {1: SurfacePerturbation(figure=figure)}
    codes, formulas, _, _, figures = compile_system(
        paper_lens, 0.532, surface_perturbations=changed
    ).for_kernel
    assert codes is not None
    assert not codes.any()
    assert figures is not None
    assert figures[0].tolist() == [0, 0, 1]
    assert not any(formulas)
    asphere = paper_lens.with_surface(1, asphere=(1e-5,))
    _, formulas, _, _, _ = compile_system(asphere, 0.532).for_kernel
    assert [len(formula) for formula in formulas if formula] == [4]
