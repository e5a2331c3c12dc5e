"""A lens as flat arrays for one wavelength, the input of the ray kernels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.files.surface_coatings import compile_coatings
from lensdesign.files.surface_figures import surface_figure
from lensdesign.lens.coatings.coating import NO_FILMS, has_films
from lensdesign.lens.coatings.compiled import CompiledCoating
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation, Value, trial_count
from lensdesign.lens.shapes.base import Shape, term_of
from lensdesign.lens.shapes.intersection import SagError, sag_and_slopes
from lensdesign.lens.shapes.registry import FormulaLengths, code_of, needed_formulas, padded_count
from lensdesign.lens.surface import Surface
from lensdesign.lens.surface_figure import SurfaceFigure, packed_surface_figures
from lensdesign.raytrace.plane_plate import PlanePlate, cover_plate


@dataclass(frozen=True)
class CompiledSystem:
    """Flat arrays of one lens, or of many perturbed copies of it, at one wavelength.

    Every array has a leading trial axis of length `trials`, or of length 1 if all trials are equal.

    Attributes
    ----------
    trials : int or None
        Number of perturbed copies; None for a single lens (results then have no trial axis).
    rotation : ndarray, shape (trials or 1, surfaces, 3, 3)
        Rotation from each surface's own frame to the fixed frame.
    vertex : ndarray, shape (trials or 1, surfaces, 3)
        Vertices in mm in the fixed frame.
    shapes : tuple of Shape, one for each surface
        Shapes without figures, each with terms for all trials or for each trial.
    index : ndarray, shape (trials or 1, surfaces + 1)
        Refractive index before the first and behind each surface.
    semi_diameter : ndarray, shape (surfaces,)
        Clear semi-diameters in mm; inf if a surface clips no ray.
    tilted : ndarray of bool, shape (surfaces,)
        Whether the surface is rotated in any trial.
    figures : tuple of tuple of SurfaceFigure, one for each surface
        Sag errors that are added to the shape, each for all trials or for each trial.
    coatings : tuple of CompiledCoating, one for each surface
        Coatings as the light meets them. They do not change the rays.
    index_beyond : ndarray, shape (trials or 1, surfaces), or None
        For light that is reflected: the index of the medium on the other side of each surface that reflects,
        and NaN for one that transmits. None if all surfaces transmit.
    cover_glass : PlanePlate or None
        Cover glass of the sensor, through which rays to a plane behind the lens pass.
    """

    trials: int | None
    rotation: Array
    vertex: Array
    shapes: tuple[Shape, ...]
    index: Array
    semi_diameter: Array
    tilted: NDArray[np.bool_]
    figures: tuple[tuple[SurfaceFigure, ...], ...]
    coatings: tuple[CompiledCoating, ...]
    index_beyond: Array | None = None
    cover_glass: PlanePlate | None = None

    @property
    def surfaces(self) -> int:
        """Number of surfaces."""
        return len(self.semi_diameter)

    def part(self, first: int, stop: int) -> CompiledSystem:
        """Return the surfaces from index `first` to before `stop`, at least one, at their positions."""
        some = slice(first, stop)
        return replace(
            self,
            rotation=np.ascontiguousarray(self.rotation[:, some]),
            vertex=np.ascontiguousarray(self.vertex[:, some]),
            shapes=self.shapes[some],
            index=np.ascontiguousarray(self.index[:, first : stop + 1]),
            semi_diameter=self.semi_diameter[some],
            tilted=self.tilted[some],
            figures=self.figures[some],
            coatings=self.coatings[some],
            index_beyond=None if self.index_beyond is None else self.index_beyond[:, some],
        )

    @cached_property
    def packed_shapes(self) -> tuple[NDArray[np.int8], Array, Array]:
        """Code, starting conic and terms of each shape, for the kernels.

        Their array shapes are (surfaces,), (trials or 1, surfaces, 2) and (trials or 1, surfaces, n).
        """
        shapes = [shape.traced for shape in self.shapes]
        trials = max((len(s.terms) for s in shapes if s.terms.ndim > 1), default=1)
        terms = np.zeros((trials, self.surfaces, max(s.terms.shape[-1] for s in shapes)))
        starts = np.zeros((trials, self.surfaces, 2))
        for i, shape in enumerate(shapes):
            terms[:, i, : shape.terms.shape[-1]] = shape.terms
            starts[:, i] = np.stack(shape.start(np.moveaxis(shape.terms, -1, 0)), axis=-1)
        return np.array([code_of(shape) for shape in shapes], np.int8), starts, terms

    @cached_property
    def for_kernel(
        self,
    ) -> tuple[NDArray[np.int8] | None, FormulaLengths, Array, Array, tuple[NDArray, ...] | None]:
        """Packed shapes, with the formulas that they need, and figures for the ray kernel.

        Codes and figures are None if no surface needs them.
        """
        codes, starts, terms = self.packed_shapes
        if np.any(codes):
            own, count = terms, terms.shape[-1]
            terms = np.zeros((*own.shape[:-1], padded_count(count)))
            terms[..., :count] = own
        formulas = needed_formulas(codes.tobytes(), terms.shape[-1])
        if not any(self.figures):
            return codes if np.any(codes) else None, formulas, starts, terms, None
        packed = packed_surface_figures(self.figures)
        return (
            codes,
            formulas,
            starts,
            terms,
            (packed.first, packed.layout, packed.per_mm, packed.coefficients),
        )

    def without_cover_glass(self) -> CompiledSystem:
        """Return the system without cover glass, for planes in air between the lens and the sensor."""
        return self if self.cover_glass is None else replace(self, cover_glass=None)

    @property
    def rotational(self) -> bool:
        """True if the system is rotationally symmetric about the axis of the nominal lens."""
        moved = np.any(self.tilted) or np.any(self.vertex[..., :2])
        return not (moved or any(self.figures)) and all(shape.ROTATIONAL for shape in self.shapes)

    def sag_error(self, surface: int) -> SagError | None:
        """Return the sag error of a surface in its own frame (first trial) as a function, or None."""
        figures = [figure.trial(0) for figure in self.figures[surface]]
        if not figures:
            return None

        def total(x: Array, y: Array) -> tuple[Array, Array, Array]:
            z, dx, dy = (sum(a) for a in zip(*(f.sag_and_slopes(x, y) for f in figures), strict=True))
            return z, dx, dy

        return total

    def sag(self, surface: int, x: Array, y: Array) -> Array:
        """Return the sag in mm at (x, y) in the surface's own frame, including its figure, first trial."""
        nominal = self.shapes[surface].trial(0).sag(x, y)
        return sum((figure.trial(0).sag(x, y) for figure in self.figures[surface]), nominal)

    def sag_and_slopes(self, surface: int, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return the sag in mm and the slopes along x and y, as in :meth:`sag`."""
        return sag_and_slopes(self.shapes[surface].trial(0), x, y, self.sag_error(surface))


def compile_system(
    lens: Lens,
    wavelength_um: float,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
) -> CompiledSystem:
    """Return a lens as flat arrays for ray tracing.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength.
    pose
        Pose of the whole lens (default: nominal); its pivot is measured from the front vertex.
    surface_perturbations
        Perturbations of single surfaces by index from 0 (default: none). They act before the pose of the
        whole lens.

    Raises
    ------
    InputError
        If a surface does not exist, a perturbed radius is 0 or changes sign, a perturbed surface ends inside
        its aperture, trial arrays differ in length, or a measured figure cannot be read.
    MaterialError
        If the index of a glass is not known at the wavelength.
    """
    changes = dict(surface_perturbations or {})
    count = len(lens.surfaces)
    for i in changes:
        if not 0 <= i < count:
            raise InputError(
                f"surface_perturbations: there is no surface {i}; allowed: 0 to {count - 1}, for "
                f"surface 1 to surface {count}"
            )
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
        figures=tuple(_surface_figures(lens, i, changes.get(i)) for i in range(count)),
        coatings=_coatings(lens, wavelength_um, changes),
        cover_glass=cover_plate(lens, wavelength_um),
    )


def _coatings(
    lens: Lens, wavelength_um: float, changes: Mapping[int, SurfacePerturbation]
) -> tuple[CompiledCoating, ...]:
    """Return the coatings of all surfaces with the errors of their thicknesses."""
    coatings = list(compile_coatings(lens, wavelength_um))
    for i, change in changes.items():
        if np.any(change.coating_thickness_percent):
            if not has_films(lens.surfaces[i].coating):
                raise InputError(f"surface {i + 1}: coating_thickness_percent: {NO_FILMS}")
            error = 0.01 * np.asarray(change.coating_thickness_percent)
            if np.any(error <= -1.0):
                raise InputError(
                    f"surface {i + 1}: coating_thickness_percent = {100.0 * float(np.min(error)):g}: must be "
                    "above -100"
                )
            coatings[i] = coatings[i].with_thickness_error(error[..., None])
    return tuple(coatings)


def _surface_figures(lens: Lens, i: int, change: SurfacePerturbation | None) -> tuple[SurfaceFigure, ...]:
    """Return the measured figure of a surface and the figure of its perturbation, if any."""
    surface, added = lens.surfaces[i], None if change is None else change.figure
    if added is not None and added.semi_diameter_mm < (surface.semi_diameter_mm or 0.0):
        raise InputError(
            f"surface {i + 1}: the perturbation's figure is known over a semi-diameter of "
            f"{added.semi_diameter_mm:g} mm, less than the surface's of {surface.semi_diameter_mm:g} mm"
        )
    return tuple(f for f in (surface_figure(surface), added) if f is not None)


def _deltas(changes: Mapping[int, SurfacePerturbation], name: str, count: int, offset: int = 0) -> Array:
    """Return one kind of deviation of all surfaces, shape (trials or 1, count + offset)."""
    columns = {i: np.atleast_1d(np.asarray(getattr(c, name), float)) for i, c in changes.items()}
    trials = max((len(c) for c in columns.values()), default=1)
    result = np.zeros((trials, count + offset))
    for i, column in columns.items():
        result[:, i + offset] = column
    return result


def _shape(lens: Lens, i: int, change: SurfacePerturbation | None) -> Shape:
    """Return the perturbed shape of a surface."""
    surface, nominal = lens.surfaces[i], lens.surfaces[i].shape
    deltas = {} if change is None else change.shape_deltas()
    if not deltas:
        return nominal
    terms = np.tile(nominal.terms, (*np.broadcast_shapes(*map(np.shape, deltas.values())), 1))
    for parameter, delta in deltas.items():
        if parameter not in surface.shape_parameters:
            allowed = ", ".join(surface.shape_parameters)
            raise InputError(
                f"surface {i + 1}: {parameter} is no parameter of its shape ({nominal.NAME}); allowed: "
                f"{allowed}"
            )
        position = nominal.term_index(term_of(parameter))
        if parameter.startswith("radius"):
            terms[..., position] = 1.0 / _radius(surface, i, parameter, delta)
        else:
            terms[..., position] += delta
    shape = replace(nominal, terms=terms)
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
        raise InputError(
            f"surface {i + 1}: a {parameter} delta of {-nominal:g} or beyond reverses the sign of the "
            f"radius; use a smaller one"
        )
    return radius


def _frames(lens: Lens, pose: Pose, changes: Mapping[int, SurfacePerturbation]) -> tuple[Array, Array]:
    """Return rotation and vertex of every surface in the fixed frame."""
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


def _stack(arrays: list[Array]) -> Array:
    """Return arrays of shape (trials or 1, ...) stacked along a new second axis."""
    trials = max(len(a) for a in arrays)
    full = np.empty((trials, len(arrays), *arrays[0].shape[1:]))
    for k, array in enumerate(arrays):
        full[:, k] = array
    return full
