"""What glass must keep: thicknesses, slopes, the edges of conics, lengths of the whole."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import Shape, directions
from lensdesign.optimization.asked.specification import Specification
from lensdesign.optimization.rows.row import Row, State, finite_row, heights_of

SEMI_DIAMETER_STEP_MM = 0.01
"""Semi-diameters that a specification leaves open are rounded up to this."""

CONIC_EDGE_SHARE = 0.95
"""Surfaces stay within this share of the radial height at which their conic ends."""


def glass_rows(specification: Specification, state: State) -> list[Row]:
    """Thicknesses, slopes and the edges of conics."""
    lens, limits = state.lens, specification.constraints
    heights = [_clear_height(state, i) for i in range(len(lens.surfaces))]
    edge = max(heights, key=lambda h: h[0])
    rows = []
    for i, surface in enumerate(lens.surfaces):
        for part, end in enumerate(surface.shape.ends()):
            by = _by(state, i, partial(_end_by, surface.shape, part))[0] * edge[0] ** 2
            value = float(end) * edge[0] ** 2 - CONIC_EDGE_SHARE**2
            name = f"edge of the conic of surface {i + 1}"
            rows.append(
                finite_row(name, np.array([value]), (by + 2.0 * float(end) * edge[0] * edge[1])[None])
            )
        rows.append(_slope_row(state, i, heights[i], limits.max_edge_slope_deg))
        if i + 1 == len(lens.surfaces):
            continue
        glass = surface.material is not None
        least = limits.min_edge_thickness_mm if glass else limits.min_air_gap_mm
        scale = specification.surfaces[i].thickness_mm or 1.0
        at = _ground_height(lens, i, edge)
        rows.append(_gap_row(f"edge thickness behind surface {i + 1}", state, i, at, least, scale))
        least = limits.min_center_thickness_mm if glass else limits.min_air_gap_mm
        gap, by = _thickness(state, i)
        name = f"centre thickness behind surface {i + 1}"
        rows.append(finite_row(name, np.array([(least - gap) / scale]), -by[None] / scale))
    return rows + _length_rows(specification, state)


def lens_thickness(state: State) -> tuple[float, Array]:
    """From the first vertex to the last in mm, and its derivatives."""
    return state.lens.exit_vertex_z_mm, np.array([float(v.kind == "thickness") for v in state.variables])


def track(state: State) -> tuple[float, Array]:
    """From the object to the last sensor plane in mm, and its derivatives."""
    spaces = ("thickness", "working_distance")
    return state.lens.track_mm, np.array([float(v.kind in spaces) for v in state.variables])


def _length_rows(specification: Specification, state: State) -> list[Row]:
    limits, rows = specification.constraints, []
    for name, most, found in (
        ("lens thickness", limits.max_lens_thickness_mm, lens_thickness),
        ("track", limits.max_track_mm, track),
    ):
        if most is not None:
            length, by = found(state)
            rows.append(finite_row(name, np.array([length / most - 1.0]), by[None] / most))
    return rows


def _thickness(state: State, i: int) -> tuple[float, Array]:
    """Of the space behind a surface on the axis, and its derivatives by all variables."""
    by = np.array([float(v.kind == "thickness" and v.surface == i) for v in state.variables])
    return state.lens.surfaces[i].thickness_mm or 0.0, by


def _ground_height(lens: Lens, i: int, clear: tuple[float, Array]) -> tuple[float, Array]:
    """Radius of the edge cylinder behind a surface: the design file's, or else the largest clear height."""
    if not lens.edges or i not in lens.glass_fronts:
        return clear
    given = lens.edges[lens.glass_fronts.index(i)].semi_diameter_mm
    return clear if given is None else (given, np.zeros_like(clear[1]))


