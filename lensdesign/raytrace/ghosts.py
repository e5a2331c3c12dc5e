"""Ghosts: light that is reflected twice between two surfaces of a lens before it leaves.

The ray kernels refract alone. A reflection is a refraction into the negative of the index in front: Snell's
law then gives the reflected direction with its sign turned, and every way back is a negative one through a
negative index, so that optical paths stay positive. A ghost is therefore a lens of its own, whose surfaces
stand in the order in which light meets them; see R. Kingslake and R. B. Johnson, "Lens Design Fundamentals"
(2010).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.raytrace.compiled import CompiledSystem


def ghost_system(system: CompiledSystem, front: int = 0, back: int = 1) -> CompiledSystem:
    """The lens that light meets which is reflected at a surface, then at one in front of it, and then leaves.

    Directions between both reflections point along +z all the same: the light goes the other way.

    Parameters
    ----------
    system
        The lens without reflections.
    front, back
        Surfaces, from 0, that reflect: `back` first.

    Raises
    ------
    InputError
        If there are no such two surfaces.
    """
    count = system.surfaces
    if not 0 <= front < back < count:
        raise InputError(
            f"ghost between surfaces {front + 1} and {back + 1}: must be two of 1 to {count}, the front one "
            "first"
        )
    order = ghost_order(count, front, back)
    return replace(
        system,
        rotation=np.ascontiguousarray(system.rotation[:, order]),
        vertex=np.ascontiguousarray(system.vertex[:, order]),
        shapes=tuple(system.shapes[i] for i in order),
        index=np.ascontiguousarray(ghost_indices(system.index, front, back)),
        semi_diameter=system.semi_diameter[order],
        tilted=system.tilted[order],
        figures=tuple(system.figures[i] for i in order),
    )


def ghost_order(count: int, front: int = 0, back: int = 1) -> list[int]:
    """Surfaces of a lens of `count`, from 0, in the order in which the ghost's light meets them."""
    return [*range(back + 1), *range(back - 1, front - 1, -1), *range(front + 1, count)]


def ghost_indices(index: Array, front: int = 0, back: int = 1) -> Array:
    """Of the media that it goes through, negative on the way back; media along the last axis."""
    there, again = index[..., : back + 1], index[..., front + 1 :]
    return np.concatenate([there, -index[..., back:front:-1], again], axis=-1)
