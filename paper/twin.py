"""A chart or tissue in front of a small twin of the lens: light on both planes, and the paper's way back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign import Lens, load_design, scaled
from lensdesign.analysis import footprint
from paper.element import DESIGNS, PAPER_DESIGN
from wavesim import Engine, Field, Grid, Measurement, Scene, engine_for, propagate, retrieve
from wavesim.metrics import element_contrasts, object_correlation, smallest_resolved_element, transmitted_part
from wavesim.reconstruction import Retrieved
from wavesim.targets import field_stop, tissue_phantom, usaf_chart, usaf_elements_within
from wavesim.targets.usaf import UsafElement

OBJECT_PITCH_UM = 0.29
"""A third of the lines of group 9, element 2."""

STOP_SHARE, MARGIN = 0.95, 1.04
"""The field stop, of the field; the patch of samples, of the field stop."""

LIT_MEDIAN = 64.0
"""To which amplitudes are scaled for the step A4."""

TISSUE_SEED = 6

Thing = Literal["chart", "tissue"]
Start = Literal["forward model", "even phase", "random phase"]
STARTS: dict[Start, Any] = {"forward model": None, "even phase": "uniform", "random phase": "random"}


@dataclass(frozen=True, eq=False)
class Twin:
    """An object in front of a twin, and its light behind the lens.

    Attributes
    ----------
    lens
        The twin.
    engine
        From the object to the nearest plane.
    light
        What falls on the object: a plane wave in a round field stop.
    transmission
        Of the object.
    elements
        Of the chart, with bars that are dark on a bright ground; none of tissue.
    """

    lens: Lens
    engine: Engine
    light: Field
    transmission: NDArray[np.complexfloating]
    elements: tuple[UsafElement, ...]

    @cached_property
    def planes(self) -> tuple[Field, ...]:
        """The light on the planes of the sensor."""
        first, *others = self.lens.sensor.plane_distances_mm
        behind = self.engine.forward(self.light.with_values(self.light.values * self.transmission))
        return (behind, *(propagate(behind, plane - first, check=False) for plane in others))

    @cached_property
    def scale(self) -> float:
        """Of the amplitudes, so that their median is what A4 wants."""
        amplitude = np.abs(self.planes[0].values)
        return LIT_MEDIAN / float(np.median(amplitude[amplitude > 1e-4 * amplitude.max()]))

    @cached_property
    def recorded(self) -> list[Measurement]:
        """Amplitudes on the planes, at points and without noise."""
        first = self.planes[0].grid.z_mm
        return [Measurement(one.grid.z_mm - first, self.scale * np.abs(one.values)) for one in self.planes]

    def retrieved(self, start: Start, iterations: int) -> Retrieved:
        """The field behind the lens by Appendix A."""
        begin = STARTS[start]
        if begin is None:
            model = self.engine.forward(self.light)
            begin = model.with_values(self.scale * model.values)
        grid, wavelength = self.engine.scene.exit_grid, self.light.wavelength_um
        return retrieve(grid, wavelength, self.recorded, begin, iterations=iterations)

    def object_of(self, field: Field) -> Field:
        """A field behind the lens carried back to the object, in the scale of the light."""
        found = self.engine.adjoint(field)
        return found.with_values(found.values / self.scale)

    def correlation(self, found: Field) -> float:
        """With the object as the lens passes it, the illumination taken out of both."""
        light, engine = self.light, self.engine
        truth = transmitted_part(light.with_values(light.values * self.transmission), engine)
        return object_correlation(found, truth, transmitted_part(light, engine), np.abs(light.values) > 0.0)

    def finest_um(self, found: Field) -> float:
        """Line width of the finest element down to which all are resolved; infinite if none is."""
        contrasts = element_contrasts(found.values, found.grid, self.elements)
        finest = smallest_resolved_element(contrasts)
        return math.inf if finest is None else finest.line_width_um


@cache
def twin(scale: float, thing: Thing = "chart") -> Twin:
    """A twin so many times as large as the paper's lens, and the object that fills its field."""
    lens = scaled(load_design(DESIGNS / PAPER_DESIGN), scale)
    stop_mm = STOP_SHARE * lens.object.field_diameter_mm
    count = math.ceil(1e3 * MARGIN * stop_mm / OBJECT_PITCH_UM)
    grid = Grid((count, count), 1e-3 * OBJECT_PITCH_UM, lens.object_z_mm)
    pixels = _pixels(lens)
    pitch_mm = 1e-3 * lens.sensor.pixel_pitch_um
    exit_grid = Grid((pixels, pixels), pitch_mm, lens.exit_vertex_z_mm + lens.sensor.plane_distances_mm[0])
    engine = engine_for(Scene(lens, grid, exit_grid, lens.wavelengths_um[0]), "eikonal", error=0.1)
    light = Field(grid, field_stop(grid, "disc", stop_mm).astype(np.complex64), lens.wavelengths_um[0])
    if thing == "tissue":
        aperture = lens.object.numerical_aperture
        tissue = tissue_phantom(grid, TISSUE_SEED, lens.wavelengths_um[0], aperture)
        return Twin(lens, engine, light, tissue, ())
    elements = usaf_elements_within(grid, stop_mm / math.sqrt(2.0))
    return Twin(lens, engine, light, usaf_chart(grid, elements, "bright"), elements)


@cache
def retrieved(scale: float, thing: Thing, start: Start, iterations: int) -> Retrieved:
    """The field behind the lens by Appendix A, for all elements that show it."""
    return twin(scale, thing).retrieved(start, iterations)


def _pixels(lens: Lens) -> int:
    """Along a side of the sensor: as many as the light takes on the last plane, and a tenth more."""
    last = footprint(lens, plane_distance_mm=lens.sensor.plane_distances_mm[-1])
    return math.ceil(2.2e3 * last.radius_mm / lens.sensor.pixel_pitch_um)
