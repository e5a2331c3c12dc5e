"""Eqs. 1 and 2: whether the sensor holds what the lens collects."""

from __future__ import annotations

from lensdesign.analysis import largest_spread_angle, match
from paper.element import Element, Made, Number, Work


def equation_1(work: Work) -> Made:
    """Space-bandwidth products of object and sensor."""
    lens = work.lens
    found = match(lens, lens.wavelengths_um[0])
    width, height = lens.sensor.size_mm
    numbers = (
        Number("diameter of the field", lens.object.field_diameter_mm, "mm", 3.0),
        Number("numerical aperture", lens.object.numerical_aperture, "", 0.5),
        Number("wavelength", lens.wavelengths_um[0], "µm", 0.532),
        Number("resolution, λ / (2 NA)", found.resolution_um, "µm", 0.532, 5e-4),
        Number("sensor, longer side", width, "mm", 29.9, 0.05),
        Number("sensor, shorter side D", height, "mm", 22.4, 0.05),
        Number("pixels across", lens.sensor.pixels[0], "", 9344),
        Number("pixels down", lens.sensor.pixels[1], "", 7000),
        Number("pixel pitch Δ", lens.sensor.pixel_pitch_um, "µm", 3.2),
        Number("SBP of the object", found.sbp_object, digits=6),
        Number("SBP of the sensor", found.sbp_sensor, digits=6),
        Number(
            "SBP of the sensor over that of the object",
            found.sbp_ratio,
            "",
            1.0,
            0.05,
            remark="the paper makes them equal; by its own numbers the sensor has half as much again",
        ),
    )
    difference = (
        "The sensor's product is 1.54 times the object's. Eq. 1 is therefore met with a margin, and the "
        "match is not perfect as the paper states."
    )
    return Made(numbers, ("lensdesign check designs/paper_singlet.toml",), difference)


def equation_2(work: Work) -> Made:
    """The spread-angle limit, and the largest angle behind the lens."""
    lens = work.lens
    found, spread = match(lens, lens.wavelengths_um[0]), largest_spread_angle(lens)
    numbers = (
        Number("limit of the angle, asin(λ / (2 Δ))", found.spread_limit_deg, "°", 4.8, 0.05, digits=5),
        Number(
            "highest frequency of the pixels",
            found.highest_frequency_lp_per_mm,
            "lp/mm",
            156.0,
            0.5,
            digits=5,
        ),
        Number("largest angle behind the lens", spread.spread_deg, "°", 4.8, 0.05, "<=", digits=5),
        Number(
            "that over the limit",
            spread.spread_deg / found.spread_limit_deg,
            remark="above 1: Eq. 2 is missed",
        ),
        Number("field height of that ray", abs(spread.field_mm[1]), "mm"),
    )
    difference = (
        "Rounded to 4.8° both agree. Unrounded, the lens of Table 1 misses its own Eq. 2 by 0.9 %, at "
        "the edge of the field. `lensdesign check` reports this and ends with status 1."
    )
    return Made(numbers, ("lensdesign check designs/paper_singlet.toml",), difference)


ELEMENTS = (
    Element(
        "equation-1",
        "Eq. 1: the sensor holds the object",
        "π(D/2)² π(1/(2Δ))² ≥ SBP of the object, for a field of 3 mm at NA 0.5 and a sensor of 9344 × "
        "7000 pixels of 3.2 µm. The paper makes both equal.",
        equation_1,
    ),
    Element(
        "equation-2",
        "Eq. 2: the pixels sample every angle",
        "√(1 − cos²θx − cos²θy) / λ ≤ 1 / (2Δ): rays may leave the lens at no more than 4.8°, which is "
        "156 lp/mm.",
        equation_2,
    ),
)
