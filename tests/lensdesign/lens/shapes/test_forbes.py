"""Forbes aspheres against the published polynomials, their orthogonality, and even aspheres."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import eval_jacobi

from lensdesign import InputError, Lens, Surface, trace
from lensdesign.lens.shapes.expanded import ExpandedShape
from lensdesign.lens.shapes.forbes import MOST_Q_TERMS, qbfs_polynomials, qcon_polynomials

U2 = np.linspace(0.0, 1.0, 41)


def test_qcon_are_the_jacobi_polynomials_of_forbes_2007() -> None:
    for m, polynomial in enumerate(qcon_polynomials()):
        np.testing.assert_allclose(polynomial(U2), eval_jacobi(m, 0, 4, 2.0 * U2 - 1.0), atol=1e-9)


def test_qbfs_are_those_that_forbes_2007_lists() -> None:
    x = U2
    listed = [
        np.ones_like(x),
        (13 - 16 * x) / math.sqrt(19),
        math.sqrt(2 / 95) * (29 - 4 * x * (25 - 19 * x)),
        math.sqrt(2 / 2545) * (207 - 4 * x * (315 - x * (577 - 320 * x))),
        (7737 - 16 * x * (4653 - 2 * x * (7381 - 8 * x * (1168 - 509 * x)))) / (3 * math.sqrt(131831)),
    ]
    for polynomial, wanted in zip(qbfs_polynomials(), listed, strict=False):
        np.testing.assert_allclose(polynomial(x), wanted, atol=1e-12)


def test_slopes_of_qbfs_are_orthonormal_with_the_weight_of_forbes_2007() -> None:
    """The mean of products of derivatives by u, of u^2 (1 - u^2) Q, over the angle of u = sin(angle)."""
    angle = (np.arange(4000) + 0.5) / 4000 * 0.5 * math.pi
    u = np.sin(angle)
    step = 1e-30j
    slopes = [
        ((u + step) ** 2 * (1 - (u + step) ** 2) * polynomial((u + step) ** 2)).imag / 1e-30
        for polynomial in qbfs_polynomials()
    ]
    gram = np.array([[np.mean(one * other) for other in slopes] for one in slopes])
    np.testing.assert_allclose(gram, np.eye(MOST_Q_TERMS) * gram[0, 0], atol=1e-9)


@pytest.mark.parametrize("name", ["Qcon", "Qbfs"])
def test_the_sag_is_that_of_the_definition(name: str) -> None:
    q, c, norm = (0.05, -0.02, 0.01, 0.003), 1.0 / 9.0, 4.0
    surface = Surface(shape=name, radius_mm=9.0, normalization_radius_mm=norm, q_mm=q)
    r = norm * np.sqrt(U2)
    root = np.sqrt(1.0 - c * c * r * r)
    polynomials = qcon_polynomials() if name == "Qcon" else qbfs_polynomials()
    total = sum(a * p(U2) for a, p in zip(q, polynomials, strict=False))
    factor = U2**2 if name == "Qcon" else U2 * (1.0 - U2) / root
    np.testing.assert_allclose(surface.sag_mm(r), c * r * r / (1.0 + root) + factor * total, atol=1e-15)


def test_the_vertex_of_a_qbfs_has_another_radius_than_its_sphere() -> None:
    surface = Surface(shape="Qbfs", radius_mm=9.0, normalization_radius_mm=4.0, q_mm=(0.05, -0.02))
    r = 1e-4
    assert surface.curvature == pytest.approx(2.0 * float(surface.sag_mm(r)) / r**2, rel=1e-6)
    assert surface.sag_mm(4.0) == pytest.approx(float(Surface(radius_mm=9.0).sag_mm(4.0)))


@pytest.mark.parametrize("name", ["Qcon", "Qbfs"])
def test_ten_terms_are_traced_to_the_sag_of_the_definition(paper_lens: Lens, name: str) -> None:
    """Strong departures, rays up to the rim."""
    rng = np.random.default_rng(4)
    q = tuple(0.05 * rng.standard_normal(MOST_Q_TERMS) / (1.0 + np.arange(MOST_Q_TERMS)))
    surface = Surface(shape=name, radius_mm=9.0, normalization_radius_mm=4.0, q_mm=q)
    front = surface.replaced(thickness_mm=9.7, material="N-BK7", semi_diameter_mm=4.0)
    lens = paper_lens.replaced(
        surfaces=(front, paper_lens.surfaces[1].replaced(stop=True, semi_diameter_mm=4.0))
    )
    y = np.linspace(-3.95, 3.95, 61)
    origins = np.column_stack([0.3 * y[::-1], 0.95 * y, np.full(61, -20.0)])
    directions = np.tile([0.01, -0.02, math.sqrt(1.0 - 5e-4)], (61, 1))
    found = trace(lens, origins, directions, 0.532, clip=False, record_hits=True)
    assert found.hits is not None
    points = found.hits[:, 0]
    assert np.all(np.isfinite(points))
    r2 = np.sum(points[:, :2] ** 2, axis=1)
    terms = surface.shape.traced.terms
    powers = sum(abs(term) * r2**j for j, term in enumerate(terms[2:], 2))
    error = np.abs(points[:, 2] - surface.shape.sag(points[:, 0], points[:, 1]))
    # The powers of a Qcon, up to 4,000 mm here, cancel each other, which no trace can do without rounding.
    assert np.all(error <= 1e-12 + 4.0 * np.finfo(float).eps * powers)


def test_a_normalization_radius_is_needed() -> None:
    with pytest.raises(ValueError, match="normalization_radius_mm: a surface of shape Qcon needs one"):
        Surface(shape="Qcon", radius_mm=9.0, q_mm=(0.01,))
    with pytest.raises(ValueError, match=r"q_mm .* a surface of shape conic has none"):
        Surface(radius_mm=9.0, q_mm=(0.01,))


def test_a_shape_with_all_keys_is_proposed() -> None:
    with pytest.raises(
        ValueError, match=r'conic = -0\.5: a surface of shape Qbfs has none; write shape = "Qcon"'
    ):
        Surface(shape="Qbfs", radius_mm=9.0, conic=-0.5, normalization_radius_mm=4.0, q_mm=(0.01,))


def test_apertures_where_the_formula_has_no_meaning_are_refused() -> None:
    keys = {"shape": "Qbfs", "radius_mm": 9.0, "q_mm": (0.01,) * 10}
    with pytest.raises(ValueError, match=r"Qbfs ends at 9 mm.* use a smaller one"):
        Surface(**keys, normalization_radius_mm=8.0, semi_diameter_mm=9.0)
    with pytest.raises(ValueError, match="more than 2 times larger"):
        Surface(**keys, normalization_radius_mm=2.0, semi_diameter_mm=5.0)
    with pytest.raises(ValueError, match="normalization_radius_mm = 1e-58: too small"):
        Surface(**keys, normalization_radius_mm=1e-58)


def test_a_qcon_has_any_normalization_radius_and_a_qbfs_its_own() -> None:
    qcon = Surface(shape="Qcon", radius_mm=9.0, normalization_radius_mm=4.0, q_mm=(0.05, -0.02, 0.01)).shape
    r = np.linspace(0.0, 4.0, 9)
    assert isinstance(qcon, ExpandedShape)
    other = qcon.renormalized(3.7)
    np.testing.assert_allclose(other.sag(0.0, r), qcon.sag(0.0, r), atol=1e-15)
    assert not np.allclose(other.terms, qcon.terms)
    qbfs = Surface(shape="Qbfs", radius_mm=9.0, normalization_radius_mm=4.0, q_mm=(0.05,)).shape
    assert isinstance(qbfs, ExpandedShape)
    with pytest.raises(InputError, match="has no other normalization radius"):
        qbfs.renormalized(3.999)


def test_a_zemax_file_holds_a_qcon_as_an_even_asphere_of_seven_terms() -> None:
    surface = Surface(shape="Qcon", radius_mm=9.0, normalization_radius_mm=4.0, q_mm=(0.01, 0.002))
    kind, values = surface.shape.zemax()
    assert kind == "EVENASPH"
    r = np.linspace(0.0, 4.0, 9)
    powers = sum(value * r ** (2 * n) for n, value in values.items())
    np.testing.assert_allclose(surface.sag_mm(r), Surface(radius_mm=9.0).sag_mm(r) + powers, atol=1e-14)
    long = surface.replaced(q_mm=(0.01,) * 8)
    with pytest.raises(InputError, match=r"asphere terms; a \.zmx file holds 7"):
        long.shape.zemax()
