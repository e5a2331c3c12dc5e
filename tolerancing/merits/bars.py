"""Bars that are carried through a perturbed lens to the sensor, and reconstructed through the nominal one."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens, Sensor
from tolerancing.merits.line_pairs import BARS
from tolerancing.merits.pupil import Axis
from wavesim.scene.placement import Placement

if TYPE_CHECKING:
    from wavesim import Engine, Measurement, PupilSampler
    from wavesim import Field as LightField
    from wavesim.sensor import Recording
    from wavesim.targets.patch import Patch

Ground = Literal["bright", "dark"]
Method = Literal["object", "paper"]
Point = tuple[float, float]

SIDE = 2 * BARS - 1
"""Of a set of bars, in line widths."""

TILE_ERROR = 0.05
"""Relative error that eikonal tiles may leave, as the commands of wavesim allow them."""

WINDOW_MARGIN = 1.1
"""By which the sensor's window is wider than the nominal light, as far as there are pixels."""

FULL_WELL_SHARE = 0.8
"""Of full well, in the brightest pixel."""

QUIET_TV = 0.01
"""Weight of the total variation where planes say nothing of their noise."""

LEAST_REFOCUS = 0.02
"""Depths of focus, wavelength / NA^2, up to which the object plane is left where it is."""

MIDDLE = 0.5
"""Share of a bar's or a gap's width and length, about its middle, over which intensity is averaged."""

DARK = 0.01
"""Of the brightest intensity: a bar and a gap that are darker together show nothing."""

