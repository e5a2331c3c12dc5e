"""Plausible ranges of the lengths of a lens file, of a simulation and of tolerances.

The ranges are relative to the lens, so that a lens of any size is judged by the same rule. They are wide: a
length is questioned only where no real design has it, such as a decenter larger than the clear diameter. The
usual cause of such a length is a wrong unit.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace

from lensdesign.common.lengths import PIXEL_PITCH_UM, WAVELENGTH_UM, PlausibleLength, implausible_values
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens

FAR = 50.0
"""A length is too long if it exceeds all lengths of other kinds by this factor."""


class LongRadiusWarning(UserWarning):
    """Warn of a radius that makes the surface nearly plane and that would be usual in micrometres."""


@dataclass(frozen=True)
class LensLengths:
    """Characteristic lengths of a lens, by which other lengths are judged.

    Attributes
    ----------
    median_mm
        Median of diameters, field, glass thicknesses and working distance. A single wrong length changes it
        little.
    largest_mm
        Largest of these and of all distances; without radii, which may have any length.
    clear_diameter_mm
        Clear diameter of the widest surface.
    field_mm
        Diameter of the field.
    resolved_mm
        Finest line width that the numerical aperture passes.
    focal_depth_mm
        Wavelength divided by the square of the numerical aperture.
    wavelength_mm
        Wavelength of the light.
    working_distance_mm
        Distance from the object to the front vertex.
    planes_mm
        Distances of the sensor planes from the exit vertex.
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
        """Return the lengths of a lens at a wavelength (default: its first)."""
        wavelength = 1e-3 * (lens.wavelengths_um[0] if wavelength_um is None else wavelength_um)
        aperture = max(lens.object.numerical_aperture, 1e-6)  # its square must not underflow to 0
        diameters = _diameters(lens)
        field, distance = lens.object.field_diameter_mm, lens.object.working_distance_mm
        glass = [s.thickness_mm for s in lens.surfaces if s.thickness_mm and not is_gap(s.material)]
        spaces = [s.thickness_mm for s in lens.surfaces if s.thickness_mm and is_gap(s.material)]
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
        """Return the plausible range of a length of a simulation or a merit.

        Parameters
        ----------
        name
            Name of the setting without its unit.

        Returns
        -------
        PlausibleLength or None
            None if the setting is not a length.
        """
        field, fine, wave = self.field_mm, self.resolved_mm, self.wavelength_mm
        if name in ("patch", "field_stop", "picture_width", "region_size", "tile_width"):
            least, most = fine, (1.5 if name == "patch" else 5.0) * field
            reason = (
                f"must be from {least:.3g} mm, the finest line that the aperture passes, to {most:.3g} mm"
            )
            return PlausibleLength(least, most, (4.0 * fine, field), reason)
        if name in ("field_stop_at", "chart_at", "region_at"):
            return _at_most(3.0 * field, f"must lie within {3.0 * field:.3g} mm, three times the field")
        if name in ("field", "field_points", "field_height", "field_heights"):
            half = 0.5 * field
            reason = f"must be 0, or from {0.002 * half:.2g} to {half:.3g} mm, half of the field"
            return PlausibleLength(0.002 * half, 1.01 * half, (0.02 * half, 1.01 * half), reason)
        if name in ("object_pitch", "line_width", "line_widths", "linewidths"):
            return _fineness(fine, 300.0, "lines that the aperture passes")
        if name in ("pitch", "step"):
            return _fineness(wave, 50.0, "light")
        if name in ("picture_pixel", "light_pitch"):
            least, most = 0.01 * fine, field / 8.0
            reason = f"must be {1e3 * least:.3g} to {1e3 * most:.3g} µm, for a field of {field:g} mm"
            return PlausibleLength(least, most, (0.05 * fine, field / 10.0), reason)
        if name == "waist":
            least, most = 2.0 * wave, 20.0 * field
            reason = f"must be {least:.3g} to {most:.3g} mm, for a field of {field:g} mm"
            return PlausibleLength(least, most, (4.0 * wave, 2.0 * field), reason)
        if name == "source_distance":
            least, most = 0.5 * field, 1e4 * self.largest_mm
            reason = f"must be {least:.3g} to {most:.3g} mm, for light that is {field:g} mm wide"
            return PlausibleLength(least, most, (field, 100.0 * self.largest_mm), reason)
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
            reason = f"must be from 0.01 to {1e3 * most:.4g} µm, a tenth of the sensor"
            return PlausibleLength(1e-5, most, (5e-4, most), reason)
        if name == "refocus":
            depth, distance = self.focal_depth_mm, self.working_distance_mm
            most = min(distance, max(0.2 * distance, 300.0 * depth))
            reason = (
                f"must be {0.02 * depth:.3g} to {most:.3g} mm, for a depth of focus of {depth:.3g} mm and a "
                f"working distance of {distance:.3g} mm"
            )
            return PlausibleLength(0.02 * depth, most, (0.1 * depth, most), reason)
        return None

    def _error(self, most: float, what: str) -> PlausibleLength:
        """Return the range of an assembly error: from what can be measured up to a length of the lens."""
        least = min(1e-4, 1e-5 * self.clear_diameter_mm)
        reason = f"must be from {least:.2g} to {most:.3g} mm, {what}"
        return PlausibleLength(least, most, (20.0 * least, 0.5 * most), reason)

    def _plane(self) -> PlausibleLength:
        others = max(self.clear_diameter_mm, self.field_mm, self.working_distance_mm, self.median_mm)
        least = min(self.median_mm / 250.0, 0.1)
        most = FAR * others
        reason = f"must be {least:.3g} to {most:.4g} mm for a lens of this size"
        return PlausibleLength(least, most, (10.0 * least, 3.0 * others), reason)

    def of_parameter_mm(
        self, lens: Lens, target: str, parameter: str, surface: int | None, plane: int | None = None
    ) -> PlausibleLength | None:
        """Return the plausible range of the deviation of one parameter of a lens.

        Parameters
        ----------
        lens
            The nominal lens.
        target
            ``lens``, ``surface``, ``element``, ``object`` or ``sensor``.
        parameter
            Name of the parameter with its unit, as in a tolerance study.
        surface, plane
            Index of the surface or of the sensor plane; None if the parameter belongs to neither.

        Returns
        -------
        PlausibleLength or None
            None if the parameter is not a length.
        """
        beyond = (surface or 0) >= len(lens.surfaces) or (plane or 0) >= len(self.planes_mm)
        if not parameter.endswith("_mm") or beyond:
            return None
        if parameter.startswith("radius") and surface is not None:
            radius = abs(getattr(lens.surfaces[surface], parameter, None) or 0.0)
            if not radius:
                return None
            bent = min(radius, 5.0 * self.clear_diameter_mm)  # a weak surface may have any radius
            reason = f"must be from {5e-6 * bent:.2g} to {radius:.3g} mm, the nominal radius"
            return PlausibleLength(5e-6 * bent, radius, (1e-4 * bent, 0.1 * radius), reason)
        return self._error(*self._nominal(lens, target, parameter, surface, plane))

    def _nominal(
        self, lens: Lens, target: str, parameter: str, surface: int | None, plane: int | None
    ) -> tuple[float, str]:
        """Return the largest deviation of a parameter in mm and its description."""
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


