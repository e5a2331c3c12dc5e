"""Combinations of the choices of glasses and stops in a specification."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from lensdesign.lens.lens import Lens
from lensdesign.optimization.specification.specification import Specification


def bases_of(specification: Specification) -> Iterator[tuple[str, Lens]]:
    """Yield the name and the start lens of each combination of glasses and stops."""
    choices = [v for v in specification.variables if v.discrete]
    for choice in itertools.product(*(v.choices for v in choices)):
        lens = specification.lens
        for variable, chosen in zip(choices, choice, strict=True):
            if variable.parameter == "stop":
                lens = with_stop(lens, int(chosen) - 1)
            else:
                lens = lens.with_surface((variable.surface or 1) - 1, material=chosen)
        name = ", ".join(str(s.material) for s in lens.surfaces if s.material is not None)
        if any(v.parameter == "stop" for v in choices):
            name += f", stop on surface {lens.stop_index + 1}"
        yield name, lens


def with_stop(lens: Lens, surface: int) -> Lens:
    """Return the lens with its stop, of the same size, on another surface (index from 0)."""
    if surface == lens.stop_index:
        return lens
    semi = lens.surfaces[surface].semi_diameter_mm or lens.stop_semi_diameter_mm
    surfaces = [
        s.model_copy(update={"stop": i == surface, "semi_diameter_mm": semi if i == surface else None})
        if i in (surface, lens.stop_index)
        else s
        for i, s in enumerate(lens.surfaces)
    ]
    return lens.replaced(surfaces=tuple(surfaces))
