"""Polarization of the light: scalar waves, or states whose intensities add up.

Light of one polarization illuminates the object, which keeps it: in all directions behind the object the
field has the same components in the double-pole basis (:mod:`lensdesign.raytrace.polarization`). The lens
mixes them. Behind the lens the components do not interfere, and the sensor adds their intensities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError

AUTO, SCALAR, UNPOLARIZED, CIRCULAR = "auto", "scalar", "unpolarized", "circular"
NAMES = (AUTO, SCALAR, UNPOLARIZED, CIRCULAR)
ALLOWED = (
    f"must be one of {', '.join(NAMES)}, or the angle of linear polarization from x towards y in degrees"
)

Jones = tuple[complex, complex]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Component:
    """A component of the field behind the lens, for one state of the light in front of it.

    Attributes
    ----------
    state : (complex, complex)
        Jones vector of the light, times the root of its fraction of the energy.
    analyzer : (complex, complex)
        Unit Jones vector of the component.
    """

    state: Jones
    analyzer: Jones

    def of(self, matrices: ComplexArray) -> ComplexArray:
        """Return the component for Jones matrices of shape (..., 2, 2)."""
        return np.asarray(np.conj(self.analyzer) @ (matrices @ np.array(self.state))[..., None])[..., 0]


def is_vector(polarization: str | float) -> bool:
    """Return whether light of a polarization is computed as a vector field."""
    return polarization not in (AUTO, SCALAR)


def components_of(polarization: str | float) -> tuple[Component, ...]:
    """Return the components of the field behind the lens; none for scalar waves.

    There are two for each state of the light: the component in that state, and the crossed one, which the
    lens alone produces and which is small. The intensities of all components add up.

    Parameters
    ----------
    polarization
        ``auto`` or ``scalar``, ``unpolarized``, ``circular`` (right-handed), or the angle of linear
        polarization from x towards y in degrees.

    Raises
    ------
    InputError
        If there is no such polarization.
    """
    validate_polarization("polarization", polarization)
    if not is_vector(polarization):
        return ()
    root = math.sqrt(0.5)
    if polarization == UNPOLARIZED:
        x, y = (1.0 + 0.0j, 0.0j), (0.0j, 1.0 + 0.0j)
        return tuple(
            Component((root * state[0], root * state[1]), analyzer)
            for state, other in ((x, y), (y, x))
            for analyzer in (state, other)
        )
    state: Jones = root + 0.0j, -1j * root
    if polarization != CIRCULAR:
        angle = math.radians(float(polarization))
        state = complex(math.cos(angle)), complex(math.sin(angle))
    crossed = -state[1].conjugate(), state[0].conjugate()
    return Component(state, state), Component(state, crossed)


def polarization_text(polarization: str | float) -> str:
    """Return the kind of light in a few words."""
    if not is_vector(polarization):
        return "scalar waves"
    if isinstance(polarization, str):
        return {UNPOLARIZED: "unpolarized light", CIRCULAR: "circularly polarized light"}[polarization]
    return f"linearly polarized light ({polarization:g} deg from x)"


def validate_polarization(name: str, value: str | float) -> None:
    """Raise InputError unless a value is a polarization; see :func:`components_of`."""
    is_angle = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not (value in NAMES if isinstance(value, str) else is_angle):
        raise InputError(f"{name} = {value!r}: {ALLOWED}")


def read_polarization(name: str, text: str) -> str | float:
    """Return the polarization that a text gives: a name, or an angle in degrees.

    Raises
    ------
    InputError
        If it is neither.
    """
    try:
        value: str | float = float(text)
    except ValueError:
        value = text
    validate_polarization(name, value)
    return value
