"""Signatures with the annotations that the source has, and sections of module docstrings."""

from __future__ import annotations

import inspect
import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import desc_content
from sphinx.transforms import SphinxTransform
from sphinx.util.inspect import stringify_signature
from sphinx.util.typing import stringify_annotation

LONGEST_DEFAULT = 40
UNDERLINED = re.compile(r"-{3,}")


def setup(app: Any) -> dict[str, bool]:
    """Come before napoleon, which would make headings of the sections of modules."""
    app.connect("autodoc-process-signature", _signature, priority=400)
    app.connect("autodoc-process-docstring", _sections, priority=400)
    app.connect("autodoc-skip-member", _skipped)
    app.add_transform(PlainFields)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class PlainFields(SphinxTransform):
    """Give fields of classes the name that docstrings give them, and leave out the base of all classes."""

    default_priority = 900

    def apply(self, **_: Any) -> None:
        for name in self.document.findall(nodes.field_name):
            if name.astext() == "Variables":
                name[:] = [nodes.Text("Attributes")]
        for field in self.document.findall(nodes.field_list):
            for text in list(field.findall(nodes.Text)):
                if text == " -- ":
                    text.parent.replace(text, nodes.Text(" – "))
        for content in self.document.findall(desc_content):
            if content and content[0].astext() == "Bases: object":
                del content[0]


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
        for name, annotation in inspect.get_annotations(base).items()
    }


def _sections(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Make the titles of a module's sections text: headings would collide with those of other modules."""
    if what == "module":
        for number in range(len(lines) - 1, 0, -1):
            if UNDERLINED.fullmatch(lines[number]) and len(lines[number]) == len(lines[number - 1]):
                lines[number - 1 : number + 1] = [f"**{lines[number - 1]}**", ""]


def _skipped(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out constants, aliases of types, and imported names, before autodoc reads them."""
    if what != "module":
        return None
    is_definition = inspect.isroutine(obj) or inspect.isclass(obj) or hasattr(obj, "__wrapped__")
    is_own = getattr(obj, "__module__", None) == app.env.current_document.autodoc_module
    return None if is_definition and is_own else True
