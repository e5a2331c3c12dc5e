"""Thermal perturbations: deltas of surfaces, spaces and refractive indices at other temperatures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.catalogues.thermal import REFERENCE_C
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import term_of
from lensdesign.lens.shapes.expanded import ExpandedShape
from lensdesign.lens.surface import Surface
from lensdesign.lens.temperature import heated_keys, heated_material, thermal_expansion


def heat_deltas(
    lens: Lens, change_c: Array, mount_expansion_per_k: float, wavelength_um: float
) -> Iterator[tuple[int, str, Array]]:
    """Yield the deltas of surfaces at other temperatures.

    Clear apertures keep their nominal size, so rays are clipped as in the nominal lens.

    Parameters
    ----------
    lens
        The nominal lens.
    change_c : ndarray, shape (trials,)
        Temperature differences from the temperature of the design.
    mount_expansion_per_k
        Coefficient of linear expansion of the mount, which sets the air spaces.
    wavelength_um
        Vacuum wavelength.

    Yields
    ------
    tuple
        Surface index, name of the delta, and values of shape (trials,).

    Raises
    ------
    MaterialError
        If the thermal data of a glass are unknown.
    """
    expansion, indices = thermal_expansion(lens, mount_expansion_per_k), lens.indices(wavelength_um)
    shifts, inverse = np.unique(change_c, return_inverse=True)
    for i, surface in enumerate(lens.surfaces):
        strains = (expansion.surfaces_per_k[i] * shifts).tolist()
        heated = [_heated(surface, i, strain) for strain in strains]
        for name in surface.shape_parameters:
            values = np.array([_value(one, name) - _value(surface, name) for one in heated])
            if np.any(values):
                yield i, name, values[inverse]
        if i < len(lens.surfaces) - 1:
            yield i, "thickness_mm", float(expansion.thickness_mm_per_k[i]) * change_c
        hot = [heated_material(lens, i, REFERENCE_C + shift) for shift in shifts.tolist()]
        changes = [
            0.0 if m is None else refractive_index(m, wavelength_um, lens.glass_catalogs) - indices[i + 1]
            for m in hot
        ]
        if np.any(changes):
            yield i, "index", np.array(changes)[inverse]


def _heated(surface: Surface, index: int, strain: float) -> Surface:
    """Return the expanded surface; a Forbes asphere keeps its normalization radius, which is no parameter."""
    heated = surface.replaced(**heated_keys(surface, strain))
    shape, radius_mm = heated.shape, surface.normalization_radius_mm
    if radius_mm is None:
        return heated
    assert isinstance(shape, ExpandedShape)
    try:
        terms = shape.renormalized(radius_mm).terms
    except InputError as error:
        raise InputError(
            f'surface {index + 1}: a study cannot change its temperature: {error}; use shape = "Qcon" '
            "for this surface"
        ) from None
    return heated.replaced(
        normalization_radius_mm=radius_mm, q_mm=tuple(terms[len(terms) - len(surface.q_mm) :].tolist())
    )


def heat_shifts_mm(lens: Lens, change_c: Array, mount_expansion_per_k: float) -> tuple[Array, Array]:
    """Return the thermal shifts of the object and of the sensor planes, away from the lens.

    Returns
    -------
    object_mm : ndarray, shape (trials,)
        Change of the distance between the object and the front vertex.
    planes_mm : ndarray, shape (trials, planes)
        Shift of each plane from its nominal position. It includes the motion of the exit vertex, from which
        plane distances are measured and which moves with the thicknesses.
    """
    expansion = thermal_expansion(lens, mount_expansion_per_k)
    planes = expansion.planes_mm_per_k + expansion.thickness_mm_per_k.sum()
    return expansion.object_mm_per_k * change_c, change_c[:, None] * planes


def _value(surface: Surface, parameter: str) -> float:
    """Return a shape parameter of a surface; 0 for the radius of a plane, which stays a plane."""
    if parameter in surface.shape_class.KEYS:
        return float(getattr(surface, parameter) or 0.0)
    shape = surface.shape
    return float(shape.terms[..., shape.TERMS.index(term_of(parameter))])