POSITIONS = 17
"""At which a set of bars is looked for, across it, within half a line width on either side."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The nominal lens, and an object that is carried through perturbed copies of it and back.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    patch : Patch
        The object's samples and its field stop.
    sets : tuple of (axis, (x, y))
        Sets of bars: along which axis they follow each other, and where their middle is, in mm.
    line_width_um : float
        Of a bar and of a gap.
    ground : {"bright", "dark"}
        What is around the bars.
    """

    lens: Lens
    patch: Patch
    sets: tuple[tuple[Axis, Point], ...]
    line_width_um: float
    ground: Ground

    @property
    def planes_mm(self) -> tuple[float, ...]:
        """Where the sensor ought to record, from the exit vertex."""
        return self.lens.sensor.plane_distances_mm

    @cached_property
    def light(self) -> LightField:
        """The plane wave in the field stop."""
        from wavesim.targets.patch import make_illumination

        return make_illumination(self.patch)

    @cached_property
    def transmission(self) -> NDArray[np.complexfloating]:
        """Of the object."""
        from wavesim.fields.coverage import bar_rectangles, rectangle_coverage
        from wavesim.targets.patterns import on_ground

        width = 1e-3 * self.line_width_um
        shapes = [
            bar
            for axis, middle in self.sets
            for bar in bar_rectangles(width, BARS, axis, middle, SIDE * width)
        ]
        return on_ground(rectangle_coverage(self.patch.grid, shapes), self.ground).astype(np.complex64)

    @cached_property
    def sensor(self) -> Sensor:
        """The middle of the sensor, as much of it as light falls on, with some room."""
        import scipy.fft

        from wavesim.sensor.windows import sensor_window

        held = max(sensor_window(self.lens, self.patch, self.planes_mm).pixels)
        pixels = scipy.fft.next_fast_len(math.ceil(WINDOW_MARGIN * held))
        return sensor_window(self.lens, self.patch, self.planes_mm, min(pixels, *self.lens.sensor.pixels))

    @cached_property
    def sampler(self) -> PupilSampler:
        """Tells where and in which plane a perturbed lens shows the middle of the patch."""
        from wavesim import PupilSampler

        return PupilSampler(
            self.lens, wavelength_um=self.patch.wavelength_um, plane_distance_mm=self.planes_mm[0]
        )

    @cached_property
    def nominal(self) -> Engine:
        """Through the nominal lens to the first plane, one sample a pixel."""
        return self._model(0.0)

    def _model(self, refocus_mm: float) -> Engine:
        from wavesim.engines.choosing import engine_for
        from wavesim.sensor.windows import exit_scene

        scene = exit_scene(self.lens, self.patch, self.sensor, self.planes_mm[0])
        grid = scene.object_grid
        scene = replace(scene, object_grid=grid.at(grid.z_mm + refocus_mm))
        return engine_for(scene, "eikonal", error=TILE_ERROR)

    @cached_property
    def behind(self) -> LightField:
        """The light behind the object."""
        return self.light.with_values(self.light.values * self.transmission)

    def recording(
        self, system: Placement, electrons: float | None, bits: int, noise: np.random.SeedSequence | None
    ) -> Recording:
        """How a perturbed system records; parameters are those of :meth:`recorded`."""
        from wavesim import Electronics
        from wavesim.scene import Bench
        from wavesim.sensor import Recording

        full_well = {} if electrons is None else {"full_well_electrons": electrons / FULL_WELL_SHARE}
        electronics = Electronics(bits=bits, offset_counts=min(64.0, 2.0**bits / 16.0), **full_well)
        return Recording(self.planes_mm, electronics, noise, FULL_WELL_SHARE, bench=Bench(system))

    def recorded(
        self, system: Placement, electrons: float | None, bits: int, noise: np.random.SeedSequence
    ) -> list[Measurement]:
        """Amplitudes of one perturbed system, at the distances at which its planes ought to be.

        Light that falls beside the sensor, and saturated pixels, are lost as they are to a real one.

        Parameters
        ----------
        system
            The perturbed system.
        electrons, bits
            As of :class:`ReconstructedContrast`.
        noise
            Of the trial.

        Raises
        ------
        InputError, SamplingError
            If no light arrives, or samples cannot hold it on its way.
        """
        from wavesim import Measurement, SamplingWarning
        from wavesim.engines.choosing import engine_for
        from wavesim.sensor import FootprintWarning, SaturationWarning, image_patch, recorded_planes
        from wavesim.sensor.mounting import light_on
        from wavesim.sensor.recording import fields_on_sensor, recorded_scene
        from wavesim.sensor.sensor import light_on_pixels

        recording = self.recording(system, electrons, bits, noise)
        behind, windows = light_on(self.behind, system), [self.sensor] * len(self.planes_mm)
        with warnings.catch_warnings():
            for told in (FootprintWarning, SamplingWarning, SaturationWarning):
                warnings.simplefilter("ignore", told)
            scene = recorded_scene(self.lens, self.patch, self.sensor, recording)
            engine = engine_for(scene, "eikonal", error=TILE_ERROR)
            if electrons is not None:
                return recorded_planes(image_patch(engine, behind, self.sensor, windows, recording)[0])
            fields = fields_on_sensor(engine, behind, windows, recording)
            lit = [light_on_pixels(field, self.sensor) for field in fields]
        return [
            Measurement(distance - self.planes_mm[0], np.sqrt(light).astype(np.float32))
            for distance, light in zip(self.planes_mm, lit, strict=True)
        ]

    def reconstructed(
        self, planes: Sequence[Measurement], refocus_um: float, method: Method, iterations: int
    ) -> NDArray[np.complexfloating]:
        """Transmission of the object that is found behind recorded amplitudes, through the nominal lens.

        Parameters
        ----------
        planes
            As :meth:`recorded` gives them.
        refocus_um
            How much nearer to the lens than its place the object is sought.
        method, iterations
            As of :class:`ReconstructedContrast`.
        """
        from wavesim import reconstruct
        from wavesim.reconstruction.resumable import retrieve_resumably
        from wavesim.targets.patch import transmission_of

        depth_um = self.patch.wavelength_um / self.lens.object.numerical_aperture**2
        moved = abs(refocus_um) > LEAST_REFOCUS * depth_um
        engine = self._model(1e-3 * refocus_um) if moved else self.nominal
        light = replace(self.light, grid=engine.scene.object_grid)
        if method == "paper":
            field = retrieve_resumably(engine, light, planes, iterations=iterations)[0].field
            return np.asarray(transmission_of(engine.adjoint(field), light).values)
        if self.ground == "dark":
            # Dark pixels weigh least, and would tell most.
            planes = [replace(plane, sigma=None) for plane in planes]
        noisy = planes[0].sigma is not None
        found = reconstruct(
            engine,
            light,
            planes,
            kind="amplitude",
            tv_weight="auto" if noisy else QUIET_TV,
            iterations=iterations,
            scale=1.0,
            fill_factor=1.0,
        )
        return np.asarray(found.transmission.values)

    def contrasts(self, transmission: NDArray[np.complexfloating], shift_um: Array) -> list[float]:
        """(bright - dark) / (bright + dark) of each set of bars, where it shows.

        Defocused intensities hardly tell where an object is: what is found may lie anywhere between its place
        and where rays show it. Fine detail like that of all sets tells where; each set is then judged
        where its contrast is largest within half a line width of there.

        Parameters
        ----------
        transmission
            That was found.
        shift_um : (x, y)
            By how much rays show the object beside its place.

        Raises
        ------
        InputError
            If bars may show beyond the field stop.
        """
        width = 1e-3 * self.line_width_um
        ends = np.sort([np.zeros(2), 1e-3 * np.asarray(shift_um, float)], axis=0)
        ends += np.array([[-width], [width]])
        reach = np.max(np.abs([middle for _, middle in self.sets]), axis=0) + 0.5 * SIDE * width
        if np.hypot(*(reach + np.max(np.abs(shift_um)) * 1e-3)) > 0.5 * self.patch.field_stop_mm:
            raise InputError(
                f"rays show the bars ({shift_um[0]:.3g}, {shift_um[1]:.3g}) um beside their place, beyond "
                f"the field stop of patch_mm = {self.patch.field_stop_mm:g}: take a larger patch"
            )
        power = np.abs(transmission) ** 2
        moved = self._displacement_mm(power, ends)
        return [self._contrast(power, axis, np.array(middle) + moved) for axis, middle in self.sets]

    def _displacement_mm(self, power: Array, ends_mm: Array) -> Array:
        """Where between two corners the picture's fine detail is most like the object's."""
        import scipy.fft

        grid = self.patch.grid
        ground = float(self.ground == "bright")
        known = self._detail(np.abs(self.transmission) ** 2)
        shown = self._detail(np.where(self.patch.inside, power, ground))
        spectra = [scipy.fft.rfft2(part) for part in (shown, known)]
        likeness = scipy.fft.irfft2(spectra[0] * spectra[1].conj(), grid.shape)
        steps = [scipy.fft.fftfreq(n, 1.0 / n) * grid.pitch_mm for n in grid.shape]
        (low_x, low_y), (high_x, high_y) = ends_mm
        rows = np.flatnonzero((steps[0] >= low_y) & (steps[0] <= high_y))
        columns = np.flatnonzero((steps[1] >= low_x) & (steps[1] <= high_x))
        best = np.argmax(likeness[np.ix_(rows, columns)])
        row, column = np.unravel_index(best, (len(rows), len(columns)))
        return np.array([steps[1][columns[column]], steps[0][rows[row]]])

    def _detail(self, power: Array) -> Array:
        """A picture less what is coarser than bars, such as the shade of a stop that is not in its place."""
        from scipy.ndimage import gaussian_filter

        blur = 2e-3 * self.line_width_um / self.patch.grid.pitch_mm
        return np.asarray(power - gaussian_filter(power, blur, mode="nearest"))

    def _contrast(self, power: Array, axis: Axis, shown_mm: Array) -> float:
        """Of a set of bars about a point, or as far beside it as half a line width, where it is largest.

        Each gap is held against the bars on either side of it; the mean of all.
        """
        grid, width = self.patch.grid, 1e-3 * self.line_width_um
        across, along = (0, 1) if axis == "x" else (1, 0)
        lines = power if axis == "x" else power.T
        coordinates = (grid.x_mm, grid.y_mm)
        away = np.abs(coordinates[along] - shown_mm[along]) - 0.5 * MIDDLE * SIDE * width
        weights = np.clip(0.5 - away / grid.pitch_mm, 0.0, 1.0)
        edges = coordinates[across][0] + grid.pitch_mm * (np.arange(grid.shape[1 - across] + 1) - 0.5)
        running = np.concatenate([[0.0], np.cumsum(weights @ lines)])
        parts = shown_mm[across] + width * (np.arange(SIDE) - SIDE // 2)
        middles = parts + width * np.linspace(-0.5, 0.5, POSITIONS)[:, None]
        half = 0.5 * MIDDLE * width
        ends = [np.interp(middles + side * half, edges, running) for side in (-1.0, 1.0)]
        means = np.diff(ends, axis=0)[0] / (weights.sum() * 2.0 * half / grid.pitch_mm)
        bars, gaps = 0.5 * (means[:, 0:-1:2] + means[:, 2::2]), means[:, 1::2]
        bright, dark = (bars, gaps) if self.ground == "dark" else (gaps, bars)
        light = np.maximum(bright + dark, DARK * np.max(power))
        return float(np.max(np.mean((bright - dark) / light, axis=1)))
