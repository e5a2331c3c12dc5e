"""What every registered shape has to keep: a new one is tested by being registered."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_lenses import numbers, signed

from lensdesign import (
    InputError,
    Lens,
    Surface,
    load_design,
    read_seq,
    read_zmx,
    save_design,
    scaled,
    trace,
    write_seq,
    write_zmx,
)
from lensdesign.lens.shapes.base import Shape, parameter_of, term_of
from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.expanded import ExpandedShape
from lensdesign.lens.shapes.intersection import intersect
from lensdesign.lens.shapes.registry import (
    FORMULAS,
    SHAPES,
    class_with,
    code_of,
    formula_classes,
    needed_formulas,
    parameters,
    shape_class,
)
from lensdesign.raytrace.compiled import compile_system

EVERY = pytest.mark.parametrize("name", list(SHAPES))
STEP = 1e-30
REACH_MM = 3.0


def values_of(parameter: str) -> st.SearchStrategy[float]:
    """Values with which a surface ends nowhere near `REACH_MM`."""
    if parameter.startswith("radius"):
        return signed(9.0, 300.0)
    if parameter.startswith("conic"):
        return numbers(-3.0, 1.5)
    if parameter.startswith("q_"):
        return numbers(-0.02, 0.02)
    return numbers(-2e-5, 2e-5).map(lambda a: a * 10.0 ** (4 - int(parameter.rpartition("_")[2])))


@st.composite
def surfaces(draw: st.DrawFn, name: str) -> Surface:
    """Of one shape, with a few of its parameters drawn."""
    shape = shape_class(name)
    values: dict[str, Any] = {key: Surface.model_fields[key].default for key in shape.KEYS}
    if "normalization_radius_mm" in values:
        values["normalization_radius_mm"] = draw(numbers(REACH_MM, 2.0 * REACH_MM))
    for parameter in shape.PARAMETERS[:6]:
        value = draw(values_of(parameter))
        value = 1.0 / value if parameter.startswith("radius") else value
        values |= shape.changed_keys(values, term_of(parameter), value)
    return Surface.model_validate({**values, "shape": name})


def lens_of(lens: Lens, surface: Surface) -> Lens:
    """The paper's lens with another front."""
    front = surface.replaced(
        thickness_mm=9.7, material="N-BK7", semi_diameter_mm=REACH_MM, stop=lens.surfaces[0].stop
    )
    return lens.replaced(surfaces=(front, *lens.surfaces[1:]))


def assert_close(found: Any, wanted: Any, error: float) -> None:
    scale = max(1.0, float(np.max(np.abs(wanted))))
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=error * scale)


@EVERY
@given(data=st.data())
def test_derivatives_equal_complex_steps_of_the_sag(name: str, data: st.DataObject) -> None:
    shape = data.draw(surfaces(name)).shape
    x, y = data.draw(numbers(-REACH_MM, REACH_MM)), data.draw(numbers(-REACH_MM, REACH_MM))
    slopes = [shape.sag(x + 1j * STEP, y).imag / STEP, shape.sag(x, y + 1j * STEP).imag / STEP]
    assert_close(shape.sag_and_slopes(x, y)[1:], slopes, 1e-13)
    along_x, along_y = (
        np.array(shape.sag_and_slopes(x + 1j * STEP * i, y + 1j * STEP * (1 - i))).imag / STEP for i in (1, 0)
    )
    assert_close(shape.second_derivatives(x, y), [along_x[1], along_x[2], along_y[2]], 1e-13)
    for term in shape.TERMS[: len(shape.terms)]:
        wanted = np.array(shape.moved(term, 1j * STEP).sag_and_slopes(x, y)).imag / STEP
        # Powers of polynomials of a high order cancel at the rim.
        error = 1e-12 if isinstance(shape, ExpandedShape) else 1e-13
        assert_close(shape.derivatives_by(term, x, y), wanted, error)


