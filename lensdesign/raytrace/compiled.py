"""A lens as flat arrays for one wavelength: what the ray kernels loop over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.files.figures import surface_figure
from lensdesign.lens.figure import SurfaceFigure, packed_figures
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation, Value, trial_count
from lensdesign.lens.shapes.base import Shape, term_of
from lensdesign.lens.shapes.intersection import Figure, sag_and_slopes
from lensdesign.lens.shapes.registry import code_of
from lensdesign.lens.surface import Surface


@dataclass(frozen=True)
class CompiledSystem:
    """Flat arrays of one lens, or of many perturbed copies of it, at one wavelength.

    Every array has a leading trial axis of length `trials`, or of length 1 where all trials agree.

    Attributes
    ----------
    trials : int or None
        Number of perturbed copies; None for a single lens (results then have no trial axis).
    rotation : ndarray, shape (trials or 1, surfaces, 3, 3)
        From each surface's own frame to the fixed one.
    vertex : ndarray, shape (trials or 1, surfaces, 3)
        Vertices in mm in the fixed frame.
    shapes : tuple of Shape, one for each surface
        Without figures; each one for all trials, or one for each.
    index : ndarray, shape (trials or 1, surfaces + 1)
        Refractive index before the first and behind each surface.
    semi_diameter : ndarray, shape (surfaces,)
        Clear semi-diameters in mm; inf where a surface clips nothing.
    tilted : ndarray of bool, shape (surfaces,)
        Whether any trial turns this surface.
    figures : tuple of tuple of SurfaceFigure, one for each surface
        Sag errors that add to the surface's shape; each one for all trials, or one for each.
    """

    trials: int | None
    rotation: Array
    vertex: Array
    shapes: tuple[Shape, ...]
    index: Array
    semi_diameter: Array
    tilted: NDArray[np.bool_]
    figures: tuple[tuple[SurfaceFigure, ...], ...]

    @property
    def surfaces(self) -> int:
        """Number of surfaces."""
        return len(self.semi_diameter)

    @cached_property
    def packed_shapes(self) -> tuple[NDArray[np.int8], Array, Array]:
        """Number, starting conic and terms of each shape, for the kernels.

        Of shapes (surfaces,), (trials or 1, surfaces, 2) and (trials or 1, surfaces, n).
        """
        trials = max((len(s.terms) for s in self.shapes if s.terms.ndim > 1), default=1)
        terms = np.zeros((trials, self.surfaces, max(s.terms.shape[-1] for s in self.shapes)))
        starts = np.zeros((trials, self.surfaces, 2))
        for i, shape in enumerate(self.shapes):
            terms[:, i, : shape.terms.shape[-1]] = shape.terms
            starts[:, i] = np.stack(shape.start(np.moveaxis(shape.terms, -1, 0)), axis=-1)
        return np.array([code_of(shape) for shape in self.shapes], np.int8), starts, terms

    @cached_property
    def for_kernel(self) -> tuple[NDArray[np.int8] | None, Array, Array, tuple[NDArray, ...] | None]:
        """The packed shapes and figures as the ray kernel takes them: None for what no surface needs."""
        codes, starts, terms = self.packed_shapes
        if not any(self.figures):
            return codes if np.any(codes) else None, starts, terms, None
        packed = packed_figures(self.figures)
        return codes, starts, terms, (packed.first, packed.layout, packed.per_mm, packed.coefficients)

    @property
    def rotational(self) -> bool:
        """Whether all is one of revolution about the axis of the lens as it was designed."""
        moved = np.any(self.tilted) or np.any(self.vertex[..., :2])
        return not (moved or any(self.figures)) and all(shape.ROTATIONAL for shape in self.shapes)

    def figure(self, surface: int) -> Figure | None:
        """Sag error and slopes of a surface over (x, y) in its own frame, first trial; None without any."""
        parts = [figure.trial(0) for figure in self.figures[surface]]
        if not parts:
            return None

        def total(x: Array, y: Array) -> tuple[Array, Array, Array]:
            z, dx, dy = (sum(a) for a in zip(*(p.sag_and_slopes(x, y) for p in parts), strict=True))
            return z, dx, dy

        return total

    def sag(self, surface: int, x: Array, y: Array) -> Array:
        """Height of a surface in mm over (x, y) in its own frame, figure included, first trial."""
        nominal = self.shapes[surface].trial(0).sag(x, y)
        return sum((figure.trial(0).sag(x, y) for figure in self.figures[surface]), nominal)

    def sag_and_slopes(self, surface: int, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """As :meth:`sag`, with the slopes along x and y."""
        return sag_and_slopes(self.shapes[surface].trial(0), x, y, self.figure(surface))


def compile_system(
    lens: Lens,
    wavelength_um: float,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
) -> CompiledSystem:
    """Lay a lens out as arrays.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength.
    pose
        Pose of the whole lens; its pivot is measured from the front vertex.
    surface_perturbations
        Deltas of single surfaces, by index from 0; they act before the pose of the whole lens.

    Raises
    ------
    InputError
        If a surface does not exist, a perturbed radius is 0, a perturbed surface ends inside its
        aperture, trial arrays differ in length, or a measured figure cannot be read.
    MaterialError
        If a glass is not known at the wavelength.
    """
    changes = dict(surface_perturbations or {})
    count = len(lens.surfaces)
    for i in changes:
        if not 0 <= i < count:
            raise InputError(f"surface_perturbations: there is no surface {i}; allowed: 0 to {count - 1}")
    trials = trial_count(pose, *changes.values())
    rotation, vertex = _frames(lens, pose, changes)
    semi = np.array([np.inf if s.semi_diameter_mm is None else s.semi_diameter_mm for s in lens.surfaces])
    index = lens.indices(wavelength_um)[None] + _deltas(changes, "index", count, offset=1)
    return CompiledSystem(
        trials=trials,
        rotation=rotation,
        vertex=vertex,
        shapes=tuple(_shape(lens, i, changes.get(i)) for i in range(count)),
        index=index,
        semi_diameter=semi,
        tilted=np.any(rotation != np.eye(3), axis=(0, 2, 3)),
        figures=tuple(_figures(lens, i, changes.get(i)) for i in range(count)),
    )


def _figures(lens: Lens, i: int, change: SurfacePerturbation | None) -> tuple[SurfaceFigure, ...]:
    """The measured figure of a surface, and that of its perturbation."""
    surface, added = lens.surfaces[i], None if change is None else change.figure
    if added is not None and added.semi_diameter_mm < (surface.semi_diameter_mm or 0.0):
        raise InputError(
            f"surface {i + 1}: the perturbation's figure is known over a semi-diameter of "
            f"{added.semi_diameter_mm:g} mm, less than the surface's of {surface.semi_diameter_mm:g} mm"
        )
    return tuple(f for f in (surface_figure(surface), added) if f is not None)


def _deltas(changes: Mapping[int, SurfacePerturbation], name: str, count: int, offset: int = 0) -> Array:
    """One kind of delta as an array of shape (trials or 1, count + offset)."""
    columns = {i: np.atleast_1d(np.asarray(getattr(c, name), float)) for i, c in changes.items()}
    trials = max((len(c) for c in columns.values()), default=1)
    result = np.zeros((trials, count + offset))
    for i, column in columns.items():
        result[:, i + offset] = column
    return result


def _shape(lens: Lens, i: int, change: SurfacePerturbation | None) -> Shape:
    """The shape of a surface as perturbed."""
    surface, nominal = lens.surfaces[i], lens.surfaces[i].shape
    deltas = {} if change is None else change.of_shape()
    if not deltas:
        return nominal
    terms = np.tile(nominal.terms, (*np.broadcast_shapes(*map(np.shape, deltas.values())), 1))
    for parameter, delta in deltas.items():
        if parameter not in surface.shape_parameters:
            held = ", ".join(surface.shape_parameters)
            raise InputError(
                f"surface {i + 1}: {parameter} is no parameter of its shape ({nominal.NAME}); it has {held}"
            )
        place = nominal.place(term_of(parameter))
        if parameter.startswith("radius"):
            terms[..., place] = 1.0 / _radius(surface, i, parameter, delta)
        else:
            terms[..., place] += delta
    shape = type(nominal)(terms)
    smallest = shape.edge_radius_mm
    if surface.semi_diameter_mm is not None and smallest < surface.semi_diameter_mm:
        raise InputError(
            f"surface {i + 1}: the perturbed conic ends at a radial height of {smallest:.6g} mm, "
            f"inside its semi_diameter_mm of {surface.semi_diameter_mm:g}"
        )
    return shape


def _radius(surface: Surface, i: int, parameter: str, delta: Value) -> Array:
    nominal = getattr(surface, parameter)
    if nominal is None:
        raise InputError(f"surface {i + 1} is a plane: a change of its {parameter} has no meaning")
    radius = np.asarray(nominal + delta)
    if np.any(radius * nominal <= 0.0):
        raise InputError(f"surface {i + 1}: a {parameter} delta of {-nominal:g} or past it turns it over")
    return radius


def _frames(lens: Lens, pose: Pose, changes: Mapping[int, SurfacePerturbation]) -> tuple[Array, Array]:
    """Rotation and vertex of every surface in the fixed frame."""
    count = len(lens.surfaces)
    thickness = _deltas(changes, "thickness_mm", count)
    behind = np.cumsum(thickness, axis=1) - thickness
    lens_rotation, lens_shift = pose.transform()
    rotations, vertices = [], []
    for i, z in enumerate(lens.vertex_z_mm):
        rotation, shift = (
            changes[i].pose().transform() if i in changes else (np.eye(3)[None], np.zeros((1, 3)))
        )
        vertex = shift + np.array([0.0, 0.0, 1.0]) * (z + behind[:, i])[:, None]
        rotations.append(lens_rotation @ rotation)
        vertices.append(np.einsum("tij,tj->ti", lens_rotation, vertex) + lens_shift)
    return _stack(rotations), _stack(vertices)


def _stack(parts: list[Array]) -> Array:
    """Stack parts of shape (trials or 1, ...) along a new second axis."""
    trials = max(len(p) for p in parts)
    wide = [np.broadcast_to(p, (trials, *p.shape[1:])) for p in parts]
    return np.ascontiguousarray(np.stack(wide, axis=1))
