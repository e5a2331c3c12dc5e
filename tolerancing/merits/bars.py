"""Bar targets imaged through a perturbed lens onto the sensor and reconstructed through the nominal lens."""

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
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    from wavesim import Electronics, Engine, Measurement, PupilSampler
    from wavesim import Field as LightField
    from wavesim.sensor import Recording
    from wavesim.targets.patch import Patch

Ground = Literal["bright", "dark"]
Method = Literal["object", "paper"]
Point = tuple[float, float]

SIDE = 2 * BARS - 1
"""Side of a set of bars, in line widths."""

TILE_ERROR = 0.05
"""Largest relative error of the eikonal tiles; the default of the commands of wavesim."""

DARK = 0.01
"""Smallest sum of bar and gap intensity, relative to the brightest intensity. Below it contrast is
reduced."""


PEAK_FILL = 0.8
"""Signal of the brightest pixel, as a fraction of full well."""


def electronics_for(electrons: float | None, bits: int) -> Electronics:
    """Return the electronics whose brightest pixel receives a number of electrons; None: the default."""
    from wavesim import Electronics

    full_well = {} if electrons is None else {"full_well_electrons": electrons / PEAK_FILL}
    return Electronics(bits=bits, offset_counts=min(64.0, 2.0**bits / 16.0), **full_well)


