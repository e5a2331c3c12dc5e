"""Matching a lens to a sensor: space-bandwidth products, spread-angle limit and etendue (Eqs. 1 and 2).

The paper's Eq. 1 is pi (D/2)^2 pi (1/(2 pitch))^2 >= SBP of the object. Its Eq. 2 is
sqrt(cos^2 tx + cos^2 ty) / wavelength <= 1 / (2 pitch), with the angles tx and ty to the x and y axes. The
numerator is the sine of the angle to the optical axis. The wavelength in Eq. 2 is that in the medium in front
of the sensor: the vacuum wavelength divided by the index of the medium. The index times the sine is the same
on both sides of a plane face, so that a plane window in front of the sensor changes no fringes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class Matching:
    """Requirements of the object and capacity of the sensor at one wavelength, without any ray traced.

    Attributes
    ----------
    wavelength_um
        Vacuum wavelength.
    sbp_object, sbp_sensor
        Space-bandwidth products of the object with the NA of the design, and of the sensor.
    sbp_ratio
        `sbp_sensor` / `sbp_object`; Eq. 1 requires 1 or more.
    spread_limit_deg
        Largest angle to the axis that the pixels resolve, in the medium in front of the sensor (Eq. 2).
    highest_frequency_lp_per_mm
        Highest frequency of the pixels, 1 / (2 pitch).
    resolution_um
        wavelength / (2 NA), half of the finest period that the NA passes.
    smallest_exit_beam_diameter_mm
        Diameter of the narrowest beam that carries field x NA within the spread limit, by conservation of
        etendue.
    """

    wavelength_um: float
    sbp_object: float
    sbp_sensor: float
    sbp_ratio: float
    spread_limit_deg: float
    highest_frequency_lp_per_mm: float
    resolution_um: float
    smallest_exit_beam_diameter_mm: float


def sbp_object(field_diameter_mm: float, numerical_aperture: float, wavelength_um: float) -> float:
    """Return the SBP of a circular field: its area times the area of the spectrum within the NA."""
    cutoff_per_mm = numerical_aperture / (wavelength_um * 1e-3)
    return math.pi * (0.5 * field_diameter_mm) ** 2 * math.pi * cutoff_per_mm**2


def sbp_sensor(shortest_side_mm: float, pixel_pitch_um: float) -> float:
    """Return the SBP of a sensor: its inscribed circle times the circular band of the pixels (Eq. 1)."""
    return (
        math.pi * (0.5 * shortest_side_mm) ** 2 * math.pi * highest_frequency_lp_per_mm(pixel_pitch_um) ** 2
    )


def highest_frequency_lp_per_mm(pixel_pitch_um: float) -> float:
    """Return the highest frequency that a pixel pitch resolves, 1 / (2 pitch)."""
    return 1.0 / (2.0 * pixel_pitch_um * 1e-3)


def spread_limit_sine(wavelength_um: float, pixel_pitch_um: float, medium_index: float = 1.0) -> float:
    """Return the sine of the spread-angle limit, wavelength / (2 index pitch), at most 1 (Eq. 2).

    Parameters
    ----------
    wavelength_um
        Vacuum wavelength.
    pixel_pitch_um
        Pixel pitch.
    medium_index
        Index of the medium in front of the sensor, in which the angle is measured (default: air).

    Examples
    --------
    >>> round(spread_limit_sine(0.55, 3.2), 4)
    0.0859
    >>> round(spread_limit_sine(0.55, 3.2, 1.333), 4)
    0.0645
    """
    return min(1.0, wavelength_um / (2.0 * medium_index * pixel_pitch_um))


def sensor_spread_sine(lens: Lens, wavelength_um: float) -> float:
    """Return the sine of the spread-angle limit of a lens, in the medium in front of its sensor (Eq. 2).

    Parameters
    ----------
    lens
        The lens.
    wavelength_um
        Vacuum wavelength.

    Raises
    ------
    MaterialError
        If the index of the medium is not known at this wavelength.
    """
    return spread_limit_sine(
        wavelength_um, lens.sensor.pixel_pitch_um, lens.sensor_medium_index(wavelength_um)
    )


def smallest_exit_beam_diameter_mm(
    field_diameter_mm: float, numerical_aperture: float, spread_sine: float, medium_index: float = 1.0
) -> float:
    """Return the diameter of the narrowest beam that carries the field within a spread (Lagrange bound).

    In a meridional plane, a beam of diameter D and spread t in a medium of index n occupies at most
    D x 2 n sin t of phase space. The light of the object occupies field x 2 NA, which refraction conserves.
    """
    return field_diameter_mm * numerical_aperture / (medium_index * spread_sine)


def match(lens: Lens, wavelength_um: float) -> Matching:
    """Evaluate Eqs. 1 and 2 and the etendue bound for the object and sensor of a lens at one wavelength.

    Parameters
    ----------
    lens
        The lens.
    wavelength_um
        Vacuum wavelength.

    Returns
    -------
    Matching

    Raises
    ------
    DesignError
        If the values of object or sensor are so small that the products underflow.
    MaterialError
        If the index of the medium in front of the sensor is not known at this wavelength.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> matching = match(lens, 0.532)
    >>> round(matching.spread_limit_deg, 3), round(matching.sbp_ratio, 3)
    (4.768, 1.541)
    """
    target, sensor = lens.object, lens.sensor
    try:
        required = sbp_object(target.field_diameter_mm, target.numerical_aperture, wavelength_um)
        available = sbp_sensor(min(sensor.size_mm), sensor.pixel_pitch_um)
        ratio = available / required
    except ArithmeticError:
        raise DesignError(
            f"field_diameter_mm = {target.field_diameter_mm:g}, numerical_aperture = "
            f"{target.numerical_aperture:g}, pixel_pitch_um = {sensor.pixel_pitch_um:g} and a wavelength of "
            f"{wavelength_um:g} µm give no space-bandwidth product (Eq. 1): one of these values is far too "
            "small"
        ) from None
    index = lens.sensor_medium_index(wavelength_um)
    sine = spread_limit_sine(wavelength_um, sensor.pixel_pitch_um, index)
    return Matching(
        wavelength_um=wavelength_um,
        sbp_object=required,
        sbp_sensor=available,
        sbp_ratio=ratio,
        spread_limit_deg=math.degrees(math.asin(sine)),
        highest_frequency_lp_per_mm=highest_frequency_lp_per_mm(sensor.pixel_pitch_um),
        resolution_um=wavelength_um / (2.0 * target.numerical_aperture),
        smallest_exit_beam_diameter_mm=smallest_exit_beam_diameter_mm(
            target.field_diameter_mm, target.numerical_aperture, sine, index
        ),
    )
