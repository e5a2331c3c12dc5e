"""Odd aspheres against their power series, and what cannot hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensdesign import InputError, Lens, Surface, read_zmx, write_seq, write_zmx
from lensdesign.manufacture.drawing.sheets import lens_drawing

R = np.linspace(0.0, 5.0, 21)


def odd(*coefficients: float, **keys: float) -> Surface:
    return Surface.model_validate({"shape": "odd asphere", "odd_asphere": coefficients, **keys})


def test_sag_of_powers_alone() -> None:
    surface = odd(1e-3, 2e-4, -3e-5)
    assert np.allclose(surface.sag_mm(R), 1e-3 * R**3 + 2e-4 * R**4 - 3e-5 * R**5, rtol=1e-13)
    assert np.allclose(surface.slope(R), 3e-3 * R**2 + 8e-4 * R**3 - 15e-5 * R**4, rtol=1e-13)


def test_even_powers_alone_make_an_even_asphere() -> None:
    keys = {"radius_mm": 12.0, "conic": -0.4}
    even = Surface(**keys, asphere=(1e-5, 2e-7)).shape
    x, y = np.linspace(-3.0, 3.0, 9), np.linspace(0.0, 4.0, 9)
    for found, wanted in zip(
        odd(0.0, 1e-5, 0.0, 2e-7, **keys).shape.second_derivatives(x, y),
        even.second_derivatives(x, y),
        strict=True,
    ):
        np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-16)


def test_at_the_vertex_it_has_the_curvature_of_its_conic() -> None:
    xx, xy, yy = odd(1e-3, radius_mm=10.0).shape.second_derivatives(0.0, 0.0)
    assert (float(xx), float(xy), float(yy)) == (0.1, 0.0, 0.1)


def test_files_hold_what_they_have_a_place_for(paper_lens: Lens, tmp_path: Path) -> None:
    lens = paper_lens.with_surface(1, shape_type="odd asphere", odd_asphere=(1e-6, 0.0, 1e-8))
    write_zmx(lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text(encoding="utf-16")
    assert "TYPE ODDASPHE" in text
    assert "PARM 3 1e-06" in text
    assert read_zmx(tmp_path / "lens.zmx").lens == lens
    with pytest.raises(InputError, match=r"surface 2.*\.seq.*odd asphere"):
        write_seq(lens, tmp_path / "lens.seq")
    with pytest.raises(InputError, match=r"up to r\^8"):
        write_zmx(lens.with_surface(1, odd_asphere=(0.0,) * 6 + (1e-12,)), tmp_path / "lens.zmx")


def test_a_first_power_is_named_when_a_file_has_one(paper_lens: Lens, tmp_path: Path) -> None:
    lens, path = paper_lens.with_surface(1, shape_type="odd asphere", odd_asphere=(1e-6,)), tmp_path / "a.zmx"
    write_zmx(lens, path)
    text = path.read_text(encoding="utf-16").replace("PARM 1 0.0", "PARM 1 0.01")
    path.write_text(text, encoding="utf-16")
    with pytest.raises(InputError, match=r"odd asphere term in r of 0\.01"):
        read_zmx(path)


def test_a_drawing_states_its_formula(paper_lens: Lens) -> None:
    surface = paper_lens.with_surface(1, shape_type="odd asphere", odd_asphere=(1e-6, 0.0, 1e-8))
    drawn = surface.surfaces[1].shape.drawn()
    assert drawn.formula == "B_3 r^3 + … + B_5 r^5"
    assert dict(drawn.constants) == {"B_3": 1e-6, "B_4": 0.0, "B_5": 1e-8}
    assert lens_drawing(surface)