@dataclass(frozen=True, eq=False)
class BarImagingChain:
    """A bar target, imaged through perturbed lenses and reconstructed through the nominal lens.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    patch : Patch
        Samples of the object and its field stop.
    sets : tuple of (axis, (x, y))
        Sets of bars: the axis along which the bars repeat, and the centre of the set in mm.
    line_width_um : float
        Width of a bar and of a gap.
    ground : {"bright", "dark"}
        Polarity of the target: opaque bars on a bright ground, or transparent bars on a dark ground.
    """

    lens: Lens
    patch: Patch
    sets: tuple[tuple[Axis, Point], ...]
    line_width_um: float
    ground: Ground

    @property
    def planes_mm(self) -> tuple[float, ...]:
        """Nominal distances of the sensor planes from the exit vertex."""
        return self.lens.sensor.plane_distances_mm

    @cached_property
    def light(self) -> LightField:
        """Illumination: a plane wave in the field stop."""
        from wavesim.targets.patch import make_illumination

        return make_illumination(self.patch)

    @cached_property
    def transmission(self) -> NDArray[np.complexfloating]:
        """Complex transmission of the object."""
        from wavesim.fields.coverage import rectangle_coverage
        from wavesim.targets.bars import bar_rectangles
        from wavesim.targets.patterns import with_polarity

        width = 1e-3 * self.line_width_um
        shapes = [
            bar
            for axis, centre in self.sets
            for bar in bar_rectangles(width, BARS, axis, centre, SIDE * width)
        ]
        return with_polarity(rectangle_coverage(self.patch.grid, shapes), self.ground).astype(np.complex64)

    @cached_property
    def sensor(self) -> Sensor:
        """Central window of the sensor that contains the nominal light with a margin of 10 %."""
        import scipy.fft

        from wavesim.sensor.windows import sensor_window

        illuminated = max(sensor_window(self.lens, self.patch, self.planes_mm).pixels)
        pixels = scipy.fft.next_fast_len(math.ceil(1.1 * illuminated))
        return sensor_window(self.lens, self.patch, self.planes_mm, min(pixels, *self.lens.sensor.pixels))

    @cached_property
    def sampler(self) -> PupilSampler:
        """Pupil sampler at the patch centre, which gives the image shift and defocus of a perturbed lens."""
        from wavesim import PupilSampler

        return PupilSampler(
            self.lens, wavelength_um=self.patch.wavelength_um, plane_distance_mm=self.planes_mm[0]
        )

    @cached_property
    def nominal(self) -> Engine:
        """Engine from the object through the nominal lens to the first plane, one sample per pixel."""
        return self._model(0.0)

    def _model(self, refocus_mm: float) -> Engine:
        from wavesim.engines.choosing import engine_for
        from wavesim.sensor.windows import exit_scene

        scene = exit_scene(self.lens, self.patch, self.sensor, self.planes_mm[0])
        grid = scene.object_grid
        scene = replace(scene, object_grid=grid.at(grid.z_mm + refocus_mm))
        return engine_for(scene, "eikonal", error=TILE_ERROR)

    @cached_property
    def object_field(self) -> LightField:
        """Field behind the object."""
        return self.light.with_values(self.light.values * self.transmission)

    def recording(
        self, system: SystemState, electrons: float | None, bits: int, noise: np.random.SeedSequence | None
    ) -> Recording:
        """Return the recording settings of a perturbed system; parameters as for :meth:`record`."""
        from wavesim.sensor import Camera, Recording

        electronics = electronics_for(electrons, bits)
        camera = Camera(self.sensor, electronics, peak_fill=PEAK_FILL)
        return Recording(camera, self.planes_mm, noise, system)

    def record(
        self, system: SystemState, electrons: float | None, bits: int, noise: np.random.SeedSequence
    ) -> list[Measurement]:
        """Simulate the recorded amplitudes of one perturbed system, labelled with the nominal distances.

        Light outside the sensor and signal above saturation are lost, as with a real sensor.

        Parameters
        ----------
        system
            The perturbed system.
        electrons
            Electrons in the brightest pixel of each frame; None: mean intensity without noise.
        bits
            Bits of a count.
        noise
            Seed of the trial's noise.

        Raises
        ------
        InputError
            If no light reaches the sensor.
        SamplingError
            If the sampling cannot represent the field on its way.
        """
        from wavesim import Measurement, SamplingWarning
        from wavesim.engines.choosing import engine_for
        from wavesim.scene.scene import placed_light
        from wavesim.sensor import FootprintWarning, Recorder, SaturationWarning, recorded_planes
        from wavesim.sensor.sensor import light_on_pixels
        from wavesim.sensor.surface_scatter import (
            halos_on_plane,
            scatter_of_patch,
            with_scattered_light,
        )

        recording = self.recording(system, electrons, bits, noise)
        field = placed_light(self.object_field, system)
        with warnings.catch_warnings():
            for category in (FootprintWarning, SamplingWarning, SaturationWarning):
                warnings.simplefilter("ignore", category)
            engine = engine_for(recording.scene(self.lens, self.patch), "eikonal", error=TILE_ERROR)
            recorder = Recorder(recording, engine)
            if electrons is not None:
                return recorded_planes(recorder.frames(field)[0])
            scatter = scatter_of_patch(
                self.lens, self.patch.grid, field.wavelength_um, self.planes_mm, system
            )
            intensities = [
                with_scattered_light(
                    light_on_pixels(one, self.sensor),
                    self.sensor.pixel_pitch_um,
                    halos_on_plane(scatter, index),
                )
                for index, one in enumerate(recorder.fields(field))
            ]
        return [
            Measurement(distance - self.planes_mm[0], np.sqrt(intensity).astype(np.float32))
            for distance, intensity in zip(self.planes_mm, intensities, strict=True)
        ]

    def reconstruct(
        self, planes: Sequence[Measurement], refocus_um: float, method: Method, iterations: int
    ) -> NDArray[np.complexfloating]:
        """Reconstruct the transmission of the object from recorded amplitudes, through the nominal lens.

        Parameters
        ----------
        planes
            Amplitudes from :meth:`record`.
        refocus_um
            Shift of the reconstructed object plane towards the lens.
        method, iterations
            Method and largest number of iterations; see
            :class:`tolerancing.merits.reconstructed_contrast.ReconstructedContrast`.
        """
        from wavesim import reconstruct
        from wavesim.reconstruction.resumable import retrieve_resumably
        from wavesim.targets.patch import transmission_of

        # A shift below 2 % of the depth of focus, wavelength / NA^2, does not need another engine.
        depth_um = self.patch.wavelength_um / self.lens.object.numerical_aperture**2
        is_shifted = abs(refocus_um) > 0.02 * depth_um
        engine = self._model(1e-3 * refocus_um) if is_shifted else self.nominal
        light = replace(self.light, grid=engine.scene.object_grid)
        if method == "paper":
            field = retrieve_resumably(engine, light, planes, iterations=iterations)[0].field
            return np.asarray(transmission_of(engine.adjoint(field), light).values)
        if self.ground == "dark":
            # On a dark ground, dark pixels have the smallest weights although they carry most information.
            planes = [replace(plane, sigma=None) for plane in planes]
        has_noise = planes[0].sigma is not None
        found = reconstruct(
            engine,
            light,
            planes,
            kind="amplitude",
            tv_weight="auto" if has_noise else 0.01,
            iterations=iterations,
            scale=1.0,
            fill_factor=1.0,
        )
        return np.asarray(found.transmission.values)

    def contrasts(self, transmission: NDArray[np.complexfloating], shift_um: Array) -> list[float]:
        """Return the contrast (bright - dark) / (bright + dark) of each set of bars.

        Defocused intensities hardly determine the lateral position, so the reconstructed object may lie
        anywhere between its nominal position and the position that rays predict. Cross-correlation of fine
        detail gives the displacement of all sets. The contrast of each set is then the largest within half a
        line width.

        Parameters
        ----------
        transmission
            Reconstructed transmission.
        shift_um : (x, y)
            Lateral shift of the image in the object plane, as predicted by rays.

        Raises
        ------
        InputError
            If the displaced bars may lie outside the field stop.
        """
        width = 1e-3 * self.line_width_um
        ends = np.sort([np.zeros(2), 1e-3 * np.asarray(shift_um, float)], axis=0)
        ends += np.array([[-width], [width]])
        extent = np.max(np.abs([centre for _, centre in self.sets]), axis=0) + 0.5 * SIDE * width
        if np.hypot(*(extent + np.max(np.abs(shift_um)) * 1e-3)) > 0.5 * self.patch.field_stop_mm:
            raise InputError(
                f"patch_mm = {self.patch.field_stop_mm:g}: the image is shifted by ({shift_um[0]:.3g}, "
                f"{shift_um[1]:.3g}) µm, so that bars lie outside the field stop: use a larger patch_mm"
            )
        power = np.abs(transmission) ** 2
        displacement = self._displacement_mm(power, ends)
        return [self._contrast(power, axis, np.array(centre) + displacement) for axis, centre in self.sets]

    def _displacement_mm(self, power: Array, ends_mm: Array) -> Array:
        """Return the displacement between two corners with the largest cross-correlation of fine detail."""
        import scipy.fft

        grid = self.patch.grid
        ground = float(self.ground == "bright")
        true = self._detail(np.abs(self.transmission) ** 2)
        found = self._detail(np.where(self.patch.inside, power, ground))
        spectra = [scipy.fft.rfft2(image) for image in (found, true)]
        correlation = scipy.fft.irfft2(spectra[0] * spectra[1].conj(), grid.shape)
        steps = [scipy.fft.fftfreq(n, 1.0 / n) * grid.pitch_mm for n in grid.shape]
        (low_x, low_y), (high_x, high_y) = ends_mm
        rows = np.flatnonzero((steps[0] >= low_y) & (steps[0] <= high_y))
        columns = np.flatnonzero((steps[1] >= low_x) & (steps[1] <= high_x))
        best = np.argmax(correlation[np.ix_(rows, columns)])
        row, column = np.unravel_index(best, (len(rows), len(columns)))
        return np.array([steps[1][columns[column]], steps[0][rows[row]]])

    def _detail(self, power: Array) -> Array:
        """Remove structure coarser than the bars, such as the shadow of a displaced field stop."""
        from scipy.ndimage import gaussian_filter

        blur = 2e-3 * self.line_width_um / self.patch.grid.pitch_mm
        return np.asarray(power - gaussian_filter(power, blur, mode="nearest"))

    def _contrast(self, power: Array, axis: Axis, centre_mm: Array) -> float:
        """Return the largest contrast of a set of bars within half a line width of its centre.

        Each gap is compared with its two neighbouring bars. The contrast of the set is the mean of all gaps.
        """
        grid, width = self.patch.grid, 1e-3 * self.line_width_um
        across, along = (0, 1) if axis == "x" else (1, 0)
        lines = power if axis == "x" else power.T
        coordinates = (grid.x_mm, grid.y_mm)
        # Central fraction of a bar's or a gap's width and length over which intensity is averaged.
        middle = 0.5
        outside = np.abs(coordinates[along] - centre_mm[along]) - 0.5 * middle * SIDE * width
        weights = np.clip(0.5 - outside / grid.pitch_mm, 0.0, 1.0)
        edges = coordinates[across][0] + grid.pitch_mm * (np.arange(grid.shape[1 - across] + 1) - 0.5)
        cumulative = np.concatenate([[0.0], np.cumsum(weights @ lines)])
        nominal = centre_mm[across] + width * (np.arange(SIDE) - SIDE // 2)
        centres = nominal + width * np.linspace(-0.5, 0.5, 17)[:, None]
        half = 0.5 * middle * width
        ends = [np.interp(centres + side * half, edges, cumulative) for side in (-1.0, 1.0)]
        means = np.diff(ends, axis=0)[0] / (weights.sum() * 2.0 * half / grid.pitch_mm)
        bars, gaps = 0.5 * (means[:, 0:-1:2] + means[:, 2::2]), means[:, 1::2]
        bright, dark = (bars, gaps) if self.ground == "dark" else (gaps, bars)
        light = np.maximum(bright + dark, DARK * np.max(power))
        return float(np.max(np.mean((bright - dark) / light, axis=1)))
