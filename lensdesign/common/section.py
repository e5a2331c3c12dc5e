"""Tables of design and study files: what all of them have in common."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from lensdesign.common.number_limits import LARGEST_IN_FILES, SMALLEST_IN_FILES
from lensdesign.errors import DesignError, InputError

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _no_trace(value: float) -> float:
    if value < SMALLEST_IN_FILES:
        raise ValueError(f"must be at least {SMALLEST_IN_FILES:g}")
    return value


Positive = Annotated[
    float, Field(gt=0.0, le=LARGEST_IN_FILES, allow_inf_nan=False), AfterValidator(_no_trace)
]
"""Sizes of any unit, within the limits of :mod:`lensdesign.common.number_limits`."""

Bounded = Annotated[float, Field(ge=-LARGEST_IN_FILES, le=LARGEST_IN_FILES, allow_inf_nan=False)]
"""Numbers of either sign and any unit; both ends keep what is computed from them finite."""


class Section(BaseModel):
    """One table of a file: frozen, and without keys that nobody asked for."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, populate_by_name=True)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, some of its values replaced without validation.

        What the section has derived from its values (cached properties) is derived anew.
        """
        copied = super().model_copy(update=update, deep=deep)
        if update:
            for own in type(self).__mro__:
                for name, value in vars(own).items():
                    if isinstance(value, cached_property):
                        copied.__dict__.pop(name, None)
        return copied

    def replaced(self, **changes: Any) -> Self:
        """A section with some of its values replaced, and validated anew.

        Raises
        ------
        DesignError
            If a value is not allowed, or the values do not go together.
        """
        values = {name: getattr(self, name) for name in type(self).model_fields}
        try:
            return type(self)(**(values | changes))
        except ValidationError as error:
            text = "; ".join(_told(fault) for fault in error.errors())
            raise DesignError(text.replace("Value error, ", "").replace("Input should", "must")) from None


def _told(fault: Any) -> str:
    """What is wrong, and where, unless it says so itself."""
    refused = fault.get("ctx", {}).get("error")
    if isinstance(refused, InputError):
        return str(refused)
    return ": ".join([*map(str, fault["loc"]), fault["msg"]])


def tuples(value: Any) -> Any:
    """TOML arrays are lists; frozen models hold tuples."""
    return tuple(value) if isinstance(value, list) else value


def rows(value: Any) -> Any:
    """A list of lists as a tuple of tuples."""
    return tuple(tuples(row) for row in value) if isinstance(value, list | tuple) else value


def as_path(value: Any) -> Any:
    """A path in a file is a string."""
    if "\0" in str(value):
        raise ValueError("a path cannot hold a NUL character")
    return Path(value) if isinstance(value, str) else value
