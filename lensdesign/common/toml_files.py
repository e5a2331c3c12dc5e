"""Text and TOML files: reading with every fault named, and validation against a model."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from lensdesign.common.input_files import TABLE_BYTES, TOML_BYTES, read_input
from lensdesign.errors import DesignError

Model = TypeVar("Model", bound=BaseModel)
Entry = TypeVar("Entry")

# A dotted key of more than eight parts; the time of tomllib grows faster than the square of their number.
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){8}""")

MOST_FAULTS = 50
"""Largest number of faults reported for one file."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise a DesignError with file and line if it is not valid."""
    text = read_text(path, TOML_BYTES)
    if _LONG_KEY.search(text):
        raise DesignError(f"{path}: not valid TOML: a dotted key of more than 8 parts")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of too many digits, and deep nesting
        raise DesignError(f"{path}: not valid TOML: {error}") from error


def read_text(path: Path, most_bytes: int = TABLE_BYTES) -> str:
    """Return the text of a UTF-8 file without a byte order mark, with newlines as line ends.

    Raises
    ------
    DesignError
        If the file cannot be read or is not UTF-8.
    """
    data = read_input(path, most_bytes, DesignError)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DesignError(f"cannot read {path}: not a text file in UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def validate(model: type[Model], data: dict[str, Any], source: str | Path) -> Model:
    """Return the model of data; all faults are reported in one DesignError, one line each.

    Parameters
    ----------
    model
        The pydantic model to build.
    data
        Tables as read from a file.
    source
        Name of the source of the data in messages, usually the file.

    Raises
    ------
    DesignError
        If the data do not fit the model.
    """
    try:
        return model.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as error:
        count = error.error_count()
        lines = sorted(_fault_lines(error.errors(include_url=False)[:MOST_FAULTS], model))
        lines += [f"and {count - MOST_FAULTS} more faults"] if count > MOST_FAULTS else []
        raise DesignError("\n".join(f"{source}: {line}" for line in lines)) from None


def pick(registry: Mapping[str, Entry], table: Mapping[str, Any], key: str, source: str) -> Entry:
    """Return the entry of a registry that a table names.

    Parameters
    ----------
    registry
        Entries by name.
    table, key
        The table, and the key with the name of the entry.
    source
        Name of the table in messages.

    Raises
    ------
    DesignError
        If the key is missing, or the name is not in the registry; the message lists the allowed names.
    """
    allowed = ", ".join(registry)
    if key not in table:
        raise DesignError(f"{source}: {key}: missing key; allowed values: {allowed}")
    name = table[key]
    if isinstance(name, str) and name in registry:
        return registry[name]
    hint = did_you_mean(str(name), registry)
    raise DesignError(f"{source}: {key} = {name!r}: there is no such {key}; allowed: {allowed}{hint}")


def joined_faults(faults: Sequence[str]) -> str:
    """Return the faults of a file, one per line, up to a number and length of lines."""
    lines = [line for fault in faults for line in fault.splitlines()]
    most_characters = 1000
    shown = [
        line if len(line) <= most_characters else f"{line[:most_characters]}..."
        for line in lines[:MOST_FAULTS]
    ]
    if len(lines) > MOST_FAULTS:
        shown.append(f"and {len(lines) - MOST_FAULTS} more faults")
    return "\n".join(shown)


def unknown_key(key: str, allowed: Iterable[str]) -> str:
    """Return `unknown key; allowed: ...`, with the most similar allowed key, if any."""
    allowed = list(allowed)
    listed = f"; allowed: {', '.join(allowed)}" if allowed else ""
    return f"unknown key{listed}{did_you_mean(key, allowed)}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean ...?` if a known name is similar, else an empty string."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _fault_lines(faults: Iterable[Any], model: type[BaseModel]) -> list[str]:
    """Return one line for each location, which joins the messages of all its types; no lines for parents."""
    messages: dict[tuple[int | str, ...], list[str]] = {}
    for fault in faults:
        loc = tuple(i for i in fault["loc"] if isinstance(i, int) or not _is_union_branch(i))
        head, message = _fault(fault, loc, model)
        own = messages.setdefault(loc, [])
        own.append(f"or {message.removeprefix('must be ')}" if own else f"{head}: {message}".strip(": "))
    parents = {loc[:depth] for loc in messages for depth in range(1, len(loc))}
    return [" ".join(own) for loc, own in messages.items() if loc not in parents]


def _fault(fault: Any, loc: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, str]:
    """Return the location of a fault, with the value if useful, and the message."""
    location, kind, context = _location(loc), fault["type"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return location, unknown_key(str(loc[-1]), _allowed_keys(model, loc[:-1]))
    if kind == "missing":
        return location, "missing value" if isinstance(loc[-1], int) else "missing key"
    if kind == "value_error":
        return location, fault["msg"].removeprefix("Value error, ")
    plain = {
        "tuple_type": f"must be tables, each headed [[{location}]]"
        if isinstance(fault["input"], dict)
        else "must be a list",
        "model_type": "must be a table",
        "too_short": f"must hold at least {_items(context.get('min_length'))}",
        "too_long": f"must hold at most {_items(context.get('max_length'))}",
        "is_instance_of": f"must be a {str(context.get('class')).lower()}",
        "string_pattern_mismatch": f"must match the pattern {context.get('pattern')}",
    }
    message = plain.get(kind, fault["msg"])
    for start in ("Input should", "Input is not"):
        message = message.replace(start, "must" if start.endswith("should") else "must be", 1)
    return f"{location} = {_shown(fault['input'])}", message


def _items(count: int | None) -> str:
    return f"{count} item" if count == 1 else f"{count} items"


def _location(loc: tuple[int | str, ...]) -> str:
    """Return `surface 2, radius_mm` for ("surface", 1, "radius_mm"), with numbers from 1."""
    parts: list[str] = []
    for item in loc:
        if isinstance(item, int):
            parts[-1:] = [f"{parts[-1]} {item + 1}"] if parts else [str(item + 1)]
        else:
            parts.append(item if len(item) <= 60 else item[:57] + "...")
    return ", ".join(parts)


def _is_union_branch(item: str) -> bool:
    starts = ("branch-", "constrained-", "function-", "literal[", "tuple[")
    return item in {"str", "float", "int", "bool", "none"} or item.startswith(starts)


def _shown(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else text[:57] + "..."


def _allowed_keys(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the table at `loc` from the annotations of the model."""
    for item in loc:
        if isinstance(item, int):
            continue
        field = next((f for n, f in model.model_fields.items() if item in (n, f.alias)), None)
        inner = None if field is None else _model_in(field.annotation)
        if inner is None:
            return []
        model = inner
    return [f.alias or name for name, f in model.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _model_in(argument)
        if found is not None:
            return found
    return None