@EVERY
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_rays_meet_the_surface(paper_lens: Lens, name: str, data: st.DataObject, seed: int) -> None:
    surface = data.draw(surfaces(name))
    rng = np.random.default_rng(seed)
    origins = np.column_stack([rng.uniform(-2, 2, (50, 2)), np.full(50, -10.0)])
    directions = rng.normal(size=(50, 3)) * [0.02, 0.02, 0.0] + [0.0, 0.0, 1.0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance, hit, converged = intersect(origins, directions, surface.shape)
    point = (origins + distance[:, None] * directions)[hit & converged]
    assert len(point) > 25
    assert_close(point[:, 2], surface.shape.sag(point[:, 0], point[:, 1]), 1e-12)
    lens = lens_of(paper_lens, surface)
    rays = trace(lens, origins, directions, 0.532, clip=False, record_hits=True)
    assert rays.hits is not None
    assert_close(rays.hits[hit & converged, 0], point, 1e-11)


@EVERY
@given(data=st.data(), factor=numbers(0.01, 100.0))
def test_a_scaled_surface_has_the_scaled_sag(name: str, data: st.DataObject, factor: float) -> None:
    surface = data.draw(surfaces(name))
    larger = surface.replaced(**surface.shape_class.scaled_keys(surface.shape_keys, factor)).shape
    x, y = np.array([0.0, 1.0, -2.0, 0.5]), np.array([1.0, 0.0, 1.5, -2.5])
    np.testing.assert_allclose(larger.sag(factor * x, factor * y), factor * surface.shape.sag(x, y), 1e-11)
    assert larger.edge_radius_mm == pytest.approx(factor * surface.shape.edge_radius_mm)


@EVERY
@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_files_give_the_surface_back(
    paper_lens: Lens, tmp_path: Path, name: str, data: st.DataObject
) -> None:
    lens = lens_of(paper_lens, data.draw(surfaces(name)))
    save_design(lens, tmp_path / "lens.toml")
    assert load_design(tmp_path / "lens.toml") == lens
    shape = lens.surfaces[0].shape
    for write, read, held, path in (
        (write_zmx, read_zmx, shape.zemax, tmp_path / "lens.zmx"),
        (write_seq, read_seq, shape.codev, tmp_path / "lens.seq"),
    ):
        if refuses(held):
            with pytest.raises(InputError, match=f"surface 1: a {path.suffix} file cannot hold"):
                write(lens, path)
            continue
        write(lens, path)
        found = read(path).lens.surfaces[0].shape
        x, y = np.linspace(-REACH_MM, REACH_MM, 9), np.linspace(0.0, REACH_MM, 9)
        assert np.array_equal(found.sag(x, y), shape.sag(x, y))
        assert found.kind in (shape.kind, shape.traced.kind)


def refuses(call: Callable[[], object]) -> bool:
    """Whether a call raises an InputError."""
    try:
        call()
    except InputError:
        return True
    return False


@EVERY
@given(data=st.data(), azimuth=numbers(0.0, 2.0 * math.pi))
def test_sections_have_the_sag_along_their_azimuth(name: str, data: st.DataObject, azimuth: float) -> None:
    shape = data.draw(surfaces(name)).shape
    section = shape.section(azimuth)
    r = np.linspace(0.0, REACH_MM, 7)
    x, y = r * math.cos(azimuth), r * math.sin(azimuth)
    sag, by_x, by_y = shape.sag_and_slopes(x, y)
    along = by_x * math.cos(azimuth) + by_y * math.sin(azimuth)
    for found, wanted in zip(section.sag_and_slope(r), (sag, along), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-13)
    if shape.ROTATIONAL:
        np.testing.assert_allclose(shape.sag(x, y), shape.sag(0.0, r), rtol=0.0, atol=1e-14)


@EVERY
@given(data=st.data())
def test_the_surface_ends_where_it_says(name: str, data: st.DataObject) -> None:
    shape = data.draw(surfaces(name)).shape
    edge = shape.edge_radius_mm
    angle = np.linspace(0.0, 2.0 * math.pi, 721)
    if math.isfinite(edge):
        assert np.all(np.isfinite(shape.sag(0.999 * edge * np.cos(angle), 0.999 * edge * np.sin(angle))))
        assert np.any(np.isnan(shape.sag(1.001 * edge * np.cos(angle), 1.001 * edge * np.sin(angle))))
    else:
        assert np.all(np.isfinite(shape.sag(1e3 * np.cos(angle), 1e3 * np.sin(angle))))


@EVERY
def test_a_shape_is_known_by_its_name_its_number_and_its_terms(name: str) -> None:
    shape = shape_class(name)
    assert name == shape.NAME
    assert shape.TERMS[0] == "curvature"
    assert set(shape.KEYS) <= set(Surface.model_fields)
    for parameter in shape.PARAMETERS:
        assert term_of(parameter) in shape.TERMS
        assert parameter_of(term_of(parameter)) == parameter
        assert parameter in parameters()
        assert term_of(parameter) in class_with(term_of(parameter)).TERMS


def test_the_code_of_a_formula_is_its_position_and_the_conic_is_the_first() -> None:
    assert [code_of(formula(np.zeros(2))) for formula in formula_classes()] == list(range(len(FORMULAS)))
    assert formula_classes()[0] is Conic


TERMS_OF_FORMULAS = {
    "conic": (0.08, -0.6),
    "even asphere": (-0.07, 0.4, 2e-4, -3e-6, 1e-8),
    "odd asphere": (0.06, -0.5, 1e-4, 2e-5, -1e-6),
    "biconic": (0.08, -0.3, -0.05, 0.6),
    "toroid": (0.07, -0.4, 0.11, 1e-4, -2e-6),
    "sphere with departure": (0.09, 2e-4, -1e-5, 3e-8),
}


@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(-4.0, 4.0),
    y=st.floats(-4.0, 4.0),
    above=st.floats(-0.3, 0.3),
    number=st.integers(0, len(FORMULAS) - 1),
)
def test_residual_and_normal_are_those_of_the_sag(x: float, y: float, above: float, number: int) -> None:
    shape = formula_classes()[number]
    terms = np.array(TERMS_OF_FORMULAS[shape.NAME])
    sag, by_x, by_y = shape.sag_and_gradient(terms, x, y)
    top, bottom, nx, ny, nz = shape.residual_and_normal(terms, x, y, sag + above)
    assert top / (bottom * nz) == pytest.approx(above, rel=1e-11, abs=1e-14)
    assert nx / nz == pytest.approx(-by_x, rel=1e-12, abs=1e-13)
    assert ny / nz == pytest.approx(-by_y, rel=1e-12, abs=1e-13)
    points = np.array([x, -x]), np.array([y, y]), np.array([sag, sag + above])
    assert np.shape(shape.residual_and_normal(terms, *points)[0]) == (2,)


