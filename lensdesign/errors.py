"""Exceptions of the toolkit, and checks of values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral


class TransferLensError(Exception):
    """Base class of the exceptions that the toolkit raises on purpose.

    Catch it to handle all of them at once.

    Examples
    --------
    >>> from lensdesign import TransferLensError, load_design
    >>> try:
    ...     load_design("missing.toml")
    ... except TransferLensError as error:
    ...     print(error)
    cannot read missing.toml: No such file or directory
    """


class InputError(TransferLensError, ValueError):
    """Invalid input; the message names the location, the value and what is allowed.

    Commands print the message and exit with status 2.

    Examples
    --------
    >>> from lensdesign import InputError, Pose
    >>> try:
    ...     Pose(tilt_x_deg=float("inf"))
    ... except InputError as error:
    ...     print(error)
    Pose.tilt_x_deg = inf: must be a finite number or a 1-D array of finite numbers
    """


class DesignError(InputError):
    """Invalid design, specification or tolerance study.

    Examples
    --------
    >>> from lensdesign import DesignError, load_design, scaled
    >>> try:
    ...     scaled(load_design("designs/paper_singlet.toml"), 0.0)
    ... except DesignError as error:
    ...     print(error)
    scale factor = 0.0: must be finite and greater than 0
    """


class MaterialError(InputError):
    """Unknown material, or a wavelength outside the range for which its index is known.

    Examples
    --------
    >>> from lensdesign import MaterialError, get_material
    >>> try:
    ...     get_material("N-BK7").index(20.0)
    ... except MaterialError as error:
    ...     print(error)
    N-BK7 (Schott): the index at 20 µm is not known; the wavelength must be from 0.3 to 2.5 µm
    """


class SamplingError(InputError):
    """Grid that cannot represent the requested field."""


def validate_positive(name: str, value: float) -> None:
    """Raise InputError unless a value is finite and above 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} = {value!r}: must be finite and above 0")


def validate_whole_number(name: str, value: int, least: int) -> None:
    """Raise InputError unless a value is a whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise InputError(f"{name} = {value!r}: must be a whole number from {least}")


def validate_choice(name: str, value: str, allowed: Sequence[str]) -> None:
    """Raise InputError unless a value is one of the allowed ones."""
    if value not in allowed:
        raise InputError(f"{name} = {value!r}: allowed: {', '.join(allowed)}")