def implausible_lengths(lens: Lens) -> Iterator[str]:
    """Yield a message for each implausible length of a lens file.

    Pixel pitch and wavelengths have absolute ranges; all other lengths are compared with the lengths of other
    kinds. Very long radii (weak surfaces) and thin layers between glasses (cement) are not questioned.

    Parameters
    ----------
    lens
        A lens, which need not be valid: its surfaces may cross, and its planes may be out of order.
    """
    yield from implausible_values("sensor, pixel_pitch_um", lens.sensor.pixel_pitch_um, PIXEL_PITCH_UM, "um")
    for wavelength in lens.wavelengths_um:
        yield from implausible_values("wavelengths_um", wavelength, WAVELENGTH_UM, "um")
    own = [*_of_object_and_sensor(lens), *_of_surfaces(lens), *_of_edges(lens)]
    yield from own
    if not own:
        yield from _of_the_whole(lens)


def long_radii(lens: Lens) -> Iterator[str]:
    """Yield a message for each radius that may be given in micrometres or belong to a weak surface."""
    middle = 0.5 * _geometric_median(_diameters(lens))
    for number, surface in enumerate(lens.surfaces, start=1):
        half = surface.semi_diameter_mm or middle
        reason = f"is nearly a plane over a semi-diameter of {half:g} mm"
        plausible = PlausibleLength(0.0, 500.0 * half, (0.5 * half, 50.0 * half), reason)
        for key in ("radius_mm", "radius_x_mm"):
            radius = getattr(surface, key)
            if radius is not None:
                yield from implausible_values(f"surface {number}, {key}", radius, plausible)


def _of_the_whole(lens: Lens) -> Iterator[str]:
    """Yield a message if all lengths are in another unit: they are consistent, but no lens has their size."""
    reason = "no lens is of this size"
    # A smaller lens would be a few wavelengths wide, and no glass lens is larger.
    whole = PlausibleLength(0.01, 2000.0, (0.1, 500.0), reason)
    size = LensLengths.of(lens)
    far_smaller_than_sensor = (
        size.median_mm < 10.0 * whole.lowest and size.sensor_mm > 200.0 * size.largest_mm
    )
    if whole.objection(size.median_mm, "mm") is None and not far_smaller_than_sensor:
        return
    semi = lens.stop_semi_diameter_mm
    meant = (1e-3 if semi > 1.0 else 1e3) * semi
    yield (
        f"surface {lens.stop_index + 1}, semi_diameter_mm = {semi:g}: {reason}; {meant:g} mm may be meant, "
        "and the same change of all other lengths"
    )


