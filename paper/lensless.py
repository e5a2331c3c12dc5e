"""A camera without a lens: its own frames of an object, and the object that its pixels tell (Fig. 5e)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign import Lens
from lensdesign.lens.lens import Sensor
from wavesim import Electronics, Field, Scene, engine_for, propagate
from wavesim.reconstruction import Retrieved
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.sensor import Camera, light_on_pixels, sensor_grid


@dataclass(frozen=True, eq=False)
class Lensless:
    """A sensor in front of an object.

    Attributes
    ----------
    lens
        That was taken out; the sensor stands behind where it was.
    light
        On the object.
    sensor
        With its planes' distances from the object.
    """

    lens: Lens
    light: Field
    sensor: Sensor

    def frames(self, transmission: NDArray[np.complexfloating], seed: int) -> list[Frame]:
        """One of each plane, of 12 bits, set by its brightest pixel."""
        behind = self.light.with_values(self.light.values * transmission)
        camera, found = Camera(self.sensor, Electronics()), list[Frame]()
        for distance in self.sensor.plane_distances_mm:
            grid = sensor_grid(self.sensor, behind.grid.z_mm + distance, oversampling=2)
            light = light_on_pixels(propagate(behind, grid, check=False), self.sensor)
            found += camera.frames(light, distance, behind.wavelength_um, seed)
        return found

    def retrieved(self, frames: list[Frame], iterations: int) -> Retrieved:
        """The field on the nearest plane by Appendix A, from that of the light alone."""
        near = sensor_grid(self.sensor, self.light.grid.z_mm + self.sensor.plane_distances_mm[0])
        free = engine_for(Scene(self.lens, self.light.grid, near, self.light.wavelength_um), "no-lens")
        return retrieve_resumably(free, self.light, recorded_planes(frames), iterations=iterations)[0]

    def object_of(self, field: Field) -> Field:
        """A retrieved field carried back on the pixels' own samples, then shown on the object's."""
        back = propagate(field, -self.sensor.plane_distances_mm[0], check=False)
        found = propagate(back, self.light.grid, check=False)
        inside = np.abs(self.light.values) > 0.0
        return found.with_values(found.values / float(np.median(np.abs(found.values[inside]))))


def lensless(lens: Lens, light: Field, pixels: int, pitch_um: float, apart_mm: float) -> Lensless:
    """As far from the object as the steepest light that pixels resolve meets the sensor from all of it."""
    rows, columns = np.nonzero(np.abs(light.values))
    half_field = 0.5 * light.grid.pitch_mm * max(np.ptp(rows), np.ptp(columns))
    steepest = math.tan(math.asin(light.wavelength_um / (2.0 * pitch_um)))
    far = (0.5e-3 * pixels * pitch_um - half_field) / steepest
    planes = (far - apart_mm, far)
    return Lensless(
        lens, light, Sensor(pixel_pitch_um=pitch_um, pixels=(pixels, pixels), plane_distances_mm=planes)
    )
