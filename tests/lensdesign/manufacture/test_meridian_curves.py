"""Meridians as curves of CAD files: as smooth and as close to the surface as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.surface import Surface
from lensdesign.manufacture.meridian_curves import asphere_spline


def test_spline_is_as_smooth_at_the_vertex_as_elsewhere() -> None:
    surface = Surface(radius_mm=15.0, conic=-0.5, asphere=(-3e-4, 5e-7))
    knots, points = asphere_spline(SurfaceMeridian(surface, 3.0, 9.0))
    spline = BSpline(knots, points, 5)
    # Odd derivatives of the sag and even ones of the radial height vanish on the axis.
    assert [spline.derivative(order)(0.0)[1] for order in (1, 3)] == pytest.approx([0.0, 0.0], abs=1e-7)
    assert [spline.derivative(order)(0.0)[0] for order in (2, 4)] == pytest.approx([0.0, 0.0], abs=1e-5)


def test_spline_error_is_what_it_was_asked_for() -> None:
    meridian = SurfaceMeridian(Surface(radius_mm=15.0, conic=-0.5, asphere=(-3e-4, 5e-7)), 0.0, 9.0)
    counts = []
    for asked in (1e-5, 1e-7, 1e-10):
        knots, points = asphere_spline(meridian, asked)
        found = BSpline(knots, points, 5)(np.linspace(0.0, 1.0, 5000))
        assert np.max(meridian.distances(found)) < 1.001 * asked
        counts.append(len(points))
    assert counts == sorted(set(counts))
    with pytest.raises(InputError, match="cannot be approximated within 1e-20 mm"):
        asphere_spline(meridian, 1e-20)
