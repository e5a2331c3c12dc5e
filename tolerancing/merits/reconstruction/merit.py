"""The merit `reconstruction`: quality of an object reconstructed through the whole imaging chain.

Light of an object on a meridional line propagates through the perturbed lens to the sensor planes, where the
pixels record amplitudes. The reconstruction finds the object from these amplitudes with its own model of the
lens. The model may use another engine, and may be nominal, calibrated or exact.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import FiniteNumber, Positive
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point, points_text, refocus_text
from tolerancing.merits.context import Context, Points
from tolerancing.merits.line_pairs import NOISE_STREAM
from tolerancing.merits.reconstruction.objects import ObjectKind, required_length_mm
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter, validate_in_meridian
from wavesim.scene.system_state import AS_DESIGNED, SystemState

if TYPE_CHECKING:
    from tolerancing.merits.reconstruction.line_imaging_chain import LineImagingChain, ReconstructionEngine
    from tolerancing.merits.reconstruction.objects import LineScores

Figure = Literal["correlation", "contrast", "lost_correlation"]
Model = Literal["nominal", "calibrated", "true"]

LEAST_CORRELATION = 0.97
"""Smallest accepted correlation of the unperturbed chain. Below it, planes or region are not sufficient."""


class Reconstruction(Merit):
    """Correlation of the reconstructed object, or contrast of its lines, after the whole imaging chain.

    Merits that differ only in figure, line width, limit and name share one run of the chain in each trial.

    Attributes
    ----------
    figure
        ``correlation`` of reconstructed and true object about their means, ``contrast`` of its lines, or
        ``lost_correlation``, which is 1 minus the correlation.
    object
        ``lines`` on a uniform bright ground, or on a ground of random transmission: ``amplitude`` or
        ``complex``.
    line_widths_um
        Line widths of the sets of five bars, which lie side by side.
    line_width_um
        Lines whose contrast is evaluated; default: the finest lines.
    region_mm
        Length of the region about each field point, which is limited by a field stop.
    field_mm
        Object point (0, y).
    field_points_mm
        Several object points instead of one; the worst of their scores counts.
    planes_mm
        Distances of the sensor planes from the exit vertex; default: the planes of the design.
    electrons
        Electrons in the brightest pixel of each plane, with shot noise, 2 electrons of read noise and
        rounding to counts; default: mean intensity of each pixel without noise.
    bits
        Bits of a count.
    imaging_engine, imaging_slices
        Engine that propagates light to the sensor: ``eikonal``, or ``slices`` with this number of oblique
        slices of each surface.
    reconstruction_engine, slices, compensation
        Engine of the reconstruction's model: ``eikonal``, or ``slices`` with this number of slices of each
        surface and ``vertical`` (as in the paper) or ``oblique`` compensation.
    model
        Lens that the reconstruction assumes: ``nominal``; ``calibrated``, with the study's compensators
        fitted to each trial; or ``true``, the perturbed lens itself.
    iterations
        Largest number of iterations.
    refocus
        Whether the object is reconstructed in the plane in which rays show it in focus.
    line
        The chain is simulated on a meridional line along y; a plane is not supported.
    """

    figure: Figure = "correlation"
    object: ObjectKind = "lines"
    line_widths_um: Annotated[tuple[Positive, ...], Field(min_length=1)]
    line_width_um: Positive | None = None
    region_mm: Positive
    field_mm: tuple[FiniteNumber, FiniteNumber] = (0.0, 0.0)
    field_points_mm: tuple[tuple[FiniteNumber, FiniteNumber], ...] = ()
    planes_mm: tuple[Positive, ...] = ()
    electrons: Annotated[float, Field(ge=10.0, le=1e9)] | None = None
    bits: Annotated[int, Field(ge=4, le=16)] = 12
    imaging_engine: Literal["eikonal", "slices"] = "eikonal"
    imaging_slices: Annotated[int, Field(ge=1, le=5000)] = 100
    reconstruction_engine: Literal["eikonal", "slices"] = "eikonal"
    slices: Annotated[int, Field(ge=1, le=5000)] = 200
    compensation: Literal["vertical", "oblique"] = "oblique"
    model: Model = "nominal"
    iterations: Annotated[int, Field(ge=1, le=1000)] = 40
    refocus: bool = False
    line: Literal[True] = True

    levels: ClassVar[tuple[str, ...]] = ("wave",)
    trials_per_chunk: ClassVar[int] = 1
    engine: ClassVar[str] = "whole chain on a line"

    @model_validator(mode="after")
    def _consistent(self) -> Reconstruction:
        if self.field_points_mm and "field_mm" in self.model_fields_set:
            raise ValueError("give field_mm or field_points_mm, not both")
        if len(set(self.line_widths_um)) < len(self.line_widths_um):
            raise ValueError(
                f"line_widths_um = {list(self.line_widths_um)}: must be different from each other"
            )
        if self.line_width_um is not None and self.line_width_um not in self.line_widths_um:
            listed = ", ".join(f"{width:g}" for width in self.line_widths_um)
            raise ValueError(
                f"line_width_um = {self.line_width_um:g}: allowed: the values of line_widths_um, {listed}"
            )
        if self.line_width_um is not None and self.figure != "contrast":
            raise ValueError(
                f"line_width_um: figure = {self.figure!r} is evaluated on the whole object; remove this key"
            )
        if required_length_mm(self.line_widths_um) > self.region_mm:
            raise ValueError(
                f"region_mm = {self.region_mm:g}: the lines of line_widths_um need "
                f"{required_length_mm(self.line_widths_um):.3g} mm or more"
            )
        for x, y in self.points:
            if x:
                raise ValueError(f"field point ({x:g}, {y:g}): must be on the meridional line along y, x = 0")
        given = {"slices", "compensation"} & self.model_fields_set
        if self.reconstruction_engine == "eikonal" and given:
            raise ValueError(f"{min(given)}: has no effect with reconstruction_engine = 'eikonal'; remove it")
        if self.imaging_engine == "eikonal" and "imaging_slices" in self.model_fields_set:
            raise ValueError("imaging_slices: has no effect with imaging_engine = 'eikonal'; remove it")
        if len(self.planes_mm) == 1 or list(self.planes_mm) != sorted(set(self.planes_mm)):
            raise ValueError(f"planes_mm = {list(self.planes_mm)}: must be two or more, increasing")
        return self

    @property
    def points(self) -> Points:
        """The object points."""
        return self.field_points_mm or (self.field_mm,)

    @property
    def evaluated_width_um(self) -> float:
        """Width of the lines whose contrast is evaluated."""
        return self.line_width_um or min(self.line_widths_um)

    @property
    def details(self) -> tuple[str, ...]:
        figure = {"correlation": "correlation", "lost_correlation": "lost correlation"}.get(
            self.figure, f"contrast of lines of {self.evaluated_width_um:g} µm"
        )
        engines: str = self.reconstruction_engine
        if engines == "slices":
            engines = f"{self.slices} {self.compensation} slices"
        light = "no noise"
        if self.electrons is not None:
            light = f"{self.electrons:g} electrons in the brightest pixel, {self.bits} bits"
        planes = ", ".join(f"{z:g}" for z in self.planes_mm)
        return (
            figure,
            f"object of {self.object}" if self.object == "lines" else f"{self.object} object with lines",
            f"a region of {self.region_mm:g} mm on a meridional line",
            *((f"planes at {planes} mm",) if planes else ()),
            light,
            f"frames by {self.imaging_engine}",
            f"reconstruction by {engines}",
            f"{self.model} model",
            refocus_text(self.refocus),
            self.location,
            *super().details,
        )

    @property
    def location(self) -> str:
        return points_text(self.points)

    @property
    def varies_slices(self) -> bool:
        return self.reconstruction_engine == "slices"

    def check(self, lens: Lens) -> None:
        for point in self.points:
            check_field_point(lens, point, "field_points_mm" if self.field_points_mm else "field_mm")
        if self.region_mm > lens.object.field_diameter_mm:
            raise ValueError(
                f"region_mm = {self.region_mm:g}: wider than the field; allowed: up to "
                f"{lens.object.field_diameter_mm:g} mm"
            )
        if len(self.planes_mm or lens.sensor.plane_distances_mm) < 2:
            raise ValueError("planes_mm: the design has one plane; give two or more")

    @property
    def pupil_points(self) -> Points:
        return self.points

    def check_perturbation(self, parameter: PerturbedParameter) -> None:
        validate_in_meridian(parameter)

    def is_compensated(self, compensators: bool) -> bool:
        return False

    def scores(self, context: Context, batch: PerturbationBatch) -> Array:
        results = [self._results(context, batch, point[1]) for point in self.points]
        scores = np.array([[self._score_of(one) for one in of_point] for of_point in results])
        return np.asarray(scores.min(axis=0) if self.at_least is not None else scores.max(axis=0))

    def _score_of(self, result: LineScores) -> float:
        if self.figure == "contrast":
            return result.contrasts[self.line_widths_um.index(self.evaluated_width_um)]
        return result.correlation if self.figure == "correlation" else 1.0 - result.correlation

    def _results(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[LineScores]:
        """Return the scores of all trials at one field height; the chain runs once for a batch."""
        key = ("line chain", self._imaging_settings(height_mm), self._reconstruction_settings)
        return context.cached_for(batch, key, lambda: self._run(context, batch, height_mm))

    def _imaging_settings(self, height_mm: float) -> tuple[Any, ...]:
        """Return the settings that frames depend on, except noise."""
        return (
            height_mm,
            self.region_mm,
            self.planes_mm,
            self.object,
            self.line_widths_um,
            self.wavelength_um,
            self.imaging_engine,
            self.imaging_slices,
            self.refocus,
        )

    @property
    def _reconstruction_settings(self) -> tuple[Any, ...]:
        """Settings that a reconstruction depends on, in addition to the imaging settings."""
        noise = (self.electrons, self.bits)
        engine = (self.reconstruction_engine, self.slices, self.compensation)
        return (*noise, *engine, self.model, self.iterations)

    def chain(self, context: Context, height_mm: float) -> LineImagingChain:
        """Return the imaging chain at one field height, after a check without perturbations.

        Raises
        ------
        InputError
            If the unperturbed chain does not reach `LEAST_CORRELATION`.
        """
        key = ("line chain", self._imaging_settings(height_mm), self.electrons, self.bits, self.iterations)
        return context.cached(key, lambda: self._checked_chain(context, height_mm))

    def _checked_chain(self, context: Context, height_mm: float) -> LineImagingChain:
        from tolerancing.merits.reconstruction.line_imaging_chain import (
            LineImagingChain,
            ReconstructionEngine,
        )

        def make() -> LineImagingChain:
            return LineImagingChain(
                context.lens,
                height_mm,
                self.region_mm,
                self.planes_mm or context.lens.sensor.plane_distances_mm,
                self.object,
                self.line_widths_um,
                context.wavelength_um(self.wavelength_um),
                self.imaging_engine,
                self.imaging_slices,
                **({} if self.refocus else {"margin_mm": 0.0}),
            )

        chain = context.cached(("line chain", self._imaging_settings(height_mm)), make)
        planes = chain.record(AS_DESIGNED, self.electrons, self.bits, self._noise(context, 0))
        result = chain.reconstruct(planes, ReconstructionEngine("eikonal"), iterations=self.iterations)
        if not result.correlation >= LEAST_CORRELATION:
            raise InputError(
                f"region_mm = {self.region_mm:g} at a field height of {height_mm:g} mm: the unperturbed "
                f"chain reaches a correlation of {result.correlation:.3f}, and must reach "
                f"{LEAST_CORRELATION:g} to show the effect of perturbations: use object = 'lines', a larger "
                "region_mm, more planes_mm or more electrons"
            )
        return chain

    def _noise(self, context: Context, number: int) -> np.random.SeedSequence | None:
        if self.electrons is None:
            return None
        # Spawn key of the noise of these frames, which differs from the keys of other merits.
        frames_key = 3
        return np.random.SeedSequence(context.noise_seed, spawn_key=(number, NOISE_STREAM, frames_key))

    def setups(self, context: Context, batch: PerturbationBatch) -> dict[Hashable, float]:
        if self.reconstruction_engine == "eikonal" or self.model != "nominal":
            return {}
        chains = [self.chain(context, height_mm) for _, height_mm in self.points]
        engines = {self.engine_of(slices) for slices in batch.reconstruction_slices()}
        return {
            key: seconds
            for chain in chains
            for engine in engines
            for key, seconds in chain.setup(engine).items()
        }

    def engine_of(self, slices: float) -> ReconstructionEngine:
        """Return the engine of a reconstruction with this number of slices; 0 means the merit's `slices`."""
        from tolerancing.merits.reconstruction.line_imaging_chain import ReconstructionEngine

        if self.reconstruction_engine == "eikonal":
            return ReconstructionEngine("eikonal")
        return ReconstructionEngine("slices", round(slices) or self.slices, self.compensation)

    def _run(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[LineScores]:
        chain = self.chain(context, height_mm)
        systems = context.states(batch, self.wavelength_um)
        frames_key = ("line frames", self._imaging_settings(height_mm), self.electrons, self.bits)
        numbers = batch.trial_numbers or (0,) * len(batch)
        recorded = context.cached_for(
            batch,
            frames_key,
            lambda: [
                chain.record(system, self.electrons, self.bits, self._noise(context, number))
                for system, number in zip(systems, numbers, strict=True)
            ],
        )
        models = self._models(context, batch, systems)
        refocus_um = self._refocus_um(context, batch, height_mm)
        return [
            chain.reconstruct(
                planes,
                self.engine_of(slices),
                model=model,
                refocus_um=shift_um,
                iterations=self.iterations,
            )
            for planes, slices, model, shift_um in zip(
                recorded, batch.reconstruction_slices(), models, refocus_um, strict=True
            )
        ]

    def _models(
        self, context: Context, batch: PerturbationBatch, systems: list[SystemState]
    ) -> list[SystemState]:
        """Return the system that the reconstruction assumes in each trial."""
        if self.model == "nominal":
            return [AS_DESIGNED] * len(batch)
        if self.model == "true":
            return systems
        if not context.compensators:
            raise InputError(f"{self.label}: model = 'calibrated' needs [[compensator]] tables in the study")
        values = context.compensator_values(batch)
        adapted = context.perturbed(context.compensators, values)
        return [replace(one, wavelength_um=None) for one in context.states(adapted, self.wavelength_um)]

    def _refocus_um(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[float]:
        """Return the shift of each trial's reconstructed object plane towards the lens."""
        if not self.refocus or self.model == "true":
            return [0.0] * len(batch)
        from wavesim import refocus

        calibrated = self.model == "calibrated"
        pupils = context.raw_pupils(batch, (0.0, height_mm), self.wavelength_um, calibrated)
        return [float(refocus(pupil).refocus_um) for pupil in pupils]
