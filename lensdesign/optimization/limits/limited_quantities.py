"""Values of a specification that have a feasibility limit: field, aperture, pixel pitch and tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from lensdesign.optimization.specification.specification import Specification


@dataclass(frozen=True)
class LimitedQuantity:
    """A value that has a feasibility limit.

    Attributes
    ----------
    name, unit
        Name of the value and its unit.
    value_in
        Function that returns the value in a specification.
    changed
        Function that returns the specification with another value.
    """

    name: str
    unit: str
    value_in: Callable[[Specification], float]
    changed: Callable[[Specification, float], Specification]


def _with_field(specification: Specification, value: float) -> Specification:
    return _with_object(specification, field_diameter_mm=value)


def _with_aperture(specification: Specification, value: float) -> Specification:
    """Return the specification with another numerical aperture, and a fixed stop scaled accordingly."""
    changed = _with_object(specification, numerical_aperture=value)
    if specification.optimize.stop != "fixed":
        return changed
    old, new = (math.tan(math.asin(s.object.numerical_aperture)) for s in (specification, changed))
    semi = new / old * specification.stop_semi_diameter_mm
    return changed.with_surface(specification.stop_index, semi_diameter_mm=semi)


def _with_object(specification: Specification, **changes: float) -> Specification:
    scene = specification.object.replaced(**changes)
    limits, half = specification.constraints, 0.5 * scene.field_diameter_mm
    kept = tuple(limit for limit in limits.field_spread if limit.field_mm <= half)
    recording = specification.recording
    if recording is not None and recording.support_mm is not None:
        within = min(recording.support_mm, scene.field_diameter_mm)
        recording = recording.replaced(support_mm=within)
    return specification.replaced(
        object=scene, constraints=limits.replaced(field_spread=kept), recording=recording
    )


def _with_pitch(specification: Specification, pitch_um: float) -> Specification:
    """Return the specification with another pixel pitch on a sensor of the same size."""
    sensor = specification.sensor
    pixels = tuple(max(1, round(n * sensor.pixel_pitch_um / pitch_um)) for n in sensor.pixels)
    return specification.model_copy(
        update={"sensor": sensor.replaced(pixel_pitch_um=pitch_um, pixels=pixels)}
    )


def _with_tolerances(specification: Specification, factor: float) -> Specification:
    assert specification.tolerances is not None  # a yield is asked for
    tolerances = specification.tolerances.replaced(factor=factor)
    return specification.model_copy(update={"tolerances": tolerances})


FIELD = LimitedQuantity("field", "mm", lambda s: s.object.field_diameter_mm, _with_field)
APERTURE = LimitedQuantity("numerical aperture", "", lambda s: s.object.numerical_aperture, _with_aperture)
PITCH = LimitedQuantity("pixel pitch", "um", lambda s: s.sensor.pixel_pitch_um, _with_pitch)
TOLERANCES = LimitedQuantity("tolerances", "times", lambda s: 1.0, _with_tolerances)


def limited_quantities(specification: Specification) -> tuple[LimitedQuantity, ...]:
    """Return field, aperture, pixel pitch and, if the specification limits a yield, tolerances."""
    tolerances = specification.tolerances
    quantities = (FIELD, APERTURE, PITCH)
    if specification.constraints.min_yield is None or tolerances is None or tolerances.cost is not None:
        return quantities
    return (*quantities, TOLERANCES)
