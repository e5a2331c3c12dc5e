"""A sequence of surfaces turned around, so that its last surface meets the light first."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from lensdesign.errors import DesignError
from lensdesign.lens.coatings.coating import Coating, SurfaceCoating
from lensdesign.lens.glass import is_gap
from lensdesign.lens.surface import Surface


def reversed_surfaces(surfaces: Sequence[Surface]) -> tuple[Surface, ...]:
    """Return the surfaces of a lens in air in reverse order, each with its concave side exchanged.

    Clear semi-diameters and the stop stay with their surfaces.

    Parameters
    ----------
    surfaces
        Surfaces, front to back; the last one has no thickness.

    Raises
    ------
    DesignError
        If a surface has a measured figure or coating, which would have to be turned around, too.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/stock_pair.toml")
    >>> [surface.radius_mm for surface in reversed_surfaces(lens.surfaces[:2])]
    [25.75, None]
    """
    if any(surface.figure is not None for surface in surfaces):
        raise DesignError("surfaces with measured figures cannot be turned around; remove the figures")
    if any(isinstance(s.coating, Coating) and s.coating.file is not None for s in surfaces):
        raise DesignError("coatings with measured amplitudes cannot be turned around; remove them")
    spaces = [(front.thickness_mm, front.material) for front, _ in pairwise(surfaces)]
    behind = [*reversed(spaces), (None, None)]
    return tuple(
        surface.replaced(
            **mirrored_keys(surface),
            thickness_mm=thickness_mm,
            material=material,
            coating=_turned_coating(surface, is_gap(material)),
        )
        for surface, (thickness_mm, material) in zip(reversed(surfaces), behind, strict=True)
    )


def _turned_coating(surface: Surface, has_air_behind: bool) -> SurfaceCoating:
    """Return the coating of a surface that is turned around.

    Layers between two glasses, or between air and air, are reversed, since they are listed from the front.
    """
    coating = surface.coating
    if isinstance(coating, str) or is_gap(surface.material) != has_air_behind:
        return coating
    return coating.replaced(layers=coating.layers[::-1])


def mirrored_keys(surface: Surface) -> dict[str, object]:
    """Return the keys of a surface's shape with the opposite sag: all of its lengths times -1."""
    keys = surface.shape_class.scaled_keys(surface.shape_keys, -1.0)
    # The radial height stays, so odd powers of it change their sign, too, and its unit does not.
    if "odd_asphere" in keys:
        keys["odd_asphere"] = tuple(-coefficient for coefficient in surface.odd_asphere)
    if "normalization_radius_mm" in keys:
        keys["normalization_radius_mm"] = surface.normalization_radius_mm
    return keys
