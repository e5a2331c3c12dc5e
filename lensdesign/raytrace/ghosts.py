"""Ghosts: light that is reflected twice between two surfaces of a lens before it leaves.

The ray kernels only refract. A reflection is a refraction into the negative of the index in front of the
surface: Snell's law then gives the reflected direction with the opposite sign. A backward path has a negative
length in a negative index, so optical path lengths stay positive. A ghost is therefore a lens of its own,
whose surfaces are in the order in which light reaches them.

References
----------
R. Kingslake and R. B. Johnson, "Lens Design Fundamentals", 2nd edition (2010).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.coatings.compiled import CompiledCoating
from lensdesign.raytrace.compiled import CompiledSystem


def ghost_system(system: CompiledSystem, front_index: int = 0, back_index: int = 1) -> CompiledSystem:
    """Return the equivalent lens for light that is reflected at two surfaces before it leaves.

    Directions between the reflections point along +z, although the light travels along -z.

    Parameters
    ----------
    system
        The lens without reflections.
    front_index, back_index
        Indices, from 0, of the surfaces that reflect; the light is reflected at `back_index` first.

    Raises
    ------
    InputError
        Unless 0 <= front_index < back_index and both surfaces exist.
    """
    count = system.surfaces
    if not 0 <= front_index < back_index < count:
        raise InputError(
            f"ghost between surfaces {front_index + 1} and {back_index + 1}: must be two surfaces from 1 to "
            f"{count}, the front one first"
        )
    order = ghost_order(count, front_index, back_index)
    return replace(
        system,
        rotation=np.ascontiguousarray(system.rotation[:, order]),
        vertex=np.ascontiguousarray(system.vertex[:, order]),
        shapes=tuple(system.shapes[i] for i in order),
        index=np.ascontiguousarray(ghost_indices(system.index, front_index, back_index)),
        semi_diameter=system.semi_diameter[order],
        tilted=system.tilted[order],
        figures=tuple(system.figures[i] for i in order),
        coatings=_ghost_coatings(system, order, front_index, back_index),
        index_beyond=_index_beyond(system.index, front_index, back_index),
    )


def _ghost_coatings(
    system: CompiledSystem, order: list[int], front_index: int, back_index: int
) -> tuple[CompiledCoating, ...]:
    """Return the coatings in the order of the ghost's light path; on the backward path they are turned."""
    backward = range(back_index + 1, back_index + 1 + back_index - front_index)
    coatings = [system.coatings[i] for i in order]
    return tuple(c.turned() if position in backward else c for position, c in enumerate(coatings))


def _index_beyond(index: Array, front_index: int, back_index: int) -> Array:
    """Return the index on the other side of both surfaces that reflect, and NaN for the others."""
    count = index.shape[-1] - 1
    result = np.full((*index.shape[:-1], len(ghost_order(count, front_index, back_index))), np.nan)
    result[..., back_index] = index[..., back_index + 1]
    result[..., 2 * back_index - front_index] = index[..., front_index]
    return result


def ghost_order(count: int, front_index: int = 0, back_index: int = 1) -> list[int]:
    """Return the surface indices of a lens of `count` surfaces in the order of the ghost's light path."""
    return [
        *range(back_index + 1),
        *range(back_index - 1, front_index - 1, -1),
        *range(front_index + 1, count),
    ]


def ghost_indices(index: Array, front_index: int = 0, back_index: int = 1) -> Array:
    """Return the indices along the ghost's light path, negative on the backward path.

    The media of `index` and of the result are along the last axis.
    """
    first_pass, second_pass = index[..., : back_index + 1], index[..., front_index + 1 :]
    return np.concatenate([first_pass, -index[..., back_index:front_index:-1], second_pass], axis=-1)
