"""What is perturbed, and by how much: from a study's tables to poses and surface perturbations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, SerializeAsAny, field_validator, model_validator

from lensdesign.errors import DesignError
from lensdesign.files import unknown_key, validate
from lensdesign.poses import SURFACE_DELTAS, Pose, SurfacePerturbation
from lensdesign.system import Lens, Section
from tolerancing.distributions import DISTRIBUTIONS, Distribution
from tolerancing.registry import pick

Array = NDArray[np.float64]

LENS_PARAMETERS = tuple(f.name for f in fields(Pose) if f.name != "pivot_z_mm")
"""What can be perturbed of the whole lens: the values of a pose."""

SURFACE_PARAMETERS = SURFACE_DELTAS
"""What can be perturbed of one surface."""

UNITS = ("mm", "um", "deg")

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]


class PerturbedParameter(Section):
    """One parameter of the lens, or of one of its surfaces, that departs from nominal.

    Attributes
    ----------
    name
        Lower-case letters, digits and underscores; made of target and parameter where left out.
    target
        ``lens``, or ``surface N`` with N counted from 1.
    parameter
        One of `LENS_PARAMETERS` or `SURFACE_PARAMETERS`; values are deltas in the unit of its suffix.
    """

    name: Name = ""
    target: str
    parameter: str

    @field_validator("target")
    @classmethod
    def _target(cls, value: str) -> str:
        if value != "lens" and not re.fullmatch(r"surface [1-9]\d*", value):
            raise ValueError(f"{value!r} is no target; allowed: lens, surface N (N from 1)")
        return value

    @model_validator(mode="after")
    def _known(self) -> PerturbedParameter:
        allowed = LENS_PARAMETERS if self.surface is None else SURFACE_PARAMETERS
        if self.parameter not in allowed:
            raise ValueError(
                f"parameter = {self.parameter!r}: {self.target} has no such parameter; "
                f"allowed: {', '.join(allowed)}"
            )
        return self

    @property
    def surface(self) -> int | None:
        """Index of the surface, from 0; None for the lens."""
        return None if self.target == "lens" else int(self.target.split()[1]) - 1

    @property
    def unit(self) -> str:
        """Unit of the deltas; empty for a conic constant or an index."""
        suffix = self.parameter.rpartition("_")[2]
        return suffix if suffix in UNITS else ""

    @property
    def column(self) -> str:
        """Name of the values in tables, with the unit."""
        return with_unit(self.name or f"{self.target} {self.parameter}".replace(" ", "_"), self.unit)

    def check(self, lens: Lens) -> None:
        """Refuse a parameter that this lens does not have.

        Raises
        ------
        ValueError
            If there is no such surface, its radius is that of a plane, or its thickness is none.
        """
        if self.surface is None:
            return
        count = len(lens.surfaces)
        if self.surface >= count:
            allowed = ", ".join(["lens", *(f"surface {i + 1}" for i in range(count))])
            raise ValueError(f"target = {self.target!r}: the design has no such surface; allowed: {allowed}")
        if self.parameter == "radius_mm" and lens.surfaces[self.surface].radius_mm is None:
            raise ValueError(f"parameter = 'radius_mm': {self.target} is a plane and has no radius")
        if self.parameter in ("thickness_mm", "index") and self.surface == count - 1:
            raise ValueError(
                f"parameter = {self.parameter!r}: {self.target} is the last surface; "
                "what stands behind it is the sensor's space"
            )


class Perturbation(PerturbedParameter):
    """A parameter that scatters from part to part."""

    distribution: SerializeAsAny[Distribution]


def with_unit(name: str, unit: str) -> str:
    """A name that ends with its unit."""
    return name if not unit or name.endswith(f"_{unit}") else f"{name}_{unit}"


def perturbation_from_table(table: dict[str, Any], source: str) -> Perturbation:
    """Read one ``[[perturbation]]`` table; the keys of its distribution stand beside its own.

    Raises
    ------
    DesignError
        For each fault: which key and value, and what is allowed.
    """
    shape = pick(DISTRIBUTIONS, table, "distribution", source)
    own = [name for name in Perturbation.model_fields if name != "distribution"]
    allowed = [*own, "distribution", *shape.model_fields]
    unknown = [key for key in table if key not in allowed]
    if unknown:
        lines = [f"{source}: {key}: {unknown_key(key, allowed)}" for key in unknown]
        raise DesignError("\n".join(lines))
    distribution = validate(shape, {k: v for k, v in table.items() if k in shape.model_fields}, source)
    return validate(
        Perturbation, {k: v for k, v in table.items() if k in own} | {"distribution": distribution}, source
    )


@dataclass(frozen=True, eq=False)
class PerturbationBatch:
    """Realised deltas of several trials.

    Attributes
    ----------
    parameters : tuple of PerturbedParameter
        What the columns of `values` perturb; columns of one and the same parameter add up.
    values : ndarray, shape (trials, parameters)
        Deltas from nominal, in the units of the parameters.
    pivot_z_mm
        Where on the axis the whole lens turns, from its front vertex.
    """

    parameters: tuple[PerturbedParameter, ...]
    values: Array
    pivot_z_mm: float = 0.0

    def __len__(self) -> int:
        return len(self.values)

    def poses(self) -> Pose:
        """Poses of the lens, each perturbed value of shape (trials,)."""
        return Pose(**self._deltas(None, slice(None)), pivot_z_mm=self.pivot_z_mm)

    def surface_perturbations(self) -> dict[int, SurfacePerturbation]:
        """Perturbations by surface index, each perturbed value of shape (trials,)."""
        return {s: SurfacePerturbation(**self._deltas(s, slice(None))) for s in self._surfaces()}

    def pose(self, trial: int) -> Pose:
        """Pose of one trial, counted from 0 within the batch."""
        return Pose(**self._deltas(None, trial), pivot_z_mm=self.pivot_z_mm)

    def surface_perturbations_of(self, trial: int) -> dict[int, SurfacePerturbation]:
        """Surface perturbations of one trial, by surface index."""
        return {s: SurfacePerturbation(**self._deltas(s, trial)) for s in self._surfaces()}

    def single_trials(self) -> list[PerturbationBatch]:
        """A batch of its own for each of these trials."""
        return [
            PerturbationBatch(self.parameters, self.values[i : i + 1], self.pivot_z_mm)
            for i in range(len(self))
        ]

    def _surfaces(self) -> list[int]:
        return sorted({p.surface for p in self.parameters if p.surface is not None})

    def _deltas(self, surface: int | None, trials: slice | int) -> dict[str, Any]:
        deltas: dict[str, Any] = {}
        for column, parameter in enumerate(self.parameters):
            if parameter.surface == surface:
                chosen = self.values[trials, column]
                value = np.ascontiguousarray(chosen) if isinstance(trials, slice) else float(chosen)
                deltas[parameter.parameter] = deltas.get(parameter.parameter, 0.0) + value
        return deltas


def realise(
    perturbations: Sequence[Perturbation], seed: int, trials: Sequence[int], pivot_z_mm: float = 0.0
) -> PerturbationBatch:
    """Draw the deltas of given trials.

    Each trial has its own stream, ``SeedSequence(seed, spawn_key=(trial,))``, so its values depend on
    nothing but the perturbations, the seed and its number.

    Parameters
    ----------
    perturbations
        What scatters, and how; the k-th takes the k-th draw of a trial's stream.
    seed
        The study's seed.
    trials
        Numbers of the trials, from 0.
    pivot_z_mm
        Where on the axis the whole lens turns.
    """
    draws = [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial,))).random(len(perturbations))
        for trial in trials
    ]
    # random() may return 0, of which a normal distribution has no quantile.
    probability = np.maximum(np.reshape(draws, (len(trials), len(perturbations))), 2.0**-54)
    values = np.column_stack(
        [p.distribution.quantile(probability[:, k]) for k, p in enumerate(perturbations)]
    )
    return PerturbationBatch(tuple(perturbations), values, pivot_z_mm)
