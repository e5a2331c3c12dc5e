"""The whole imaging chain on a meridional line: object, frames of a perturbed lens, reconstruction."""

from __future__ import annotations

import math
import warnings
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy.fft

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.bars import PEAK_FILL, electronics_for
from tolerancing.merits.reconstruction.matrices import MATRICES
from tolerancing.merits.reconstruction.objects import LineObject, LineScores, ObjectKind
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.scene.engine import Engine, GridPair, Grids, Operator
from wavesim.scene.patches import OBJECT_FINENESS
from wavesim.scene.scene import Scene, placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.pixel_integration import means_over_pixels

if TYPE_CHECKING:
    from wavesim import Frame

SAMPLES_PER_PIXEL, FILL_FACTOR = 2, 1.0
"""Samples per pixel of the simulated frames, and linear fill factor of the pixels."""

EngineName = Literal["eikonal", "slices"]
Compensation = Literal["vertical", "oblique"]


@dataclass(frozen=True)
class ReconstructionEngine:
    """The engine of the reconstruction's model.

    Attributes
    ----------
    name : {"eikonal", "slices"}
        Name of the engine.
    slices : int
        Slices of each surface.
    compensation : {"vertical", "oblique"}
        Direction of the phase compensation within a slice.
    """

    name: EngineName
    slices: int = 0
    compensation: Compensation = "oblique"

    @property
    def settings(self) -> dict[str, Any]:
        """Keyword arguments of :func:`wavesim.engine_for`."""
        if self.name == "eikonal":
            return {}
        return {"slices": self.slices, "compensation": self.compensation}


