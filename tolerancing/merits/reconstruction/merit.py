"""The merit `reconstruction`: what the whole chain leaves of an object, for a lens at its own size.

An object on a meridional line sends its light through the perturbed lens to the planes where the sensor
stands. Its pixels record amplitudes. From them the reconstruction finds the object through its own model of
the lens, which may be of another engine, and nominal, calibrated or true.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from lensdesign.common.arrays import Array
from lensdesign.common.section import Bounded, Positive, rows, tuples
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit, check_field_point, points_text, refocus_text
from tolerancing.merits.context import Context, Points
from tolerancing.merits.line_pairs import NOISE_STREAM
from tolerancing.merits.reconstruction.objects import ObjectKind, needed_mm
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter, validate_in_meridian
from wavesim.scene.placement import NOMINAL, Placement

if TYPE_CHECKING:
    from tolerancing.merits.reconstruction.line_chain import LineChain, ReconstructionEngine
    from tolerancing.merits.reconstruction.objects import LineScores

Figure = Literal["correlation", "contrast", "lost_correlation"]
Model = Literal["nominal", "calibrated", "true"]

FRAMES = 3
"""Keeps the noise of these frames apart from that of other merits."""

LEAST_CORRELATION = 0.97
"""Correlation that the unperturbed chain must reach; with less the planes or the region tell too little."""


class Reconstruction(Merit):
    """Correlation of the reconstructed object, or contrast of its lines, after the whole chain.

    Merits that differ in figure, line width, limit and name alone share one run of the chain in each trial.

    Attributes
    ----------
    figure
        ``correlation`` of found and true object about their means, ``contrast`` of its lines, or
        ``lost_correlation``, 1 less the correlation.
    object
        ``lines`` on an even bright ground, or on a ground of random transmission: ``amplitude`` or
        ``complex``.
    line_widths_um
        Widths of the object's sets of five bars, which lie side by side.
    line_width_um
        Whose contrast is meant; the finest lines where left out.
    region_mm
        Length of the region about each field point, which a field stop bounds.
    field_mm
        Object point (0, y).
    field_points_mm
        Several object points in its place; the worst of their scores counts.
    planes_mm
        Where the sensor records, from the exit vertex; the design's planes where left out.
    electrons, bits
        In the brightest pixel of each plane, with shot noise, 2 electrons of read noise and rounding to
        counts of so many bits; without electrons pixels tell the mean intensity on them exactly.
    imaging_engine, imaging_slices
        What carries the light to the sensor: ``eikonal``, or oblique ``slices``, so many of each surface.
    reconstruction_engine, slices, compensation
        What the reconstruction's model is made of: ``eikonal``, or ``slices``, how many of each surface, and
        whether their compensation is ``vertical`` (the paper's) or ``oblique``.
    model
        What the reconstruction knows of the lens: ``nominal``; ``calibrated``, the study's compensators at
        the values that they take in each trial; or ``true``, all as it is.
    iterations
        Largest number.
    refocus
        Whether the object is sought in the plane in which rays through the lens, less the model, show it
        sharp.
    line
        The chain runs on a meridional line along y; the plane is not supported.
    """

    figure: Figure = "correlation"
    object: ObjectKind = "lines"
    line_widths_um: Annotated[tuple[Positive, ...], Field(min_length=1)]
    line_width_um: Positive | None = None
    region_mm: Positive
    field_mm: tuple[Bounded, Bounded] = (0.0, 0.0)
    field_points_mm: tuple[tuple[Bounded, Bounded], ...] = ()
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

    _lists = field_validator("line_widths_um", "field_mm", "planes_mm", mode="before")(tuples)
    _points = field_validator("field_points_mm", mode="before")(rows)

    @model_validator(mode="after")
    def _consistent(self) -> Reconstruction:
        if self.field_points_mm and "field_mm" in self.model_fields_set:
            raise ValueError("give field_mm or field_points_mm, not both")
        if len(set(self.line_widths_um)) < len(self.line_widths_um):
            raise ValueError(f"line_widths_um = {list(self.line_widths_um)}: one stands there twice")
        if self.line_width_um is not None and self.line_width_um not in self.line_widths_um:
            listed = ", ".join(f"{width:g}" for width in self.line_widths_um)
            raise ValueError(
                f"line_width_um = {self.line_width_um:g}: allowed: those of line_widths_um, {listed}"
            )
        if self.line_width_um is not None and self.figure != "contrast":
            raise ValueError(
                f"line_width_um: figure = {self.figure!r} is that of the whole object; leave it out"
            )
        if needed_mm(self.line_widths_um) > self.region_mm:
            raise ValueError(
                f"region_mm = {self.region_mm:g}: the lines of line_widths_um need "
                f"{needed_mm(self.line_widths_um):.3g} mm or more"
            )
        for x, y in self.points:
            if x:
                raise ValueError(f"field point ({x:g}, {y:g}): the chain runs on a line along y; give x = 0")
        given = {"slices", "compensation"} & self.model_fields_set
        if self.reconstruction_engine == "eikonal" and given:
            raise ValueError(f"{min(given)}: means nothing with reconstruction_engine = 'eikonal'")
        if self.imaging_engine == "eikonal" and "imaging_slices" in self.model_fields_set:
            raise ValueError("imaging_slices: means nothing with imaging_engine = 'eikonal'")
        if len(self.planes_mm) == 1 or list(self.planes_mm) != sorted(set(self.planes_mm)):
            raise ValueError(f"planes_mm = {list(self.planes_mm)}: must be two or more, increasing")
        return self

    @property
    def points(self) -> Points:
        """The object points."""
        return self.field_points_mm or (self.field_mm,)

    @property
    def judged_width_um(self) -> float:
        """Width of the lines whose contrast is meant."""
        return self.line_width_um or min(self.line_widths_um)

    @property
    def details(self) -> tuple[str, ...]:
        what = {"correlation": "correlation", "lost_correlation": "lost correlation"}.get(
            self.figure, f"contrast of lines of {self.judged_width_um:g} um"
        )
        engines: str = self.reconstruction_engine
        if engines == "slices":
            engines = f"{self.slices} {self.compensation} slices"
        light = "no noise"
        if self.electrons is not None:
            light = f"{self.electrons:g} electrons in the brightest pixel, {self.bits} bits"
        planes = ", ".join(f"{z:g}" for z in self.planes_mm)
        return (
            what,
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
        found = [self._found(context, batch, point[1]) for point in self.points]
        scores = np.array([[self._figure(one) for one in own] for own in found])
        return np.asarray(scores.min(axis=0) if self.at_least is not None else scores.max(axis=0))

    def _figure(self, found: LineScores) -> float:
        if self.figure == "contrast":
            return found.contrasts[self.line_widths_um.index(self.judged_width_um)]
        return found.correlation if self.figure == "correlation" else 1.0 - found.correlation

    def _found(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[LineScores]:
        """What the chain leaves of the object at one field height, in each trial; run once for a batch."""
        key = ("line chain", self._spec(height_mm), self._recovery)
        return context.once(batch, key, lambda: self._run(context, batch, height_mm))

    def _spec(self, height_mm: float) -> tuple[Any, ...]:
        """What frames depend on."""
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
    def _recovery(self) -> tuple[Any, ...]:
        """What the reconstruction depends on, beside the frames' own settings."""
        noise = (self.electrons, self.bits)
        engine = (self.reconstruction_engine, self.slices, self.compensation)
        return (*noise, *engine, self.model, self.iterations)

    def chain(self, context: Context, height_mm: float) -> LineChain:
        """The chain at one field height, checked to reconstruct the object with the unperturbed lens.

        Raises
        ------
        InputError
            If it does not.
        """
        key = ("line chain", self._spec(height_mm), self.electrons, self.bits, self.iterations)
        return context.kept(key, lambda: self._checked_chain(context, height_mm))

    def _checked_chain(self, context: Context, height_mm: float) -> LineChain:
        from tolerancing.merits.reconstruction.line_chain import LineChain, ReconstructionEngine

        def make() -> LineChain:
            return LineChain(
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

        chain = context.kept(("line chain", self._spec(height_mm)), make)
        planes = chain.recorded(NOMINAL, self.electrons, self.bits, self._noise(context, 0))
        found = chain.reconstructed(planes, ReconstructionEngine("eikonal"), iterations=self.iterations)
        if not found.correlation >= LEAST_CORRELATION:
            raise InputError(
                f"region_mm = {self.region_mm:g} at a field height of {height_mm:g} mm: the unperturbed "
                f"chain finds the object with a correlation of {found.correlation:.3f}, and must reach "
                f"{LEAST_CORRELATION:g} for a study to tell what perturbations cost: take object = 'lines', "
                "a larger region, more planes_mm or electrons"
            )
        return chain

    def _noise(self, context: Context, number: int) -> np.random.SeedSequence | None:
        if self.electrons is None:
            return None
        return np.random.SeedSequence(context.noise_seed, spawn_key=(number, NOISE_STREAM, FRAMES))

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
        """The engine of a reconstruction by so many slices; 0 stands for the merit's own number."""
        from tolerancing.merits.reconstruction.line_chain import ReconstructionEngine

        if self.reconstruction_engine == "eikonal":
            return ReconstructionEngine("eikonal")
        return ReconstructionEngine("slices", round(slices) or self.slices, self.compensation)

    def _run(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[LineScores]:
        chain = self.chain(context, height_mm)
        systems = context.placements(batch, self.wavelength_um)
        frames_key = ("line frames", self._spec(height_mm), self.electrons, self.bits)
        numbers = batch.numbers or (0,) * len(batch)
        recorded = context.once(
            batch,
            frames_key,
            lambda: [
                chain.recorded(system, self.electrons, self.bits, self._noise(context, number))
                for system, number in zip(systems, numbers, strict=True)
            ],
        )
        models, refocus_um = (
            self._models(context, batch, systems),
            self._refocus_um(context, batch, height_mm),
        )
        return [
            chain.reconstructed(
                planes,
                self.engine_of(slices),
                model=model,
                refocus_um=sharp,
                iterations=self.iterations,
            )
            for planes, slices, model, sharp in zip(
                recorded, batch.reconstruction_slices(), models, refocus_um, strict=True
            )
        ]

    def _models(
        self, context: Context, batch: PerturbationBatch, systems: list[Placement]
    ) -> list[Placement]:
        """What the reconstruction knows of lens and bench in each trial."""
        if self.model == "nominal":
            return [NOMINAL] * len(batch)
        if self.model == "true":
            return systems
        if not context.compensators:
            raise InputError(f"{self.label}: model = 'calibrated' needs [[compensator]] tables in the study")
        values = context.compensator_values(batch)
        adapted = context.perturbed(context.compensators, values)
        return [replace(one, wavelength_um=None) for one in context.placements(adapted, self.wavelength_um)]

    def _refocus_um(self, context: Context, batch: PerturbationBatch, height_mm: float) -> list[float]:
        """How much nearer to the lens each trial's object is sought."""
        if not self.refocus or self.model == "true":
            return [0.0] * len(batch)
        from wavesim import refocus

        calibrated = self.model == "calibrated"
        pupils = context.raw_pupils(batch, (0.0, height_mm), self.wavelength_um, calibrated)
        return [float(refocus(pupil).refocus_um) for pupil in pupils]