def test_a_kernel_gets_the_formulas_of_its_surfaces_with_the_number_of_unrolled_terms() -> None:
    for code, (shape, counts) in enumerate(zip(formula_classes(), FORMULAS.values(), strict=True)):
        for terms in (2, 8, 12, 40):
            lengths = [len(formula) for formula in needed_formulas(bytes([0, code]), terms)]
            assert [number for number, length in enumerate(lengths, 1) if length] == [code] * (code > 0)
            if code and terms <= max(counts):
                assert lengths[code - 1] == min(
                    count for count in counts if count >= min(terms, len(shape.TERMS))
                )
            elif code and len(shape.TERMS) > max(counts):
                assert lengths[code - 1] not in counts


def test_many_copies_lie_along_a_leading_axis(paper_lens: Lens) -> None:
    shape: Shape = shape_class("conic")(np.array([[0.1, 0.0], [0.1, -1.0], [-0.1, 0.0]]))
    x = np.linspace(0.0, 4.0, 5)
    assert shape.sag(x, 0.0).shape == (3, 5)
    assert np.array_equal(shape.sag(x, 0.0)[1], shape.trial(1).sag(x, 0.0))
    assert shape.edge_radius_mm == pytest.approx(10.0)
    lens = scaled(paper_lens, 1.0)
    assert compile_system(lens, 0.532).packed_shapes[2].shape == (1, 2, 2)


def test_a_shape_without_such_a_term_says_so() -> None:
    with pytest.raises(InputError, match=r"asphere_4 is no term of this surface \(conic\); it has curvature"):
        Surface(radius_mm=10.0).shape.term_index("asphere_4")