@dataclass(frozen=True, eq=False)
class LineImagingChain:
    """Imaging and reconstruction of one region of the object on a meridional line.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    field_mm : float
        Height of the centre of the region, along y.
    region_mm : float
        Length of the region, which is limited by a field stop.
    planes_mm : tuple of float
        Distances of the sensor planes from the exit vertex.
    kind : {"lines", "amplitude", "complex"}
        Kind of the object; see :class:`LineObject`.
    line_widths_um : tuple of float
        Line widths of the sets of bars.
    wavelength_um : float
        Vacuum wavelength.
    imaging : {"eikonal", "slices"}
        Engine that propagates the light of the object to the sensor.
    imaging_slices : int
        Number of oblique slices of each surface, for the imaging engine ``slices``.
    margin_mm : float
        Margin on both sides of the region, needed if the object is reconstructed in a shifted plane.
    """

    lens: Lens
    field_mm: float
    region_mm: float
    planes_mm: tuple[float, ...]
    kind: ObjectKind
    line_widths_um: tuple[float, ...]
    wavelength_um: float
    imaging: EngineName = "eikonal"
    imaging_slices: int = 100
    margin_mm: float = 0.008

    @cached_property
    def scene(self) -> Scene:
        """Scene from the region to the pixels of the first plane, along y."""
        aperture = self.lens.object.numerical_aperture
        pitch_um = OBJECT_FINENESS * 0.5 * self.wavelength_um / aperture
        if self.line_widths_um:
            # At least two samples across the finest line.
            pitch_um = min(pitch_um, min(self.line_widths_um) / 2.0)
        count = scipy.fft.next_fast_len(max(8, math.ceil(1e3 * self.region_mm / pitch_um)))
        pitch_mm = self.region_mm / count
        grid = Grid((count,), pitch_mm, self.lens.object_z_mm, (0.0, self.field_mm))
        return Scene(self.lens, grid, self._sensor_grid(0, AS_DESIGNED), self.wavelength_um)

    @cached_property
    def object(self) -> LineObject:
        """The imaged object."""
        aperture = self.lens.object.numerical_aperture
        return LineObject(
            self.kind, self.line_widths_um, self.scene.object_grid, aperture, self.wavelength_um
        )

    def record(
        self, system: SystemState, electrons: float | None, bits: int, noise: np.random.SeedSequence | None
    ) -> list[Measurement]:
        """Simulate the amplitudes that the pixels record behind a perturbed system, on every plane.

        Parameters
        ----------
        system
            The perturbed system.
        electrons
            Electrons in the brightest pixel of each plane; None: mean intensity without noise.
        bits
            Bits of a count.
        noise
            Seed of the noise.

        Raises
        ------
        InputError
            If no light reaches the sensor.
        """
        from wavesim import propagate
        from wavesim.scene.scene import placed_light

        nominal = replace(self.scene, exit_grid=self._sensor_grid(0, system))
        settings = {"slices": self.imaging_slices, "compensation": "oblique"}
        engine = _engine(placed_scene(nominal, system), self.imaging, settings)
        first = engine.forward(
            placed_light(self._light(self.scene).with_values(self.object.transmission), system)
        )
        planes = []
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for index, distance in enumerate(self.planes_mm):
                grid = self._sensor_grid(index, system)
                field = first if grid == first.grid else propagate(first, grid, coarse_output=True)
                light = means_over_pixels(np.abs(field.values) ** 2, SAMPLES_PER_PIXEL, FILL_FACTOR)
                planes.append((distance - self.planes_mm[0], np.sqrt(np.maximum(light, 0.0))))
        if not all(np.any(amplitude > 0.0) for _, amplitude in planes):
            raise InputError(
                f"field height {self.field_mm:g} mm: no light reaches the sensor, because the image of the "
                "region lies outside it"
            )
        if electrons is None:
            return [Measurement(*plane) for plane in planes]
        return self._with_noise(planes, electrons, bits, noise)

    def reconstruct(
        self,
        planes: Sequence[Measurement],
        engine: ReconstructionEngine,
        *,
        model: SystemState = AS_DESIGNED,
        refocus_um: float = 0.0,
        iterations: int,
    ) -> LineScores:
        """Reconstruct the object from recorded amplitudes and score the result.

        Parameters
        ----------
        planes
            Amplitudes from :meth:`record`.
        engine
            Engine of the reconstruction.
        model
            System that the reconstruction assumes; default: the nominal system.
        refocus_um
            Shift of the reconstructed object plane towards the lens.
        iterations
            Largest number of iterations.
        """
        operator = self.operator(engine, model, refocus_um)
        distances_mm = [self._sensor_grid(index, model).z_mm for index in range(len(planes))]
        found = reconstruct(
            operator,
            self._light(placed_scene(self.scene, model), operator.scene.object_grid),
            [
                replace(plane, distance_mm=distance_mm - distances_mm[0])
                for plane, distance_mm in zip(planes, distances_mm, strict=True)
            ],
            kind="complex" if self.object.is_complex else "amplitude",
            iterations=iterations,
            scale=1.0,
            fill_factor=FILL_FACTOR,
            residuals=False,
        )
        margin = (found.transmission.grid.size - self.scene.object_grid.size) // 2
        region = slice(margin, margin + self.scene.object_grid.size)
        return self.object.score(found.transmission.values[region])

    def operator(
        self, engine: ReconstructionEngine, model: SystemState = AS_DESIGNED, refocus_um: float = 0.0
    ) -> Operator:
        """Return the reconstruction's operator from the object to the pixels of the first plane.

        Parameters are those of :meth:`reconstruct`. The object grid is the region with its margin.

        Raises
        ------
        InputError
            If the shift of the object plane is larger than the margin of the region allows.
        """
        # A shift below 2 % of the depth of focus, wavelength / NA^2, is ignored.
        depth_um = self.wavelength_um / self.lens.object.numerical_aperture**2
        is_shifted = abs(refocus_um) > 0.02 * depth_um
        if is_shifted and abs(refocus_um) > self.largest_refocus_um:
            raise InputError(
                f"the region is in focus {refocus_um:.3g} µm from the object plane; allowed: "
                f"{-self.largest_refocus_um:.3g} to {self.largest_refocus_um:.3g} µm; use refocus = false"
            )
        if engine.name == "slices" and model == AS_DESIGNED:
            operator: Operator = MATRICES.matrix(self._model_engine(engine))
        else:
            operator = _engine(self._model_scene(model), engine.name, engine.settings)
        if not is_shifted:
            return operator
        return RefocusedOperator(operator, 1e-3 * refocus_um, self.wavelength_um)

    @property
    def largest_refocus_um(self) -> float:
        """Largest shift of the object plane for which marginal rays stay within the margin."""
        return 1e3 * self.margin_mm / math.tan(math.asin(min(self.lens.object.numerical_aperture, 0.99)))

    def setup(self, engine: ReconstructionEngine) -> dict[Hashable, float]:
        """Return the key of an engine's matrix and the seconds to compute it; empty if it is cached."""
        built = self._model_engine(engine)
        return {} if built.key() in MATRICES else {built.key(): MATRICES.seconds(built)}

    def _model_engine(self, engine: ReconstructionEngine) -> Engine:
        key = engine
        if key not in self._engines:
            self._engines[key] = _engine(self._model_scene(AS_DESIGNED), engine.name, engine.settings)
        return self._engines[key]

    @cached_property
    def _engines(self) -> dict[ReconstructionEngine, Engine]:
        return {}

    def _model_scene(self, model: SystemState) -> Scene:
        """Return the scene of the reconstruction's model, from the region with margin to the first plane."""
        pixels = self._sensor_grid(0, model, samples_per_pixel=1)
        scene = placed_scene(replace(self.scene, exit_grid=pixels), model)
        grid = scene.object_grid
        margin = math.ceil(self.margin_mm / grid.pitch_mm)
        return replace(scene, object_grid=replace(grid, shape=(grid.shape[0] + 2 * margin,)))

    def _light(self, scene: Scene, grid: Grid | None = None) -> Field:
        """Return a plane wave along the axis in the field stop, which is the region itself.

        A grid with margins on both sides of the region is dark there.
        """
        region = scene.object_grid
        grid = grid or region
        margin = (grid.size - region.size) // 2
        return Field(grid, np.pad(np.ones(region.shape, complex), margin), scene.wavelength_um)

    def _sensor_grid(
        self, index: int, system: SystemState, samples_per_pixel: int = SAMPLES_PER_PIXEL
    ) -> Grid:
        sensor = self.lens.sensor
        z_mm = self.lens.exit_vertex_z_mm + self.planes_mm[index] + system.sensor_pose(index).distance_mm
        pitch = 1e-3 * sensor.pixel_pitch_um / samples_per_pixel
        count = samples_per_pixel * sensor.pixels[1]
        return Grid((count,), pitch, z_mm, (0.0, system.sensor_shift_mm[1]))

    def _with_noise(
        self,
        planes: Sequence[tuple[float, Array]],
        electrons: float,
        bits: int,
        noise: np.random.SeedSequence | None,
    ) -> list[Measurement]:
        """Return the amplitudes that follow from noisy frames of one exposure."""
        from wavesim.sensor import recorded_planes
        from wavesim.sensor.camera_noise import plane_seeds
        from wavesim.sensor.sensor import Camera

        camera = Camera(self.lens.sensor, electronics_for(electrons, bits), peak_fill=PEAK_FILL)
        frames: list[Frame] = []
        for (_, amplitude), distance, seed in zip(
            planes, self.planes_mm, plane_seeds(noise, len(planes)), strict=True
        ):
            frames += camera.frames(amplitude[:, None] ** 2, distance, self.wavelength_um, seed)
        lines = recorded_planes(frames)
        return [
            replace(p, amplitude=p.amplitude[:, 0], sigma=None if p.sigma is None else p.sigma[:, 0])
            for p in lines
        ]


