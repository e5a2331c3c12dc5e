"""Signatures with the annotations that the source has, and sections of module docstrings."""

from __future__ import annotations

import inspect
import re
from typing import Any

from sphinx.util.inspect import stringify_signature
from sphinx.util.typing import stringify_annotation

LONGEST_DEFAULT = 40
UNDERLINED = re.compile(r"-{3,}")


def setup(app: Any) -> dict[str, bool]:
    """Come before napoleon, which would make headings of the sections of modules."""
    app.connect("autodoc-process-signature", _signature, priority=400)
    app.connect("autodoc-process-docstring", _sections, priority=400)
    app.connect("autodoc-skip-member", _skipped)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _signature(
    app: Any, what: str, name: str, obj: Any, options: Any, arguments: str | None, returned: str | None
) -> tuple[str, str] | None:
    """Return the signature without the evaluation of aliases, which would show what they stand for."""
    if arguments is None or not callable(obj):
        return None
    try:
        signature = inspect.signature(obj)
    except (TypeError, ValueError):
        return None
    parameters = list(signature.parameters.values())
    if what == "method" and parameters and parameters[0].name == "self":
        parameters = parameters[1:]
    written = _written_fields(obj) if isinstance(obj, type) else {}
    parameters = [
        p.replace(annotation=written.get(p.name, p.annotation), default=_short(p.default)) for p in parameters
    ]
    returned = "" if isinstance(obj, type) else _annotation(signature.return_annotation)
    signature = signature.replace(parameters=parameters, return_annotation=inspect.Signature.empty)
    return stringify_signature(signature, unqualified_typehints=True), returned


class _Written:
    """Something of which the representation is given."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _short(default: Any) -> Any:
    """Return a default as it is, or the name of its class if it has many fields."""
    if default is inspect.Parameter.empty or len(repr(default)) <= LONGEST_DEFAULT:
        return default
    return _Written(f"{type(default).__name__}(...)")


def _annotation(written: Any) -> str:
    if written is inspect.Signature.empty:
        return ""
    return stringify_annotation(written, "smart")


def _written_fields(cls: type) -> dict[str, Any]:
    """Return the annotations of a class and its bases."""
    return {
        name: annotation
        for base in reversed(cls.__mro__)
        for name, annotation in base.__dict__.get("__annotations__", {}).items()
    }


def _sections(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make the titles of a module's sections text: headings would collide with those of other modules."""
    if what == "module":
        for number in range(len(lines) - 1, 0, -1):
            if UNDERLINED.fullmatch(lines[number]) and len(lines[number]) == len(lines[number - 1]):
                lines[number - 1 : number + 1] = [f"**{lines[number - 1]}**", ""]


def _skipped(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out constants, and aliases of types."""
    is_definition = inspect.isroutine(obj) or inspect.isclass(obj) or isinstance(obj, property)
    return True if what == "module" and not is_definition else None
