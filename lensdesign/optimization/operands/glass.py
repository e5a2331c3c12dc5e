"""Operands of the geometry: thicknesses, slopes, edges of conics and overall lengths."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lensdesign.analysis.outline import highest_ground_mm
from lensdesign.common.arrays import Array
from lensdesign.lens.glass import is_gap
from lensdesign.lens.shapes.base import Shape, directions
from lensdesign.lens.solid import SHARP
from lensdesign.optimization.operands.operand import Operand, State, finite_operand
from lensdesign.optimization.specification.specification import Specification

SEMI_DIAMETER_STEP_MM = 0.01
"""Step to which semi-diameters are rounded up if the specification does not state them."""

Height = tuple[float, Array]
"""A radial height in mm, and its derivatives by all variables."""


def glass_operands(specification: Specification, state: State) -> list[Operand]:
    """Return the operands of thicknesses, slopes, edges of conics and overall lengths."""
    lens, limits = state.lens, specification.constraints
    heights = [_clear_height(state, i) for i in range(len(lens.surfaces))]
    edge = max(heights, key=lambda h: h[0])
    rows = []
    # Largest radial height of a surface relative to the height at which its conic ends.
    conic_edge_fraction = 0.95
    for i, surface in enumerate(lens.surfaces):
        for section, end in enumerate(surface.shape.ends()):
            by = _by(state, i, partial(_end_by, surface.shape, section))[0] * edge[0] ** 2
            value = float(end) * edge[0] ** 2 - conic_edge_fraction**2
            name = f"edge of the conic of surface {i + 1}"
            rows.append(
                finite_operand(name, np.array([value]), (by + 2.0 * float(end) * edge[0] * edge[1])[None])
            )
        rows.append(_slope_row(state, i, heights[i], limits.max_edge_slope_deg))
        if i + 1 == len(lens.surfaces):
            continue
        glass = not is_gap(surface.material)
        least = limits.min_edge_thickness_mm if glass else limits.min_air_gap_mm
        scale = specification.surfaces[i].thickness_mm or 1.0
        at = _ground_height(state, i, heights[i : i + 2]) if glass else edge
        ends = _ends_at(state, i, at, heights[i : i + 2])
        rows.append(_gap_row(f"edge thickness behind surface {i + 1}", state, i, ends, least, scale))
        least = limits.min_center_thickness_mm if glass else limits.min_air_gap_mm
        gap, by = _thickness(state, i)
        name = f"centre thickness behind surface {i + 1}"
        rows.append(finite_operand(name, np.array([(least - gap) / scale]), -by[None] / scale))
    return rows + _length_rows(specification, state)


def lens_thickness(state: State) -> tuple[float, Array]:
    """Return the distance from the first vertex to the last in mm, and its derivatives."""
    return state.lens.exit_vertex_z_mm, np.array([float(v.kind == "thickness") for v in state.variables])


def track(state: State) -> tuple[float, Array]:
    """Return the distance from the object to the last sensor plane in mm, and its derivatives."""
    spaces = ("thickness", "working_distance")
    return state.lens.track_mm, np.array([float(v.kind in spaces) for v in state.variables])


def _length_rows(specification: Specification, state: State) -> list[Operand]:
    limits, rows = specification.constraints, []
    for name, most, found in (
        ("lens thickness", limits.max_lens_thickness_mm, lens_thickness),
        ("track", limits.max_track_mm, track),
    ):
        if most is not None:
            length, by = found(state)
            rows.append(finite_operand(name, np.array([length / most - 1.0]), by[None] / most))
    return rows


def _thickness(state: State, i: int) -> tuple[float, Array]:
    """Return the axial thickness behind a surface, and its derivatives by all variables."""
    by = np.array([float(v.kind == "thickness" and v.surface == i) for v in state.variables])
    return state.lens.surfaces[i].thickness_mm or 0.0, by


def _ground_height(state: State, i: int, clear: Sequence[Height]) -> Height:
    """Return the radius of the edge cylinder behind a surface, and its derivatives by all variables.

    It is that of the design file, or else a continuous upper bound of the radius in the drawing. The
    drawing's diameter is rounded up in steps and jumps with the size of the part, so it has no useful
    derivatives.
    """
    edges, lens = state.lens.edges, state.lens
    edge = edges[lens.glass_fronts.index(i)] if edges and i in lens.glass_fronts else SHARP
    if edge.semi_diameter_mm is not None:
        return edge.semi_diameter_mm, np.zeros(len(state.variables))
    height, by = max(clear, key=lambda h: h[0])
    thickness, thickness_by = _thickness(state, i)
    ground, by_height, by_thickness = highest_ground_mm(height, thickness)
    bevel = max(leg for _, leg in edge.sides())
    return ground + bevel, by_height * by + by_thickness * thickness_by


def _ends_at(state: State, i: int, ground: Height, clear: Sequence[Height]) -> tuple[Height, Height]:
    """Return the heights at which the two surfaces of a space end.

    A conic that ends between the clear apertures and the ground edge continues as a flat ring. A conic that
    ends inside a clear aperture is excluded by another operand.
    """
    shapes = (surface.shape for surface in state.lens.surfaces[i : i + 2])
    largest = max(height for height, _ in clear)
    front, back = (
        own if largest <= shape.edge_radius_mm < ground[0] else ground
        for shape, own in zip(shapes, clear, strict=True)
    )
    return front, back


def _slope_row(state: State, i: int, height: tuple[float, Array], limit_deg: float) -> Operand:
    """Return the operand of the slope at the clear edge, in each direction."""
    shape = state.lens.surfaces[i].shape
    limit = math.tan(math.radians(limit_deg)) ** 2
    ux, uy = directions(shape)
    x, y = height[0] * ux, height[0] * uy
    _, *slopes = shape.sag_and_slopes(x, y)
    xx, xy, yy = shape.second_derivatives(x, y)
    outward = slopes[0] * (xx * ux + xy * uy) + slopes[1] * (xy * ux + yy * uy)
    by = _by(state, i, partial(_slope_square_by, shape, x, y, slopes)) + 2.0 * outward[:, None] * height[1]
    values = (slopes[0] ** 2 + slopes[1] ** 2) / limit - 1.0
    return finite_operand(f"slope at the edge of surface {i + 1}", values, by / limit)


def _gap_row(
    name: str, state: State, i: int, heights: tuple[Height, Height], least: float, scale: float
) -> Operand:
    """Return the operand of the space between a height on its front and one on its back, by direction."""
    shapes = [s.shape for s in state.lens.surfaces[i : i + 2]]
    ux, uy = directions(*shapes)
    thickness, by = _thickness(state, i)
    gap = np.full(np.shape(ux), thickness)
    for k, (shape, (height, height_by), sign) in enumerate(zip(shapes, heights, (-1.0, 1.0), strict=True)):
        x, y = height * ux, height * uy
        sag, *slopes = shape.sag_and_slopes(x, y)
        outward = slopes[0] * ux + slopes[1] * uy
        gap = gap + sign * sag
        by = by + sign * (_by(state, i + k, partial(_sag_by, shape, x, y)) + outward[:, None] * height_by)
    return finite_operand(name, (least - gap) / scale, -by / scale)


def _sag_by(shape: Shape, x: Array, y: Array, term: str) -> Array:
    return shape.derivatives_by(term, x, y)[0]


def _slope_square_by(shape: Shape, x: Array, y: Array, slopes: Sequence[Array], term: str) -> Array:
    by = shape.derivatives_by(term, x, y)[1:]
    return 2.0 * (slopes[0] * by[0] + slopes[1] * by[1])


def _end_by(shape: Shape, section: int, term: str) -> Array:
    """Return the derivative of the end of a section by complex step, exact to rounding."""
    return np.array([shape.moved(term, 1e-30j).ends()[section].imag / 1e-30])


def edge_sag(state: State, i: int) -> tuple[float, Array]:
    """Return the mean sag along the rim of a clear aperture, and its derivatives by all variables."""
    shape, (height, height_by) = state.lens.surfaces[i].shape, _clear_height(state, i)
    ux, uy = directions(shape)
    x, y = height * ux, height * uy
    sag, *slopes = shape.sag_and_slopes(x, y)
    outward = slopes[0] * ux + slopes[1] * uy
    by = _by(state, i, partial(_sag_by, shape, x, y)) + outward[:, None] * height_by
    return float(np.mean(sag)), np.mean(by, axis=0)


def _clear_height(state: State, i: int) -> tuple[float, Array]:
    """Return the clear semi-diameter of a surface, with derivatives: as given, the stop's, or its rays'.

    Rounding up is assumed to add a whole step, so that thickness and slope are valid for any rounding. Rays
    at other temperatures pass the expanded surface.
    """
    stop = state.traces[0]
    if i == state.lens.stop_index:
        return stop.stop_semi_diameter_mm, stop.stop_semi_diameter_by
    given = state.lens.surfaces[i].semi_diameter_mm
    if given is not None:
        return given, np.zeros(len(state.variables))
    best = (0.0, np.zeros(len(state.variables)))
    for one in state.all:
        factor = 1.0 if one.expansion_factors is None else float(one.expansion_factors[i])
        for trace in one.traces:
            x, y = trace.heights[:, i, 0], trace.heights[:, i, 1]
            squares = np.where(trace.ok, x * x + y * y, 0.0)
            worst = int(np.argmax(squares))
            height = math.sqrt(squares[worst])
            if height and height / factor + SEMI_DIAMETER_STEP_MM > best[0]:
                by = trace.heights[worst, i] @ trace.heights_by[worst, i]
                best = (height / factor + SEMI_DIAMETER_STEP_MM, by / (height * factor))
    return best


def _by(state: State, i: int, derivative: Callable[[str], Array]) -> Array:
    """Return derivatives, shape (..., v), by all variables of a quantity of one surface's shape."""
    own = {j: derivative(v.kind) for j, v in enumerate(state.variables) if v.is_shape_term and v.surface == i}
    found = np.zeros((len(next(iter(own.values()), np.zeros(1))), len(state.variables)))
    for j, values in own.items():
        found[:, j] = values
    return found
