"""Lengths among settings that seem to be given in another unit, judged by the lens that is used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from lensdesign.common.lengths import (
    PIXEL_PITCH_UM,
    UNITS,
    WAVELENGTH_UM,
    PlausibleLength,
    doubted_length,
    in_unit,
    numbers_of,
)
from lensdesign.common.section import Section
from lensdesign.lens.lengths import LensLengths
from lensdesign.lens.lens import Lens
from wavesim.scene.bench_settings import perturbed_surfaces
from wavesim.scene.settings import SettingError

ABSOLUTE_UM = {"wavelength_um": WAVELENGTH_UM, "pixel_pitch_um": PIXEL_PITCH_UM}
"""Lengths that are plausible or not whatever the lens."""


def validate_lengths(
    lens: Lens, settings: Section | Mapping[str, Any], wavelength_um: float | None = None
) -> None:
    """Refuse lengths that no setting has and that another unit would explain.

    Parameters
    ----------
    lens
        The nominal lens, by whose size lengths are judged.
    settings
        Settings, or lengths by the names of settings; what is at its default or None is passed over.
    wavelength_um
        Of the light, where the settings do not give one; the lens's first one if left out.

    Raises
    ------
    SettingError
        Naming the setting, its value, what is plausible, and the value that may be meant.
    """
    given = dict(_given(settings))
    for name in ABSOLUTE_UM.keys() & given.keys():
        _refuse(name, given[name], ABSOLUTE_UM[name])
    light = given.get("wavelength_um", wavelength_um)
    if light is not None and not (math.isfinite(light) and light > 0.0):
        return  # that is refused where the light is made
    size = LensLengths.of(lens, light)
    for name, value in given.items():
        quantity, _, unit = name.rpartition("_")
        if name == "region_mm":
            _refuse(name, value[:2], size.plausible_mm("region_at"))
            _refuse(name, value[2:], size.plausible_mm("region_size"))
        elif name == "refocus_mm":
            _refuse(name, max(value, key=abs), size.plausible_mm("refocus"))
        elif name == "patch_mm":  # one wider than the field is refused where it is made, with a hint
            plausible = size.plausible_mm("patch")
            _refuse(name, value, None if plausible is None else replace(plausible, highest=math.inf))
        elif unit in UNITS and name not in ABSOLUTE_UM:
            _refuse(name, value, size.plausible_mm(quantity))
    _refuse_perturbations(lens, size, given.get("perturb"))


def _given(settings: Section | Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Names and values of what is set."""
    if isinstance(settings, Section):
        fields = type(settings).model_fields
        settings = {name: getattr(settings, name) for name in fields if name in settings.model_fields_set}
    yield from ((name, value) for name, value in settings.items() if value is not None)


def _refuse(name: str, value: Any, plausible_mm: PlausibleLength | None, what: str = "") -> None:
    if plausible_mm is None:
        return
    unit = name.rpartition("_")[2]
    if unit not in UNITS:
        unit = "mm"
    plausible = plausible_mm if name in ABSOLUTE_UM else in_unit(plausible_mm, unit)
    for number in numbers_of(value):
        sentence = doubted_length(what or f"{{{name}}}", number, unit, plausible)
        if sentence is not None:
            raise SettingError(sentence)


def _refuse_perturbations(lens: Lens, size: LensLengths, text: str | None) -> None:
    for number, deltas in perturbed_surfaces(text).items():
        if number > len(lens.surfaces):
            return  # that is refused where the perturbations are made
        for name, delta in deltas.items():
            plausible = size.of_parameter_mm(lens, "surface", name, number - 1)
            if plausible is not None:
                _refuse("perturb", delta, plausible, f"{{perturb}}: surface {number}: {name}")
