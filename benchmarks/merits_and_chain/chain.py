"""The whole chain for one perturbed lens: frames with noise, and the object found in them.

A round field stop about any point of the object is lit by a plane wave. Its light goes through the perturbed
lens (eikonal tiles) to where the sensor really stands, and is recorded with noise. The object is then found
as if all were nominal, or with the mounting found from frames of a known chart. What is found counts
where, and in which focus, it is most like the object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy.fft

from lensdesign.lens.lens import Lens, Sensor
from wavesim import Electronics, Engine, Field, Grid, Measurement, SystemState, engine_for, reconstruct
from wavesim.calibration.joint.blurred_search import blurred_search
from wavesim.calibration.joint.pixels import DensePixels
from wavesim.calibration.joint.search import JointSearch, SearchState
from wavesim.calibration.parameters import Unknowns, mounting_parameters
from wavesim.scene.scene import placed_light, placed_scene
from wavesim.sensor import Camera, Recorder, Recording, recorded_planes
from wavesim.sensor.measurement import noise_misfit, placed_planes
from wavesim.sensor.windows import exit_scene, sensor_window
from wavesim.targets.illumination import field_stop, plane_wave
from wavesim.targets.patch import Patch
from wavesim.targets.patterns import band_limit

Kind = Literal["amplitude", "complex"]
Array = np.ndarray[Any, Any]

ITERATIONS: dict[Kind, int] = {"amplitude": 20, "complex": 60}
TILE_ERROR, ELECTRONS, WINDOW = 0.1, 1e4, 1.15
EXPOSURES = 1.0, 30.0
OBJECT_FINENESS = 0.8
INNER = 0.92
"""Of the field stop's radius, where found and true object are compared."""
CURVATURES_WAVES = np.linspace(-2.0, 2.0, 33)
"""At the field stop's rim, that are tried of a complex object's phase."""
REFOCUS_STEPS = np.arange(-12, 13) * 0.5
"""In depths of focus, wavelength / NA^2."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A lens, and a round part of its object.

    Attributes
    ----------
    lens : Lens
        The nominal one.
    middle_mm : (x, y)
        Of the part.
    stop_mm : float
        Its diameter.
    kind : {"amplitude", "complex"}
        Kind of the object, which the reconstruction knows; complex ones are recorded on four planes.
    """

    lens: Lens
    middle_mm: tuple[float, float]
    stop_mm: float
    kind: Kind

    @cached_property
    def planes_mm(self) -> tuple[float, ...]:
        """Where the sensor records."""
        first, last = self.lens.sensor.plane_distances_mm
        return tuple(np.linspace(first, last, 2 if self.kind == "amplitude" else 4).tolist())

    @cached_property
    def grid(self) -> Grid:
        """Samples of the object."""
        pitch = OBJECT_FINENESS * 0.5e-3 * self.lens.wavelengths_um[0] / self.lens.object.numerical_aperture
        count = scipy.fft.next_fast_len(math.ceil(self.stop_mm / pitch) + 2)
        return Grid((count, count), pitch, self.lens.object_z_mm, self.middle_mm)

    @cached_property
    def patch(self) -> Patch:
        """For windows: as wide as the axis and the part."""
        wide = self.stop_mm + 2.0 * math.hypot(*self.middle_mm)
        return Patch(self.grid, wide, self.lens.wavelengths_um[0])

    @cached_property
    def light(self) -> Field:
        """On the object, and the field stop."""
        wave = plane_wave(self.grid, self.lens.wavelengths_um[0])
        return wave.with_values(wave.values * field_stop(self.grid, "disc", self.stop_mm))

    @cached_property
    def sensor(self) -> Sensor:
        """As much of it as light falls on, with some room."""
        least = max(sensor_window(self.lens, self.patch, self.planes_mm).pixels)
        pixels = scipy.fft.next_fast_len(math.ceil(WINDOW * least))
        return sensor_window(self.lens, self.patch, self.planes_mm, min(pixels, *self.lens.sensor.pixels))

    @cached_property
    def engine(self) -> Engine:
        """Through the nominal lens."""
        scene = exit_scene(self.lens, self.patch, self.sensor, self.planes_mm[0])
        return engine_for(scene, "eikonal", error=TILE_ERROR)

    def recorded(self, system: SystemState, transmission: Array, seed: int) -> list[Measurement]:
        """What the sensor records behind a perturbed lens."""
        noise = np.random.SeedSequence(seed)
        electronics = Electronics(full_well_electrons=ELECTRONS / 0.8, bits=12)
        recording = Recording(Camera(self.sensor, electronics, EXPOSURES), self.planes_mm, noise, system)
        lit = self.light.with_values(self.light.values * transmission)
        engine = engine_for(recording.scene(self.lens, self.patch), "eikonal", error=TILE_ERROR)
        return recorded_planes(Recorder(recording, engine).frames(placed_light(lit, system))[0])

    def found(self, planes: Sequence[Measurement], bench: SystemState | None = None) -> tuple[Array, float]:
        """Transmission of the object found with the nominal or a calibrated lens, and the misfit."""
        engine, light = self.engine, self.light
        if bench is not None:
            engine = engine_for(placed_scene(engine.scene, bench), "eikonal", error=TILE_ERROR)
            light, planes = placed_light(light, bench), placed_planes(planes, bench)
        found = reconstruct(
            engine,
            light.with_values(light.values.astype(np.complex64)),
            planes,
            kind=self.kind,
            tv_weight="auto",
            iterations=ITERATIONS[self.kind],
            until_noise=True,
            fill_factor=1.0,
        )
        return found.transmission.values, found.misfit[-1]

    def mounting(self, planes: Sequence[Measurement], known: Array) -> SystemState:
        """The lens as mounted, from what was recorded of a known object."""
        scene, light = self.engine.scene, self.light.with_values(self.light.values.astype(np.complex64))
        pixels = DensePixels(
            scene, light, planes, None, 1.0, lambda one: engine_for(one, "eikonal", error=TILE_ERROR)
        )
        sought, values = mounting_parameters(self.lens, len(planes)), known.astype(np.complex64)
        start = SearchState(blurred_search(pixels, values, sought, Unknowns()))
        noise = noise_misfit(planes)
        search = JointSearch(pixels, self.kind, sought, 5, 80, noise, values, has_deviations=False)
        return search.run(start).unknowns.state

    def correlation(self, found: Array, true: Array) -> float:
        """Largest correlation of two objects over shift and focus, as the lens passes them."""
        numerical_aperture, wavelength = self.lens.object.numerical_aperture, self.light.wavelength_um
        x, y = (self.grid.x_mm - self.middle_mm[0], self.grid.y_mm - self.middle_mm[1])
        inside = np.hypot(x, y[:, None]) <= 0.5 * INNER * self.stop_mm
        if self.kind == "complex":
            found = self._evened(found, true, inside)

        def spectrum(values: Array) -> Array:
            left = np.where(inside, values - values[inside].mean(), 0.0)
            passed = band_limit(left, self.grid, wavelength, numerical_aperture)
            padded = np.zeros([2 * n for n in passed.shape], complex)
            padded[: len(passed), : len(passed)] = passed
            return np.fft.fft2(padded)

        one, other = spectrum(found), spectrum(true)
        sizes = math.sqrt(float(np.vdot(one, one).real * np.vdot(other, other).real))
        frequency = np.fft.fftfreq(len(one), 1e3 * self.grid.pitch_mm)
        sine = wavelength * np.hypot(frequency, frequency[:, None])
        axial = np.sqrt(np.clip(1.0 - sine**2, 0.0, None))
        best = 0.0
        for depths in REFOCUS_STEPS:
            way = np.exp(2j * np.pi / wavelength * depths * wavelength / numerical_aperture**2 * axial)
            product = one * other.conj() * way
            wide = np.zeros([2 * n for n in product.shape], complex)
            half = len(product) // 2
            for rows in (slice(0, half), slice(-half, None)):
                for columns in (slice(0, half), slice(-half, None)):
                    wide[rows, columns] = product[rows, columns]
            best = max(best, 4.0 * len(product) ** 2 * float(np.abs(np.fft.ifft2(wide)).max()) / sizes)
        return best

    def _evened(self, found: Array, true: Array, inside: Array) -> Array:
        """A found object without the smooth phase over it, slope and curvature, that may be the light's."""
        rows, columns = np.indices(found.shape) - 0.5 * (len(found) - 1)
        bent = (rows**2 + columns**2) * (2.0 * self.grid.pitch_mm / self.stop_mm) ** 2
        product, best = np.where(inside, found * true.conj(), 0.0), (0.0, np.zeros(found.shape))
        count = 4 * len(found)
        frequency = np.fft.fftfreq(count)
        for waves in CURVATURES_WAVES:
            likeness = np.abs(np.fft.fft2(product * np.exp(-2j * np.pi * waves * bent), (count, count)))
            down, across = np.unravel_index(int(likeness.argmax()), likeness.shape)
            if likeness[down, across] > best[0]:
                smooth = waves * bent + frequency[down] * rows + frequency[across] * columns
                best = float(likeness[down, across]), smooth
        return np.asarray(found * np.exp(-2j * np.pi * best[1]))


def thing(chain: Chain, seed: int = 11) -> Array:
    """Bars of many widths and places on a bright ground, which absorb light or, complex, delay it too."""
    rng = np.random.default_rng(seed)
    x, y = (chain.grid.x_mm - chain.middle_mm[0], chain.grid.y_mm - chain.middle_mm[1])
    bars = np.zeros(chain.grid.shape)
    radius = 0.36 * chain.stop_mm
    for _ in range(40):
        width, place = 1e-3 * rng.uniform(0.7, 3.0), radius * np.sqrt(rng.random())
        angle, turned, depth = 2 * np.pi * rng.random(), rng.random() < 0.5, rng.uniform(0.4, 1.0)
        cx, cy = place * np.cos(angle), place * np.sin(angle)
        across, along = (x[None, :] - cx, y[:, None] - cy) if turned else (y[:, None] - cy, x[None, :] - cx)
        for bar in (-1, 0, 1):
            shape = (np.abs(across - 2 * bar * width) < 0.5 * width) & (np.abs(along) < 2.5 * width)
            bars = np.where(shape, depth, bars)
    if chain.kind == "amplitude":
        return 1.0 - 0.9 * bars
    return np.asarray((1.0 - 0.4 * bars) * np.exp(1.2j * bars))
