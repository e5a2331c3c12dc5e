"""Deviations of a lens from its design: decenter, tilt, temperature and radii."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import batch_of
from tolerancing.perturbations.parameters import PerturbedParameter
from wavesim.scene.system_state import AS_DESIGNED, SystemState

MOVES = (
    ("decenter_x_mm", "decenter x", "mm", 0.1, 0.0005),
    ("decenter_y_mm", "decenter y", "mm", 0.1, 0.0005),
    ("tilt_x_deg", "tilt x", "deg", 0.5, 0.0025),
    ("tilt_y_deg", "tilt y", "deg", 0.5, 0.0025),
)
"""Parameter, label, unit, largest amount and step of deviations that a lens and an element share."""


@dataclass(frozen=True)
class DeviationRange:
    """A possible deviation and the range of its slider.

    Attributes
    ----------
    target, parameter
        Target and parameter of a perturbation, as in a tolerance study.
    label, unit
        Name and unit.
    largest, step
        Largest amount (±) and step of the slider.
    """

    target: str
    parameter: str
    label: str
    unit: str
    largest: float
    step: float

    @property
    def key(self) -> str:
        """Target and parameter as one word."""
        return f"{self.target}.{self.parameter}"


@dataclass(frozen=True)
class WhatIf:
    """Deviations from the design by keys of :class:`DeviationRange`; deviations of 0 are omitted."""

    values: Mapping[str, float] = field(default_factory=dict)

    def with_value(self, key: str, value: float) -> WhatIf:
        """Return the deviations with another amount of one of them."""
        kept = {k: v for k, v in self.values.items() if k != key}
        return WhatIf(kept | {key: value} if value else kept)

    def of(self, lens: Lens) -> WhatIf:
        """Return the deviations that apply to a lens."""
        return WhatIf({k: v for k, v in self.values.items() if _has(lens, k.rpartition(".")[0])})

    def state(self, lens: Lens, wavelength_um: float | None = None) -> SystemState:
        """Return the state of lens and bench with these deviations.

        Raises
        ------
        InputError
            If a value is not allowed, or the thermal data of a glass are not known.
        """
        if not self.values:
            return AS_DESIGNED
        perturbed = []
        for key in self.values:
            target, _, parameter = key.rpartition(".")
            try:
                perturbed.append(PerturbedParameter(target=target, parameter=parameter))
            except ValueError as error:
                raise InputError(f"{key}: {error}") from error
        batch = batch_of(perturbed, np.array([list(self.values.values())]), 0.0, 0)
        return batch.states(lens, wavelength_um or lens.wavelengths_um[0])[0]


def _has(lens: Lens, target: str) -> bool:
    """Return whether a lens has the surface or element of a target; other targets always exist."""
    kind, _, number = target.partition(" ")
    return not number or int(number) <= len(lens.glass_fronts if kind == "element" else lens.surfaces)


def deviations_of(lens: Lens, what_if: WhatIf = WhatIf()) -> tuple[DeviationRange, ...]:
    """Return the possible deviations: of the lens, its elements (if several), radii, and temperature.

    Other deviations of `what_if`, such as those of a study's trial, are appended.
    """
    found = [DeviationRange("lens", *move) for move in MOVES]
    if len(lens.glass_fronts) > 1:
        found += [
            DeviationRange(f"element {k + 1}", *move) for k in range(len(lens.glass_fronts)) for move in MOVES
        ]
    found += [
        DeviationRange(f"surface {i + 1}", "radius_percent", f"radius {i + 1}", "%", 0.5, 0.0025)
        for i, surface in enumerate(lens.surfaces)
        if surface.radius_mm is not None
    ]
    found.append(DeviationRange("environment", "temperature_c", "temperature", "K", 40.0, 0.2))
    known = {one.key for one in found}
    for key, value in what_if.of(lens).values.items():
        if key not in known:
            target, _, parameter = key.rpartition(".")
            label, _, unit = parameter.rpartition("_")
            found.append(
                DeviationRange(target, parameter, label or unit, unit, 3.0 * abs(value), 0.01 * abs(value))
            )
    return tuple(found)