def _fineness(scale_mm: float, most: float, what: str) -> PlausibleLength:
    """Return the range of a sampling pitch or line width, relative to the scale that it resolves."""
    low, high = 0.01 * scale_mm, most * scale_mm
    reason = f"must be {1e3 * low:.3g} to {1e3 * high:.3g} µm, for {what} of {1e3 * scale_mm:.3g} µm"
    return PlausibleLength(low, high, (0.05 * scale_mm, 20.0 * scale_mm), reason)


def _at_most(most_mm: float, reason: str) -> PlausibleLength:
    return PlausibleLength(0.0, most_mm, (0.0, most_mm), reason)


def _diameters(lens: Lens) -> list[float]:
    """Return the clear diameters of all surfaces that have one."""
    own = [2.0 * s.semi_diameter_mm for s in lens.surfaces if s.semi_diameter_mm is not None]
    return own or [2.0 * lens.stop_semi_diameter_mm]


def _between(others: list[float], least: float, times: float = FAR) -> PlausibleLength:
    """Return the range of a length from `least` to a multiple of the longest length of other kinds."""
    longest = max(others)
    most = times * longest
    reason = f"must be {least:.2g} to {most:.4g} mm, in proportion to the other lengths of the lens"
    return PlausibleLength(least, most, (_geometric_median(others) / 100.0, 5.0 * longest), reason)


def _kinds(lens: Lens) -> dict[str, list[float]]:
    """Return the lengths of a lens by their kinds, without radii."""
    return {
        "diameters": _diameters(lens),
        "field": [lens.object.field_diameter_mm],
        "thicknesses": [s.thickness_mm for s in lens.surfaces if s.thickness_mm is not None],
        "working distance": [lens.object.working_distance_mm],
        "planes": list(lens.sensor.plane_distances_mm),
    }


def _others(lens: Lens, *excluded: str) -> list[float]:
    """Return the lengths of all kinds except the excluded ones."""
    return [length for kind, lengths in _kinds(lens).items() if kind not in excluded for length in lengths]


def _geometric_median(lengths: list[float]) -> float:
    return math.exp(statistics.median(map(math.log, lengths)))


def _of_object_and_sensor(lens: Lens) -> Iterator[str]:
    field, distance = lens.object.field_diameter_mm, lens.object.working_distance_mm
    # A distant object is plausible if its light fills the lens: the beam then has the diameter of the lens.
    aperture = lens.object.numerical_aperture
    beam = 2.0 * distance * aperture / math.sqrt(1.0 - aperture**2)
    widths = [*_diameters(lens), field]
    if not min(widths) / 20.0 <= beam <= 20.0 * max(widths):
        others = _others(lens, "working distance")
        yield from implausible_values(
            "object, working_distance_mm", distance, _between(others, _geometric_median(others) / 100.0)
        )
    others = _others(lens, "field")
    # The end of a fibre is a plausible small field; a field narrower than six resolved lines is not.
    few_lines = 6.0 * LensLengths.of(lens).resolved_mm
    least = max(_geometric_median(others) / 2000.0, min(_geometric_median(others) / 500.0, few_lines))
    # Seen from the lens, a field of twelve times its largest length reaches 80 degrees off the axis.
    yield from implausible_values("object, field_diameter_mm", field, _between(others, least, 12.0))
    others = _others(lens, "planes")
    nearest = min(_geometric_median(others) / 250.0, 0.1)
    for number, plane in enumerate(lens.sensor.plane_distances_mm, start=1):
        what = f"sensor, plane_distances_mm {number}"
        yield from implausible_values(what, plane, _between(others, nearest))
    glass = lens.sensor.cover_glass
    if glass is not None:
        location, others = "sensor, cover_glass", _others(lens)
        sheet = _thickness(others, True, touches=False)
        yield from implausible_values(f"{location}, thickness_mm", glass.thickness_mm, sheet)
        gap = _between(others, 0.0)
        yield from implausible_values(f"{location}, distance_mm", glass.distance_mm, gap)
    pitch, (across, down) = lens.sensor.pixel_pitch_um, lens.sensor.size_mm
    if max(across, down) > FAR * max(_others(lens)) and pitch > PIXEL_PITCH_UM.usual[1]:
        reason = f"gives a sensor of {across:.4g} x {down:.4g} mm, more than {FAR:g} times all other lengths"
        usual = PIXEL_PITCH_UM.usual
        yield from implausible_values(
            "sensor, pixel_pitch_um", pitch, PlausibleLength(0.0, usual[1], usual, reason), "um"
        )


