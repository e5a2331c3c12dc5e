"""Deviations of a lens from its design: decenter, tilt, temperature and radii."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np

from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SURFACE_DELTAS, Pose, SurfacePerturbation
from tolerancing.perturbations.batch import batch_of
from tolerancing.perturbations.parameters import LENS_PARAMETERS, PerturbedParameter
from wavesim.scene.state_files import read_state, state_table, write_state
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
    """Deviations of the mounted lens from the design.

    Attributes
    ----------
    values
        Deviations by keys of :class:`DeviationRange`; deviations of 0 are omitted.
    mounted
        Further deviations, such as those of a calibration, that have no slider.
    file
        Name of the file from which `mounted` was read; empty without one.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    mounted: SystemState = AS_DESIGNED
    file: str = ""

    @property
    def is_active(self) -> bool:
        """True if the lens deviates from the design."""
        return bool(self.values) or self.mounted != AS_DESIGNED

    def with_value(self, key: str, value: float) -> WhatIf:
        """Return the deviations with another amount of one of them."""
        kept = {k: v for k, v in self.values.items() if k != key}
        return replace(self, values=kept | {key: value} if value else kept)

    def of(self, lens: Lens) -> WhatIf:
        """Return the deviations that apply to a lens."""
        known = {i: own for i, own in self.mounted.surface_perturbations.items() if i < len(lens.surfaces)}
        return WhatIf(
            {k: v for k, v in self.values.items() if _has(lens, k.rpartition(".")[0])},
            self.mounted
            if len(known) == len(self.mounted.surface_perturbations)
            else replace(self.mounted, surface_perturbations=known),
            self.file,
        )

    def described(self, lens: Lens) -> tuple[str, ...]:
        """Return the active deviations of a lens in words, such as "decenter y 0.03 mm"."""
        own = self.of(lens)
        words = []
        for deviation in deviations_of(lens, own):
            if value := own.values.get(deviation.key, 0.0):
                owner = deviation.target if deviation.target.startswith("element") else ""
                words.append(
                    number_with_unit(f"{owner} {deviation.label} {value:.6g}".strip(), deviation.unit)
                )
        if own.mounted != AS_DESIGNED:
            names = ", ".join(name.replace("_", " ") for name in state_table(own.mounted))
            words.append(f"{own.file or 'mounted lens'} ({names})")
        return tuple(words)

    def state(self, lens: Lens, wavelength_um: float | None = None) -> SystemState:
        """Return the state of lens and bench with these deviations.

        Raises
        ------
        InputError
            If a value is not allowed, or the thermal data of a glass are not known.
        """
        if not self.values:
            return self.mounted
        perturbed = []
        for key in self.values:
            target, _, parameter = key.rpartition(".")
            try:
                perturbed.append(PerturbedParameter(target=target, parameter=parameter))
            except ValueError as error:
                raise InputError(f"{key}: {error}") from error
        batch = batch_of(perturbed, np.array([list(self.values.values())]), 0.0, 0)
        nominal_um = wavelength_um or lens.wavelengths_um[0]
        own = batch.states(lens, nominal_um)[0]
        return own if self.mounted == AS_DESIGNED else _combined(self.mounted, own, nominal_um)

    def write(self, lens: Lens, path: Path) -> None:
        """Write the deviations as a file for `wavesim image --state`.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        write_state(_deviations_only(self.of(lens).state(lens), lens), path)


def read_what_if(path: Path, lens: Lens) -> WhatIf:
    """Return the deviations in a file of :meth:`WhatIf.write`, of `wavesim calibrate`, or of a trial.

    Decenters, tilts and errors of radii become values of sliders.

    Raises
    ------
    InputError
        If the file cannot be read, contains no state, or belongs to another lens.
    """
    state = _deviations_only(read_state(path, lens), lens)
    values: dict[str, float] = {}
    pose = state.pose
    if not pose.pivot_z_mm:
        values = {f"lens.{name}": value for name in LENS_PARAMETERS if (value := getattr(pose, name))}
        pose = Pose()
    surfaces = {}
    for index, own in state.surface_perturbations.items():
        radius_mm = lens.surfaces[index].radius_mm
        if radius_mm is not None and own.radius_mm:
            values[f"surface {index + 1}.radius_percent"] = float(100.0 * own.radius_mm / radius_mm)
            own = replace(own, radius_mm=0.0)
        surfaces[index] = own
    state = _deviations_only(replace(state, pose=pose, surface_perturbations=surfaces), lens)
    return WhatIf(values, state, path.name)


def _deviations_only(state: SystemState, lens: Lens) -> SystemState:
    """Return a state without values that are those of the design."""
    surfaces = {i: own for i, own in state.surface_perturbations.items() if own != SurfacePerturbation()}
    errors_mm = state.plane_distance_errors_mm
    return replace(
        state,
        surface_perturbations=surfaces,
        plane_distance_errors_mm=errors_mm if any(errors_mm) else (),
        wavelength_um=None if state.wavelength_um == lens.wavelengths_um[0] else state.wavelength_um,
    )


def _combined(mounted: SystemState, own: SystemState, nominal_um: float) -> SystemState:
    """Return the sum of the deviations of a mounted lens and of further ones, which have no figures."""
    pose = {name: getattr(mounted.pose, name) + getattr(own.pose, name) for name in LENS_PARAMETERS}
    surfaces = dict(mounted.surface_perturbations)
    for index, further in own.surface_perturbations.items():
        surfaces[index] = _summed(surfaces.get(index, SurfacePerturbation()), further)
    x, y, z = np.add(mounted.object_shift_mm, own.object_shift_mm).tolist()
    sensor_x, sensor_y, sensor_z = np.add(mounted.sensor_shift_mm, own.sensor_shift_mm).tolist()
    tilt_x, tilt_y = np.add(mounted.sensor_tilt_deg, own.sensor_tilt_deg).tolist()
    shift_um = (own.wavelength_um or nominal_um) - nominal_um
    return replace(
        mounted,
        pose=Pose(**pose, pivot_z_mm=mounted.pose.pivot_z_mm),
        surface_perturbations=surfaces,
        object_shift_mm=(x, y, z),
        sensor_shift_mm=(sensor_x, sensor_y, sensor_z),
        plane_distance_errors_mm=tuple(
            map(
                sum,
                zip_longest(mounted.plane_distance_errors_mm, own.plane_distance_errors_mm, fillvalue=0.0),
            )
        ),
        sensor_tilt_deg=(tilt_x, tilt_y),
        wavelength_um=(mounted.wavelength_um or nominal_um) + shift_um,
    )


def _summed(one: SurfacePerturbation, other: SurfacePerturbation) -> SurfacePerturbation:
    shape = {
        name: one.shape.get(name, 0.0) + other.shape.get(name, 0.0) for name in {*one.shape, *other.shape}
    }
    numbers = {name: getattr(one, name) + getattr(other, name) for name in SURFACE_DELTAS}
    return SurfacePerturbation(**numbers, shape=shape, figure=one.figure)


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
