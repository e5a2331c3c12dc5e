"""Even aspheres against their power series."""

from __future__ import annotations

import numpy as np

from lensdesign import Surface

R = np.linspace(0.0, 5.0, 21)


def test_sag_of_powers_alone() -> None:
    assert np.allclose(Surface(asphere=(1e-3, 2e-5)).sag_mm(R), 1e-3 * R**4 + 2e-5 * R**6, rtol=1e-14)


def test_powers_add_to_the_conic() -> None:
    bare = Surface(radius_mm=12.0, conic=-0.4)
    whole = bare.replaced(asphere=(0.0, 3e-6))
    assert np.allclose(whole.sag_mm(R) - bare.sag_mm(R), 3e-6 * R**6, atol=1e-15)
    assert np.allclose(whole.slope(R) - bare.slope(R), 6.0 * 3e-6 * R**5, atol=1e-14)
    assert whole.shape.edge_radius_mm == bare.shape.edge_radius_mm
