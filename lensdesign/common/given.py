"""Arguments of functions that are an object, or the path of the file that describes it."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, TypeVar

from lensdesign.errors import InputError

Object = TypeVar("Object")

FilePath = str | os.PathLike[str]
"""Path of a file."""


def object_of(given: Any, kind: type[Object], load: Callable[[Any], Object], name: str) -> Object:
    """Return an argument that is an object, or read the object from the file at a path.

    Parameters
    ----------
    given
        The argument.
    kind
        Class of the object.
    load
        Function that reads the object from a file.
    name
        Name of the argument in messages.

    Raises
    ------
    InputError
        If the argument is neither. The function that reads raises its own errors.
    """
    if isinstance(given, kind):
        return given
    if isinstance(given, str | os.PathLike):
        return load(given)
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    raise InputError(
        f"{name}: must be {article} {kind.__name__} or the path of its file, not {_shown(given)}"
    )


def _shown(given: Any) -> str:
    return "None" if given is None else f"an object of the class {type(given).__name__}"
