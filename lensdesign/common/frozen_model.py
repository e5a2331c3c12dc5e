"""Base class and number types of the tables of design and study files."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator

from lensdesign.common.number_limits import LARGEST_IN_FILES, SMALLEST_IN_FILES
from lensdesign.errors import DesignError, InputError

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _not_tiny(value: float) -> float:
    if value < SMALLEST_IN_FILES:
        raise ValueError(f"must be at least {SMALLEST_IN_FILES:g}")
    return value


Positive = Annotated[
    float, Field(gt=0.0, le=LARGEST_IN_FILES, allow_inf_nan=False), AfterValidator(_not_tiny)
]
"""Positive size in any unit, within the limits of :mod:`lensdesign.common.number_limits`."""


def _zero_or_not_tiny(value: float) -> float:
    return _not_tiny(value) if value else value


NotNegative = Annotated[
    float, Field(ge=0.0, le=LARGEST_IN_FILES, allow_inf_nan=False), AfterValidator(_zero_or_not_tiny)
]
"""Size in any unit that may be 0, and is within the limits of a positive size otherwise."""

FiniteNumber = Annotated[float, Field(ge=-LARGEST_IN_FILES, le=LARGEST_IN_FILES, allow_inf_nan=False)]
"""Number of either sign in any unit; computations with both ends stay finite."""


def _lists_as_tuples(value: Any) -> Any:
    """Return an array of TOML as a tuple, with its inner arrays; immutable models have tuples."""
    return tuple(map(_lists_as_tuples, value)) if type(value) in (list, tuple) else value


class FrozenModel(BaseModel):
    """A table of a file: immutable and without unknown keys.

    A missing, unknown or forbidden value raises pydantic.ValidationError when an object is made. Methods that
    change an existing object raise DesignError instead.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, populate_by_name=True)

    _lists = field_validator("*", mode="before")(_lists_as_tuples)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with some values replaced, without validation or cached properties."""
        copied = super().model_copy(update=update, deep=deep)
        if update:
            for name in _cached_properties(type(self)):
                copied.__dict__.pop(name, None)
        return copied

    def replaced(self, **changes: Any) -> Self:
        """Return a validated copy with some values replaced, by their names or their keys in a file.

        Raises
        ------
        DesignError
            If a value is not allowed, or the values contradict each other.
        """
        fields = type(self).model_fields
        values = {field.alias or name: getattr(self, name) for name, field in fields.items()}
        keys = {name: field.alias for name, field in fields.items() if field.alias}
        changes = {keys.get(name, name): value for name, value in changes.items()}
        try:
            return type(self)(**(values | changes))
        except ValidationError as error:
            text = "; ".join(_message(fault) for fault in error.errors())
            raise DesignError(text.replace("Value error, ", "").replace("Input should", "must")) from None


@cache
def _cached_properties(model: type) -> tuple[str, ...]:
    """Return the names of the cached properties of a class; a search copies its lens thousands of times."""
    return tuple(
        name
        for own in model.__mro__
        for name, value in vars(own).items()
        if isinstance(value, cached_property)
    )


def _message(fault: Any) -> str:
    """Return the message of a fault with its location, unless the message states the location itself."""
    refused = fault.get("ctx", {}).get("error")
    if isinstance(refused, InputError):
        return str(refused)
    return ": ".join([*map(str, fault["loc"]), fault["msg"]])


def as_path(value: Any) -> Any:
    """Return the path that a string in a file gives."""
    if "\0" in str(value):
        raise ValueError("a path must not contain a NUL character")
    return Path(value) if isinstance(value, str) else value