class RefocusedOperator:
    """Operator from an object plane that is shifted along the axis.

    Parameters
    ----------
    operator
        Operator from the plane that is not shifted.
    towards_lens_mm
        Shift of the object plane towards the lens.
    wavelength_um
        Vacuum wavelength.
    """

    def __init__(self, operator: Operator, towards_lens_mm: float, wavelength_um: float) -> None:
        self.operator, grid = operator, operator.scene.object_grid
        shifted = grid.at(grid.z_mm + towards_lens_mm)
        self.scene: Grids = GridPair(shifted, operator.scene.exit_grid)
        self._to_operator = FreeSpacePropagator(shifted, grid, wavelength_um)

    def forward(self, field: Field) -> Field:
        """Propagate a field from the shifted plane."""
        values = self._to_operator.forward(field.values)
        return self.operator.forward(Field(self.operator.scene.object_grid, values, field.wavelength_um))

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint of :meth:`forward`."""
        values = self._to_operator.adjoint(self.operator.adjoint(field).values)
        return Field(self.scene.object_grid, values, field.wavelength_um)


def _engine(scene: Scene, name: str, settings: dict[str, Any]) -> Engine:
    """Return an engine without its warning about few slices, whose number a study may vary on purpose."""
    from wavesim import engine_for

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return engine_for(scene, name, **(settings if name == "slices" else {}))