def _slope_row(state: State, i: int, height: tuple[float, Array], limit_deg: float) -> Row:
    """Of the steepest way over the surface, in each direction."""
    shape = state.lens.surfaces[i].shape
    limit = math.tan(math.radians(limit_deg)) ** 2
    ux, uy = directions(shape)
    x, y = height[0] * ux, height[0] * uy
    _, *slopes = shape.sag_and_slopes(x, y)
    xx, xy, yy = shape.second_derivatives(x, y)
    outward = slopes[0] * (xx * ux + xy * uy) + slopes[1] * (xy * ux + yy * uy)
    by = _by(state, i, partial(_slope_square_by, shape, x, y, slopes)) + 2.0 * outward[:, None] * height[1]
    values = (slopes[0] ** 2 + slopes[1] ** 2) / limit - 1.0
    return finite_row(f"slope at the edge of surface {i + 1}", values, by / limit)


def _gap_row(name: str, state: State, i: int, height: tuple[float, Array], least: float, scale: float) -> Row:
    """Of the space behind a surface at a radial height, in each direction."""
    front, back = (s.shape for s in state.lens.surfaces[i : i + 2])
    ux, uy = directions(front, back)
    x, y = height[0] * ux, height[0] * uy
    before, behind = (np.array(shape.sag_and_slopes(x, y)) for shape in (front, back))
    thickness, by = _thickness(state, i)
    by = by + _by(state, i + 1, partial(_sag_by, back, x, y)) - _by(state, i, partial(_sag_by, front, x, y))
    outward = (behind - before)[1] * ux + (behind - before)[2] * uy
    gap = thickness + behind[0] - before[0]
    return finite_row(name, (least - gap) / scale, -(by + outward[:, None] * height[1]) / scale)


def _sag_by(shape: Shape, x: Array, y: Array, term: str) -> Array:
    return shape.derivatives_by(term, x, y)[0]


def _slope_square_by(shape: Shape, x: Array, y: Array, slopes: Sequence[Array], term: str) -> Array:
    by = shape.derivatives_by(term, x, y)[1:]
    return 2.0 * (slopes[0] * by[0] + slopes[1] * by[1])


def _end_by(shape: Shape, part: int, term: str) -> Array:
    """By complex step, exact to rounding."""
    return np.array([shape.moved(term, 1e-30j).ends()[part].imag / 1e-30])


def edge_sag(state: State, i: int) -> tuple[float, Array]:
    """Mean sag of a surface along the rim of its clear aperture, and its derivatives by all variables."""
    shape, (height, height_by) = state.lens.surfaces[i].shape, _clear_height(state, i)
    ux, uy = directions(shape)
    x, y = height * ux, height * uy
    sag, *slopes = shape.sag_and_slopes(x, y)
    outward = slopes[0] * ux + slopes[1] * uy
    by = _by(state, i, partial(_sag_by, shape, x, y)) + outward[:, None] * height_by
    return float(np.mean(sag)), np.mean(by, axis=0)


def _clear_height(state: State, i: int) -> tuple[float, Array]:
    """Clear semi-diameter of a surface: as given, as the stop's, or as its rays need, rounded up.

    Rounding is taken to add a whole step: thickness and slope then hold for whatever it adds. What rays need
    at other temperatures, the surface has when it has grown.
    """
    stop = state.traces[0]
    if i == state.lens.stop_index:
        return stop.stop_semi_diameter_mm, stop.stop_semi_diameter_by
    given = state.lens.surfaces[i].semi_diameter_mm
    if given is not None:
        return given, np.zeros(len(state.variables))
    best = (0.0, np.zeros(len(state.variables)))
    for one in state.all:
        size = 1.0 if one.sizes is None else float(one.sizes[i])
        for trace in one.traces:
            squares, by = heights_of(trace, i)
            squares = np.where(trace.ok, squares, 0.0)
            worst = int(np.argmax(squares))
            height = math.sqrt(squares[worst])
            if height and height / size + SEMI_DIAMETER_STEP_MM > best[0]:
                best = (height / size + SEMI_DIAMETER_STEP_MM, by[worst] / (2.0 * height * size))
    return best


def _by(state: State, i: int, derivative: Callable[[str], Array]) -> Array:
    """Derivatives by all variables of what depends on the shape of one surface alone, shape (..., v)."""
    own = {j: derivative(v.kind) for j, v in enumerate(state.variables) if v.of_shape and v.surface == i}
    found = np.zeros((len(next(iter(own.values()), np.zeros(1))), len(state.variables)))
    for j, values in own.items():
        found[:, j] = values
    return found
