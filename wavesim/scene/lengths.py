"""Check lengths among settings that seem to be in another unit, by the size of the lens."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.lengths import (
    PIXEL_PITCH_UM,
    UNITS,
    WAVELENGTH_UM,
    PlausibleLength,
    implausible_values,
    in_unit,
)
from lensdesign.lens.lengths import LensLengths
from lensdesign.lens.lens import Lens
from wavesim.scene.bench_settings import perturbed_surfaces
from wavesim.scene.settings import SettingError

ABSOLUTE_UM = {"wavelength_um": WAVELENGTH_UM, "pixel_pitch_um": PIXEL_PITCH_UM}
"""Lengths whose plausible range does not depend on the lens."""


def validate_lengths(
    lens: Lens, settings: FrozenModel | Mapping[str, Any], wavelength_um: float | None = None
) -> None:
    """Reject implausible lengths that a change of unit would explain.

    Parameters
    ----------
    lens
        The nominal lens, whose size determines the plausible ranges.
    settings
        Settings, or lengths by the names of settings. Values at their default or None are not checked.
    wavelength_um
        Wavelength of the light where the settings state none. Default: the lens's first one.

    Raises
    ------
    SettingError
        If a length is implausible. The message contains the setting, its value, the plausible range, and the
        value in the unit that may be meant.
    """
    given = dict(_given(settings))
    for name in ABSOLUTE_UM.keys() & given.keys():
        _validate(name, given[name], ABSOLUTE_UM[name])
    light = given.get("wavelength_um", wavelength_um)
    if light is not None and not (math.isfinite(light) and light > 0.0):
        return  # an unusable wavelength is rejected where the light is made
    size = LensLengths.of(lens, light)
    for name, value in given.items():
        quantity, _, unit = name.rpartition("_")
        if name == "region_mm":
            _validate(name, value[:2], size.plausible_mm("region_at"))
            _validate(name, value[2:], size.plausible_mm("region_size"))
        elif name == "refocus_mm":
            _validate(name, max(value, key=abs), size.plausible_mm("refocus"))
        elif (
            name == "patch_mm"
        ):  # a patch wider than the field is rejected in validate_within_field, with a hint
            plausible = size.plausible_mm("patch")
            _validate(name, value, None if plausible is None else replace(plausible, highest=math.inf))
        elif name == "source_distance_mm":  # its angle depends on the width of the light
            lit_mm = min([size.field_mm, *_widths_mm(given)])
            _validate(name, value, replace(size, field_mm=lit_mm).plausible_mm(quantity))
        elif unit in UNITS and name not in ABSOLUTE_UM:
            _validate(name, value, size.plausible_mm(quantity))
    _validate_perturbations(lens, size, given.get("perturb"))


def _given(settings: FrozenModel | Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the settings that are given."""
    if isinstance(settings, FrozenModel):
        fields = type(settings).model_fields
        settings = {name: getattr(settings, name) for name in fields if name in settings.model_fields_set}
    yield from ((name, value) for name, value in settings.items() if value is not None)


def _widths_mm(given: Mapping[str, Any]) -> Iterator[float]:
    """Yield the stated widths of the light: those of patch and field stop."""
    yield from (given[name] for name in ("patch_mm", "field_stop_mm") if given.get(name, 0.0) > 0.0)


def _validate(name: str, value: Any, plausible_mm: PlausibleLength | None, label: str = "") -> None:
    if plausible_mm is None:
        return
    unit = name.rpartition("_")[2]
    if unit not in UNITS:
        unit = "mm"
    plausible = plausible_mm if name in ABSOLUTE_UM else in_unit(plausible_mm, unit)
    for sentence in implausible_values(label or f"{{{name}}}", value, plausible, unit):
        raise SettingError(sentence)


def _validate_perturbations(lens: Lens, size: LensLengths, text: str | None) -> None:
    for index, deltas in perturbed_surfaces(text).items():
        if index > len(lens.surfaces):
            return  # surface_perturbations rejects this with its own message
        for name, delta in deltas.items():
            plausible = size.of_parameter_mm(lens, "surface", name, index - 1)
            if plausible is not None:
                _validate("perturb", delta, plausible, f"{{perturb}}: surface {index}: {name}")
