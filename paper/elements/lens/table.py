"""Table 1, and the sizes that the text gives of the lens."""

from __future__ import annotations

import math

from lensdesign import get_material, trace
from lensdesign.analysis import first_order
from lensdesign.raytrace import launch
from paper.element import Element, Made, Number, Work


def table_1(work: Work) -> Made:
    """Radii, conics, thickness and aperture, and what follows from them."""
    lens = work.lens
    front, back = lens.surfaces
    assert front.semi_diameter_mm is not None
    assert front.thickness_mm is not None
    origins, directions = launch(lens, [(0.0, 0.0)], [(0.0, 1.0)], 0.532)
    marginal = trace(lens, origins, directions, 0.532)
    paraxial = first_order(lens)
    sine = float(directions[0, 1])
    numbers = (
        Number("radius of the entrance surface", front.radius_mm or math.inf, "mm", 42.3),
        Number("conic constant of the entrance surface", front.conic, "", 0.0),
        Number("radius of the exit surface", back.radius_mm or math.inf, "mm", -12.0),
        Number("conic constant of the exit surface", back.conic, "", -0.89862, digits=5),
        Number("thickness", front.thickness_mm, "mm", 9.7),
        Number("working distance", lens.object.working_distance_mm, "mm", 13.5),
        Number("clear aperture", 2.0 * front.semi_diameter_mm, "mm", 16.52),
        Number("sine of the ray through its rim: the aperture", sine, "", 0.5, 0.005),
        Number("height of that ray on the exit surface", abs(float(marginal.position[0, 1])), "mm"),
        Number("index of N-BK7 at 0.532 µm", get_material("N-BK7").index(0.532), digits=8),
        Number("focal length", paraxial.efl_mm, "mm"),
        Number("front focal point to front vertex", -paraxial.ffl_mm, "mm"),
    )
    difference = (
        "The clear aperture of 16.52 mm is that of the entrance surface, which is the stop. The ray from "
        "the axis through its edge has NA 0.5. The object is 0.37 mm inside the front focal plane, so "
        "its light leaves nearly collimated."
    )
    return Made(numbers, ("lensdesign check designs/paper_singlet.toml",), difference)


ELEMENTS = (
    Element(
        "table-1",
        "Table 1: the two surfaces",
        "A sphere of 42.3 mm and a conic of −12 mm, −0.89862; N-BK7, 9.7 mm thick, 16.52 mm clear, 13.5 mm "
        "from the object.",
        table_1,
    ),
)
