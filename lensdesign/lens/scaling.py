"""A lens at another size, for example a small twin on which wave optics is fast, or with another stop."""

from __future__ import annotations

import math

from lensdesign.common.frozen_model import FrozenModel
from lensdesign.errors import DesignError
from lensdesign.lens.cover_glass import CoverGlass
from lensdesign.lens.edges import Edge
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface


def scaled(lens: Lens, factor: float) -> Lens:
    """Return a lens with all lengths scaled, including those of object space and sensor planes.

    The cover glass of the sensor scales too. Numerical aperture, angles, glasses, coatings, wavelengths and
    the pixel pitch stay. The largest spread angle and the resolution therefore stay too. The number of pixels
    and the space-bandwidth product scale with the areas. A figure given by Zernike coefficients scales in
    size and in sag error; a figure in a grid file cannot be scaled.

    Parameters
    ----------
    lens
        Any lens.
    factor
        Factor by which lengths are multiplied.

    Returns
    -------
    Lens
        The scaled lens.

    Raises
    ------
    DesignError
        If the factor is not finite and above 0, the figure of a surface is in a grid file, or the result is
        not a valid lens.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> twin = scaled(lens, 1 / 32)
    >>> twin.object.field_diameter_mm, twin.sensor.pixels, twin.sensor.pixel_pitch_um
    (0.09375, (292, 219), 3.2)
    """
    if not (math.isfinite(factor) and factor > 0.0):
        raise DesignError(f"scale factor = {factor!r}: must be finite and greater than 0")
    return lens.replaced(
        surfaces=tuple(_surface(surface, factor) for surface in lens.surfaces),
        object=lens.object.replaced(
            field_diameter_mm=factor * lens.object.field_diameter_mm,
            working_distance_mm=factor * lens.object.working_distance_mm,
        ),
        sensor=lens.sensor.replaced(
            plane_distances_mm=tuple(factor * distance for distance in lens.sensor.plane_distances_mm),
            pixels=tuple(max(1, round(factor * count)) for count in lens.sensor.pixels),
            cover_glass=_cover_glass(lens, factor),
        ),
        edges=tuple(scaled_edge(edge, factor) for edge in lens.edges),
    )


def stopped_down(lens: Lens, numerical_aperture: float) -> Lens:
    """Return the lens with its stop closed to a numerical aperture, in proportion to the tangents.

    Parameters
    ----------
    lens
        Any lens.
    numerical_aperture
        New numerical aperture, above 0 and at most that of the lens.

    Raises
    ------
    DesignError
        If the numerical aperture is not in that range.
    """
    largest = lens.object.numerical_aperture
    if not 0.0 < numerical_aperture <= largest:
        raise DesignError(
            f"numerical_aperture = {numerical_aperture!r}: must be above 0 and at most {largest:g}"
        )
    tangents = [math.tan(math.asin(na)) for na in (numerical_aperture, largest)]
    ratio = tangents[0] / tangents[1]
    stop = lens.stop_semi_diameter_mm * ratio
    surfaces = list(lens.surfaces)
    surfaces[lens.stop_index] = surfaces[lens.stop_index].replaced(semi_diameter_mm=stop)
    return lens.replaced(
        surfaces=tuple(surfaces), object=lens.object.replaced(numerical_aperture=numerical_aperture)
    )


def scaled_edge(edge: Edge, factor: float) -> Edge:
    """Return an edge with all its lengths scaled."""

    def times(section: FrozenModel) -> dict[str, float]:
        lengths = section.model_dump(exclude_none=True, exclude={"flange", "gate", "draft_deg"})
        return {name: factor * value for name, value in lengths.items()}

    flange = None if edge.flange is None else edge.flange.replaced(**times(edge.flange))
    gate = None if edge.gate is None else edge.gate.replaced(**times(edge.gate))
    return edge.replaced(**times(edge), flange=flange, gate=gate)


def _cover_glass(lens: Lens, factor: float) -> CoverGlass | None:
    glass = lens.sensor.cover_glass
    if glass is None:
        return None
    return glass.replaced(thickness_mm=factor * glass.thickness_mm, distance_mm=factor * glass.distance_mm)


def _surface(surface: Surface, factor: float) -> Surface:
    def times(value: float | None) -> float | None:
        return None if value is None else factor * value

    figure = surface.figure
    if figure is not None:
        if figure.file is not None:
            raise DesignError(
                f"the measured figure in {figure.file} cannot be scaled; give it as Zernike coefficients, or "
                "omit it"
            )
        figure = figure.replaced(
            semi_diameter_mm=times(figure.semi_diameter_mm),
            zernike_um=tuple((j, factor * a) for j, a in figure.zernike_um),
            zernike_waves_633nm=tuple((j, factor * a) for j, a in figure.zernike_waves_633nm),
        )
    return surface.replaced(
        **surface.shape_class.scaled_keys(surface.shape_keys, factor),
        thickness_mm=times(surface.thickness_mm),
        semi_diameter_mm=times(surface.semi_diameter_mm),
        figure=figure,
    )