def _of_surfaces(lens: Lens) -> Iterator[str]:
    glass_before = False
    for number, surface in enumerate(lens.surfaces, start=1):
        location = f"surface {number}"
        semi, thickness = surface.semi_diameter_mm, surface.thickness_mm
        is_glass = not is_gap(surface.material)
        yield from _semi_diameter(lens, number)
        if thickness is not None:
            others = _others(lens, "thicknesses")
            glass_behind = any(not is_gap(s.material) for s in lens.surfaces[number : number + 1])
            plausible = _thickness(
                others,
                is_glass,
                touches=(glass_before or glass_behind) if is_glass else (glass_before and glass_behind),
            )
            yield from implausible_values(f"{location}, thickness_mm", thickness, plausible)
        half = semi if semi is not None else 0.5 * _geometric_median(_diameters(lens))
        for key in ("radius_mm", "radius_x_mm"):
            radius, conic = getattr(surface, key), getattr(surface, f"conic{key[6:-3]}")
            if radius is not None and conic > -1.5:  # an axicon is a hyperbola with a small radius
                reason = f"is far less than the semi-diameter of {half:g} mm"
                short = PlausibleLength(half / 10.0, math.inf, (0.5 * half, 500.0 * half), reason)
                yield from implausible_values(f"{location}, {key}", radius, short)
        if surface.figure is not None and surface.figure.semi_diameter_mm is not None:
            known = surface.figure.semi_diameter_mm
            yield from implausible_values(
                f"{location}, figure, semi_diameter_mm", known, _between([half], 0.0)
            )
        glass_before = is_glass


def _semi_diameter(lens: Lens, number: int) -> Iterator[str]:
    """Yield a message for an implausible clear semi-diameter; a pinhole is plausible."""
    semi = lens.surfaces[number - 1].semi_diameter_mm
    if semi is None:
        return
    different = [2.0 * s.semi_diameter_mm for s in lens.surfaces if s.semi_diameter_mm not in (None, semi)]
    others = _others(lens, "diameters")
    size = max(_geometric_median(others), _geometric_median(different) if different else 0.0)
    yield from implausible_values(f"surface {number}, semi_diameter_mm", semi, _between(others, 0.002 * size))


def _thickness(others: list[float], is_glass: bool, *, touches: bool) -> PlausibleLength:
    """Return the range of a thickness of glass or air.

    `touches` is True for glass that adjoins other glass, and for air between two glasses.
    """
    middle = _geometric_median(others)
    if touches:
        least = 0.0  # cement, a layer on glass, or elements that touch at the vertex or at the rim
    elif is_glass:
        least = min(middle / 200.0, 0.03)  # thinner sheets of glass are not sold
    else:
        least = min(middle / 1000.0, 0.01)
    if is_glass:
        return _between(others, least)
    air = _between(others, least, 4.0 * FAR)
    return replace(air, usual=(middle / 300.0, air.usual[1]))


def _of_edges(lens: Lens) -> Iterator[str]:
    others, diameters = _others(lens), _diameters(lens)
    middle, narrow = _geometric_median(others), 0.01 * _geometric_median(diameters)
    for number, edge in enumerate(lens.edges, start=1):
        location = f"edge {number}"
        for key in ("semi_diameter_mm", "front_flat_from_mm", "back_flat_from_mm"):
            value = getattr(edge, key)
            if value is not None:
                yield from implausible_values(f"{location}, {key}", value, _between(diameters, narrow))
        least = 1e-4 * middle
        reason = (
            f"must be 0, or {least:.2g} to {middle:.3g} mm, in proportion to the other lengths of the lens"
        )
        bevel = PlausibleLength(least, middle, (3.0 * least, middle), reason)
        for key in ("front_bevel_mm", "back_bevel_mm"):
            yield from implausible_values(f"{location}, {key}", getattr(edge, key), bevel)
        if edge.flange is not None:
            for key, plausible in (
                ("semi_diameter_mm", _between(diameters, narrow)),
                ("distance_mm", _between(others, 5e-4 * middle)),
                ("thickness_mm", _between(others, 1e-3 * middle)),
            ):
                yield from implausible_values(
                    f"{location}, flange, {key}", getattr(edge.flange, key), plausible
                )
        if edge.gate is not None:
            for key in ("flat_depth_mm", "width_mm", "thickness_mm"):
                if (value := getattr(edge.gate, key)) is not None:
                    yield from implausible_values(
                        f"{location}, gate, {key}", value, _between(others, 5e-4 * middle)
                    )
