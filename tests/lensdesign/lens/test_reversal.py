"""A lens turned around: twice is the lens itself, and light takes the same path backwards."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import Coating, CoatingLayer, DesignError, Surface, load_design
from lensdesign.analysis.paraxial import cardinal_points
from lensdesign.lens.reversal import reversed_surfaces


@pytest.mark.parametrize("name", ["paper_singlet", "moulded_pair", "phone_lens", "stock_pair", "wide_field"])
def test_twice_reversed_is_the_lens_itself(name: str) -> None:
    surfaces = load_design(DESIGNS / f"{name}.toml").surfaces
    assert reversed_surfaces(reversed_surfaces(surfaces)) == surfaces


@given(
    st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=4),
    st.floats(0.5, 5.0),
    st.floats(1.4, 1.9),
)
def test_focal_length_stays_and_focal_distances_change_places(
    curvatures: list[float], thickness_mm: float, index: float
) -> None:
    count = len(curvatures) - 1
    media = [index + 0.02 * k for k in range(count)]
    surfaces = [
        Surface(
            radius_mm=1.0 / c if abs(c) > 1e-6 else None,
            thickness_mm=thickness_mm * (1 + k) if k < count else None,
            material=media[k] if k < count else None,
        )
        for k, c in enumerate(curvatures)
    ]
    forward, backward = (
        cardinal_points(
            [s.curvature for s in group],
            [s.thickness_mm for s in group[:-1]],
            [1.0, *(s.material or 1.0 for s in group)],
        )
        for group in (surfaces, reversed_surfaces(surfaces))
    )
    if np.isfinite(forward.efl_mm):
        assert backward.efl_mm == pytest.approx(forward.efl_mm, rel=1e-9)
        assert backward.bfl_mm == pytest.approx(-forward.ffl_mm, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    "keys",
    [
        {"radius_mm": 20.0, "conic": -0.5},
        {"radius_mm": 20.0, "asphere": (1e-4, -2e-6)},
        {"radius_mm": 20.0, "radius_x_mm": 30.0, "shape": "biconic"},
        {"radius_mm": 20.0, "radius_x_mm": 30.0, "asphere": (1e-4,), "shape": "toroid"},
        {"radius_mm": 20.0, "odd_asphere": (1e-3, 1e-4, 1e-5), "shape": "odd asphere"},
        {"radius_mm": 20.0, "normalization_radius_mm": 5.0, "q_mm": (0.1, 0.02), "shape": "Qcon"},
        {"radius_mm": 20.0, "normalization_radius_mm": 5.0, "q_mm": (0.1, 0.02), "shape": "Qbfs"},
    ],
)
def test_every_shape_has_the_opposite_sag(keys: dict[str, object]) -> None:
    surface = Surface(**keys)
    (turned,) = reversed_surfaces([surface])
    x, y = np.array([0.0, 1.0, 3.0]), np.array([0.5, 2.0, 0.0])
    np.testing.assert_allclose(turned.shape.sag(x, y), -surface.shape.sag(x, y), rtol=1e-12)


def test_measured_figures_are_refused() -> None:
    surfaces = load_design(DESIGNS / "measured_singlet.toml").surfaces
    with pytest.raises(DesignError, match="figures"):
        reversed_surfaces(surfaces)


@pytest.mark.parametrize(("materials", "is_reversed"), [((None, None), True), (("N-BK7", None), False)])
def test_layers_between_equal_media_are_reversed(materials, is_reversed):
    coating = Coating(layers=tuple(CoatingLayer(index=n, thickness_nm=50.0) for n in (2.0, 1.4)))
    first = Surface(material=materials[0], thickness_mm=1.0, coating=coating)
    *_, last = reversed_surfaces((first, Surface(material=materials[1])))
    indices = [layer.index for layer in last.coating.layers]
    assert indices == ([1.4, 2.0] if is_reversed else [2.0, 1.4])
