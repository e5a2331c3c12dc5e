"""The lens at other temperatures: what heat does to surfaces, spaces and indices, as their deltas."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.catalogues.thermal import REFERENCE_C
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import term_of
from lensdesign.lens.surface import Surface
from lensdesign.lens.temperature import growth, heated_keys, heated_material


def heat_deltas(
    lens: Lens, change_c: Array, mount_expansion_per_k: float, wavelength_um: float
) -> Iterator[tuple[int, str, Array]]:
    """Deltas of surfaces at temperatures, as perturbations know them: surface, parameter, shape (trials,).

    Clear apertures stay as they are: rays are clipped where they are in the nominal lens.

    Parameters
    ----------
    lens
        The nominal lens.
    change_c : ndarray, shape (trials,)
        Temperatures, from that at which the design holds.
    mount_expansion_per_k
        Of what holds the spaces of air.
    wavelength_um
        Of the light.

    Raises
    ------
    MaterialError
        If it is not known what heat does to a glass.
    """
    grown, indices = growth(lens, mount_expansion_per_k), lens.indices(wavelength_um)
    shifts, places = np.unique(change_c, return_inverse=True)
    for i, surface in enumerate(lens.surfaces):
        shares = (grown.surfaces_per_k[i] * shifts).tolist()
        moved = [surface.replaced(**heated_keys(surface, share)) for share in shares]
        for name in surface.shape_parameters:
            values = np.array([_value(one, name) - _value(surface, name) for one in moved])
            if np.any(values):
                yield i, name, values[places]
        if i < len(lens.surfaces) - 1:
            yield i, "thickness_mm", float(grown.thickness_mm_per_k[i]) * change_c
        hot = [heated_material(lens, i, REFERENCE_C + shift) for shift in shifts.tolist()]
        changes = [
            0.0 if m is None else refractive_index(m, wavelength_um, lens.glass_catalogs) - indices[i + 1]
            for m in hot
        ]
        if np.any(changes):
            yield i, "index", np.array(changes)[places]


def heat_shifts_mm(lens: Lens, change_c: Array, mount_expansion_per_k: float) -> tuple[Array, Array]:
    """How much farther object and planes are at temperatures, shapes (trials,) and (trials, planes).

    The object from the front vertex; the planes from where they stand in the nominal lens, since the exit
    vertex, from which they are measured, moves with the thicknesses.
    """
    grown = growth(lens, mount_expansion_per_k)
    planes = grown.planes_mm_per_k + grown.thickness_mm_per_k.sum()
    return grown.object_mm_per_k * change_c, change_c[:, None] * planes


def _value(surface: Surface, parameter: str) -> float:
    """What a surface has of a parameter of its shape; 0 for the radius of a plane, which stays one."""
    if parameter in surface.shape_class.KEYS:
        return float(getattr(surface, parameter) or 0.0)
    shape = surface.shape
    return float(shape.terms[..., shape.TERMS.index(term_of(parameter))])
