"""Which lengths go with a lens: of its own file, of a simulation of it, and of the tolerances of it.

Ranges are relative to the lens, so that a lens of any size is judged alike. They are wide: a length is
questioned where nothing real has it, such as a decenter beyond the clear diameter.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace

from lensdesign.common.lengths import PIXEL_PITCH_UM, WAVELENGTH_UM, PlausibleLength, doubted_length
from lensdesign.lens.lens import Lens

FAR = 50.0
"""A length is too long if it is so many times all lengths of other kinds."""

WIDE = 12.0
"""The same of the field: seen from the lens, so wide a field reaches 80 degrees off the axis."""

FEW_LINES = 6.0
"""Number of the finest lines that an object has at least."""

LENS_MM = PlausibleLength(0.01, 2000.0, (0.1, 500.0))
"""Median length of a lens: a smaller one would be a few wavelengths wide, and none of glass is larger."""

LEAST_APERTURE = 1e-6
"""Numerical aperture below which none is told from a smaller one, so that its square divides."""

ANY = math.inf


class LongRadiusWarning(UserWarning):
    """A radius is so long that the surface is nearly a plane; a thousandth of it would be usual."""


@dataclass(frozen=True)
class LensLengths:
    """Lengths by which others are judged.

    Attributes
    ----------
    median_mm
        Of diameters, field, thicknesses of glass and working distance; a single wrong one moves it little.
    largest_mm
        Of the same and all distances; radii apart, which may have any length.
    clear_diameter_mm
        Of the widest surface.
    field_mm
        Diameter of the field.
    resolved_mm
        Finest line width that the numerical aperture passes.
    focal_depth_mm
        Wavelength over the square of the numerical aperture.
    wavelength_mm
        Of the light.
    working_distance_mm
        From the object to the lens.
    planes_mm
        Distances of the sensor planes.
    sensor_mm
        Longer side of the sensor.
    """

    median_mm: float
    largest_mm: float
    clear_diameter_mm: float
    field_mm: float
    resolved_mm: float
    focal_depth_mm: float
    wavelength_mm: float
    working_distance_mm: float
    planes_mm: tuple[float, ...]
    sensor_mm: float

    @classmethod
    def of(cls, lens: Lens, wavelength_um: float | None = None) -> LensLengths:
        """Those of a lens, in its first wavelength where none is given."""
        wavelength = 1e-3 * (lens.wavelengths_um[0] if wavelength_um is None else wavelength_um)
        aperture = max(lens.object.numerical_aperture, LEAST_APERTURE)
        diameters = _diameters(lens)
        field, distance = lens.object.field_diameter_mm, lens.object.working_distance_mm
        glass = [s.thickness_mm for s in lens.surfaces if s.thickness_mm and s.material is not None]
        spaces = [s.thickness_mm for s in lens.surfaces if s.thickness_mm and s.material is None]
        common = (*diameters, field, *glass, distance)
        planes = lens.sensor.plane_distances_mm
        return cls(
            median_mm=math.exp(statistics.median(map(math.log, common))),
            largest_mm=max(*common, *spaces, *planes),
            clear_diameter_mm=max(diameters),
            field_mm=field,
            resolved_mm=0.5 * wavelength / aperture,
            focal_depth_mm=wavelength / aperture**2,
            wavelength_mm=wavelength,
            working_distance_mm=distance,
            planes_mm=planes,
            sensor_mm=max(lens.sensor.size_mm),
        )

    def plausible_mm(self, name: str) -> PlausibleLength | None:
        """What a length of a simulation or a merit may be, by the name of the setting without its unit.

        None where the name is that of no length.
        """
        field, fine, wave = self.field_mm, self.resolved_mm, self.wavelength_mm
        if name in ("patch", "field_stop", "picture_width", "region_size", "tile_width"):
            least, most = fine, (1.5 if name == "patch" else 5.0) * field
            said = f"must be from {least:.3g} mm, the finest line that the aperture passes, to {most:.3g} mm"
            return PlausibleLength(least, most, (4.0 * fine, field), said)
        if name in ("field_stop_at", "chart_at", "region_at"):
            return _at_most(3.0 * field, f"must lie within {3.0 * field:.3g} mm, three times the field")
        if name in ("field", "field_points", "field_height"):
            half = 0.5 * field
            said = f"must be 0, or from {0.002 * half:.2g} to {half:.3g} mm, half of the field"
            return PlausibleLength(0.002 * half, 1.01 * half, (0.02 * half, 1.01 * half), said)
        if name in ("object_pitch", "line_width", "line_widths", "linewidths"):
            return _fineness(fine, 300.0, "lines that the aperture passes")
        if name in ("pitch", "step"):
            return _fineness(wave, 50.0, "light")
        if name in ("picture_pixel", "light_pitch"):
            least, most = 0.01 * fine, field / 8.0
            said = f"must be {1e3 * least:.3g} to {1e3 * most:.3g} um, for a field of {field:g} mm"
            return PlausibleLength(least, most, (0.05 * fine, field / 10.0), said)
        if name == "waist":
            least, most = 2.0 * wave, 20.0 * field
            said = f"must be {least:.3g} to {most:.3g} mm, for a field of {field:g} mm"
            return PlausibleLength(least, most, (4.0 * wave, 2.0 * field), said)
        if name in ("planes", "plane_distance", "predict"):
            return self._plane()
        if name == "pivot_z":
            most = 200.0 * self.median_mm
            return _at_most(most, f"must lie within {most:.3g} mm, 200 times the size of the lens")
        if name in ("decenter_x", "decenter_y"):
            return self._error(self.clear_diameter_mm, "the clear diameter")
        if name == "despace":
            farthest = max(self.working_distance_mm, *self.planes_mm)
            return self._error(farthest, "the distance of object or sensor")
        if name == "working_distance_error":
            return self._error(0.5 * self.working_distance_mm, "half of the working distance")
        if name == "stage_error":
            return self._error(max(self.planes_mm), "the distance of the farthest plane")
        if name in ("shift", "plane_shift"):
            most = 0.1 * self.sensor_mm
            said = f"must be from 0.01 to {1e3 * most:.4g} um, a tenth of the sensor"
            return PlausibleLength(1e-5, most, (5e-4, most), said)
        if name == "refocus":
            depth, distance = self.focal_depth_mm, self.working_distance_mm
            most = min(distance, max(0.2 * distance, 300.0 * depth))
            said = (
                f"must be {0.02 * depth:.3g} to {most:.3g} mm, for a depth of focus of {depth:.3g} mm and a "
                f"working distance of {distance:.3g} mm"
            )
            return PlausibleLength(0.02 * depth, most, (0.1 * depth, most), said)
        return None

    def _error(self, most: float, what: str) -> PlausibleLength:
        """What an error of assembly may be: what can be measured, up to a length of the lens."""
        least = min(1e-4, 1e-5 * self.clear_diameter_mm)
        said = f"must be from {least:.2g} to {most:.3g} mm, {what}"
        return PlausibleLength(least, most, (20.0 * least, 0.5 * most), said)

    def _plane(self) -> PlausibleLength:
        others = max(self.clear_diameter_mm, self.field_mm, self.working_distance_mm, self.median_mm)
        least = min(self.median_mm / 250.0, 0.1)
        most = FAR * others
        said = f"must be {least:.3g} to {most:.4g} mm for a lens of this size"
        return PlausibleLength(least, most, (10.0 * least, 3.0 * others), said)

    def of_parameter_mm(
        self, lens: Lens, target: str, parameter: str, surface: int | None, plane: int | None = None
    ) -> PlausibleLength | None:
        """What a deviation of one parameter of a lens may be; None where it is no length.

        Parameters
        ----------
        lens
            The nominal lens.
        target
            ``lens``, ``surface``, ``element``, ``object`` or ``sensor``.
        parameter
            Its name with the unit, as tolerance studies have it.
        surface, plane
            Index of the surface or the sensor plane, if it is of one.
        """
        beyond = (surface or 0) >= len(lens.surfaces) or (plane or 0) >= len(self.planes_mm)
        if not parameter.endswith("_mm") or beyond:
            return None
        if parameter.startswith("radius") and surface is not None:
            radius = abs(getattr(lens.surfaces[surface], parameter, None) or 0.0)
            if not radius:
                return None
            bent = min(radius, 5.0 * self.clear_diameter_mm)  # a weak surface may have any radius
            said = f"must be from {5e-6 * bent:.2g} to {radius:.3g} mm, the nominal radius"
            return PlausibleLength(5e-6 * bent, radius, (1e-4 * bent, 0.1 * radius), said)
        return self._error(*self._nominal(lens, target, parameter, surface, plane))

    def _nominal(
        self, lens: Lens, target: str, parameter: str, surface: int | None, plane: int | None
    ) -> tuple[float, str]:
        """Largest deviation of a parameter, and what it is."""
        if parameter == "thickness_mm" and surface is not None:
            nominal = lens.surfaces[surface].thickness_mm or self.median_mm
            return max(0.5 * nominal, 0.02 * self.median_mm), "half of the nominal thickness"
        if parameter in ("working_distance_mm", "despace_mm"):
            return 0.5 * self.working_distance_mm, "half of the working distance"
        if target == "sensor" and "distance" in parameter:
            nominal = self.planes_mm[plane] if plane is not None else min(self.planes_mm)
            return nominal, "the distance of the sensor plane"
        if target == "sensor":
            return 0.5 * self.sensor_mm, "half of the sensor"
        if target == "object":
            return max(self.clear_diameter_mm, self.field_mm), "the width of lens and field"
        return 0.2 * self.clear_diameter_mm, "a fifth of the clear diameter"


def doubted_lengths(lens: Lens) -> Iterator[str]:
    """Sentences that question lengths of a lens file.

    Pixel pitch and wavelengths are judged by themselves, all other lengths by the lengths of other kinds.
    Very long radii are those of weak surfaces, thin layers between glasses those of cement: neither is
    questioned.

    Parameters
    ----------
    lens
        A lens, which need not be valid: its surfaces may cross, and its planes be out of order.
    """
    yield from _said("sensor, pixel_pitch_um", lens.sensor.pixel_pitch_um, PIXEL_PITCH_UM, "um")
    for wavelength in lens.wavelengths_um:
        yield from _said("wavelengths_um", wavelength, WAVELENGTH_UM, "um")
    own = [*_of_object_and_sensor(lens), *_of_surfaces(lens), *_of_edges(lens)]
    yield from own
    if not own:
        yield from _of_the_whole(lens)


def long_radii(lens: Lens) -> Iterator[str]:
    """Sentences that name radii which may be given in micrometres, or be those of weak surfaces."""
    middle = 0.5 * _middle(_diameters(lens))
    for number, surface in enumerate(lens.surfaces, start=1):
        half = surface.semi_diameter_mm or middle
        reason = f"is nearly a plane over a semi-diameter of {half:g} mm"
        plausible = PlausibleLength(0.0, 500.0 * half, (0.5 * half, 50.0 * half), reason)
        for key in ("radius_mm", "radius_x_mm"):
            radius = getattr(surface, key)
            if radius is not None:
                yield from _said(f"surface {number}, {key}", radius, plausible)


def _of_the_whole(lens: Lens) -> Iterator[str]:
    """All lengths in another unit: they go together, and no lens is of their size."""
    reason = "no lens is of this size"
    whole = PlausibleLength(LENS_MM.lowest, LENS_MM.highest, LENS_MM.usual, reason)
    size = LensLengths.of(lens)
    under_its_sensor = size.median_mm < 10.0 * LENS_MM.lowest and size.sensor_mm > 200.0 * size.largest_mm
    if whole.doubt(size.median_mm, "mm") is None and not under_its_sensor:
        return
    semi = lens.stop_semi_diameter_mm
    meant = (1e-3 if semi > 1.0 else 1e3) * semi
    yield (
        f"surface {lens.stop_index + 1}, semi_diameter_mm = {semi:g}: {reason}; {meant:g} mm may be meant, "
        "and the same change of all other lengths"
    )


def _said(what: str, value: float, plausible: PlausibleLength, unit: str = "mm") -> Iterator[str]:
    sentence = doubted_length(what, value, unit, plausible)
    if sentence is not None:
        yield sentence


def _fineness(scale_mm: float, most: float, what: str) -> PlausibleLength:
    """What samples and lines may be, beside the scale of what they resolve."""
    low, high = 0.01 * scale_mm, most * scale_mm
    said = f"must be {1e3 * low:.3g} to {1e3 * high:.3g} um, for {what} of {1e3 * scale_mm:.3g} um"
    return PlausibleLength(low, high, (0.05 * scale_mm, 20.0 * scale_mm), said)


def _at_most(most_mm: float, reason: str) -> PlausibleLength:
    return PlausibleLength(0.0, most_mm, (0.0, most_mm), reason)


def _diameters(lens: Lens) -> list[float]:
    """Clear diameters of all surfaces that have one, and the one that the aperture needs in front."""
    own = [2.0 * s.semi_diameter_mm for s in lens.surfaces if s.semi_diameter_mm is not None]
    return own or [2.0 * lens.stop_semi_diameter_mm]


def _between(others: list[float], least: float, times: float = FAR) -> PlausibleLength:
    """What a length may be that is judged by those of other kinds: not far more than the longest of them.

    Parameters
    ----------
    others
        Lengths of other kinds.
    least
        Shortest length that is plausible.
    times
        How many times the longest other length it may be.
    """
    longest = max(others)
    most = times * longest
    reason = f"must be {least:.2g} to {most:.4g} mm beside the other lengths of the lens"
    return PlausibleLength(least, most, (_middle(others) / 100.0, 5.0 * longest), reason)


def _kinds(lens: Lens) -> dict[str, list[float]]:
    """Lengths of a lens by their kinds, without radii."""
    return {
        "diameters": _diameters(lens),
        "field": [lens.object.field_diameter_mm],
        "thicknesses": [s.thickness_mm for s in lens.surfaces if s.thickness_mm is not None],
        "working distance": [lens.object.working_distance_mm],
        "planes": list(lens.sensor.plane_distances_mm),
    }


def _others(lens: Lens, *left_out: str) -> list[float]:
    """Lengths of all kinds but some."""
    return [length for kind, lengths in _kinds(lens).items() if kind not in left_out for length in lengths]


def _middle(lengths: list[float]) -> float:
    return math.exp(statistics.median(map(math.log, lengths)))


def _of_object_and_sensor(lens: Lens) -> Iterator[str]:
    field, distance = lens.object.field_diameter_mm, lens.object.working_distance_mm
    # A far object is legitimate where its light fills the lens: the beam has the lens's diameter then.
    aperture = lens.object.numerical_aperture
    beam = 2.0 * distance * aperture / math.sqrt(1.0 - aperture**2)
    widths = [*_diameters(lens), field]
    if not min(widths) / 20.0 <= beam <= 20.0 * max(widths):
        others = _others(lens, "working distance")
        yield from _said("object, working_distance_mm", distance, _between(others, _middle(others) / 100.0))
    others = _others(lens, "field")
    # The end of a fibre is a small field; one of a few lines that the aperture passes is none.
    few_lines = FEW_LINES * LensLengths.of(lens).resolved_mm
    least = max(_middle(others) / 2000.0, min(_middle(others) / 500.0, few_lines))
    yield from _said("object, field_diameter_mm", field, _between(others, least, WIDE))
    others = _others(lens, "planes")
    nearest = min(_middle(others) / 250.0, 0.1)
    for number, plane in enumerate(lens.sensor.plane_distances_mm, start=1):
        what = f"sensor, plane_distances_mm {number}"
        yield from _said(what, plane, _between(others, nearest))
    pitch, (across, down) = lens.sensor.pixel_pitch_um, lens.sensor.size_mm
    if max(across, down) > FAR * max(_others(lens)) and pitch > PIXEL_PITCH_UM.usual[1]:
        said = f"gives a sensor of {across:.4g} x {down:.4g} mm, more than {FAR:g} times all other lengths"
        usual = PIXEL_PITCH_UM.usual
        yield from _said("sensor, pixel_pitch_um", pitch, PlausibleLength(0.0, usual[1], usual, said), "um")


def _of_surfaces(lens: Lens) -> Iterator[str]:
    before = False
    for number, surface in enumerate(lens.surfaces, start=1):
        where = f"surface {number}"
        semi, thickness, is_glass = (
            surface.semi_diameter_mm,
            surface.thickness_mm,
            surface.material is not None,
        )
        yield from _semi_diameter(lens, number)
        if thickness is not None:
            others = _others(lens, "thicknesses")
            behind = any(s.material is not None for s in lens.surfaces[number : number + 1])
            yield from _said(
                f"{where}, thickness_mm", thickness, _thickness(others, before, is_glass, behind)
            )
        half = semi if semi is not None else 0.5 * _middle(_diameters(lens))
        for key in ("radius_mm", "radius_x_mm"):
            radius, conic = getattr(surface, key), getattr(surface, f"conic{key[6:-3]}")
            if radius is not None and conic > -1.5:  # an axicon is a hyperbola with a small radius
                said = f"is far less than the semi-diameter of {half:g} mm"
                short = PlausibleLength(half / 10.0, ANY, (0.5 * half, 500.0 * half), said)
                yield from _said(f"{where}, {key}", radius, short)
        if surface.figure is not None and surface.figure.semi_diameter_mm is not None:
            known = surface.figure.semi_diameter_mm
            yield from _said(f"{where}, figure, semi_diameter_mm", known, _between([half], 0.0))
        before = is_glass


def _semi_diameter(lens: Lens, number: int) -> Iterator[str]:
    """Doubts of a clear semi-diameter, which may be that of a pinhole."""
    semi = lens.surfaces[number - 1].semi_diameter_mm
    if semi is None:
        return
    beside = [2.0 * s.semi_diameter_mm for s in lens.surfaces if s.semi_diameter_mm not in (None, semi)]
    others = _others(lens, "diameters")
    size = max(_middle(others), _middle(beside) if beside else 0.0)
    yield from _said(f"surface {number}, semi_diameter_mm", semi, _between(others, 0.002 * size))


def _thickness(others: list[float], before: bool, is_glass: bool, behind: bool) -> PlausibleLength:
    """What a thickness may be, by what lies before, within and behind it."""
    middle = _middle(others)
    if is_glass and (before or behind):
        least = 0.0  # cement, or a layer on glass
    elif is_glass:
        least = min(middle / 200.0, 0.03)  # no thinner sheets of glass are sold
    else:
        least = min(middle / 1000.0, 0.01)
    if is_glass:
        return _between(others, least)
    air = _between(others, least, 4.0 * FAR)
    return replace(air, usual=(middle / 300.0, air.usual[1]))


def _of_edges(lens: Lens) -> Iterator[str]:
    others, diameters = _others(lens), _diameters(lens)
    middle, narrow = _middle(others), 0.01 * _middle(diameters)
    for number, edge in enumerate(lens.edges, start=1):
        where = f"edge {number}"
        for key in ("semi_diameter_mm", "front_flat_from_mm", "back_flat_from_mm"):
            value = getattr(edge, key)
            if value is not None:
                yield from _said(f"{where}, {key}", value, _between(diameters, narrow))
        least = 1e-4 * middle
        reason = f"must be 0, or {least:.2g} to {middle:.3g} mm beside the other lengths of the lens"
        bevel = PlausibleLength(least, middle, (3.0 * least, middle), reason)
        for key in ("front_bevel_mm", "back_bevel_mm"):
            yield from _said(f"{where}, {key}", getattr(edge, key), bevel)
        if edge.flange is not None:
            for key, plausible in (
                ("semi_diameter_mm", _between(diameters, narrow)),
                ("distance_mm", _between(others, 5e-4 * middle)),
                ("thickness_mm", _between(others, 1e-3 * middle)),
            ):
                yield from _said(f"{where}, flange, {key}", getattr(edge.flange, key), plausible)
