"""Text and TOML files: read with every fault named, and checked against a model."""

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

MOST_PARTS = 8
"""Of a dotted key: the time that tomllib takes grows with more than their square."""

_LONG_KEY = re.compile(
    r"""(?<![\w-])(?:(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){8}"""  # as many as MOST_PARTS
)

LONGEST_FAULT = 1000
"""Most characters of the line of a fault."""

MOST_FAULTS = 50
"""Told of one file."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, or a DesignError that names the file and the line."""
    text = read_text(path, TOML_BYTES)
    if _LONG_KEY.search(text):
        raise DesignError(f"{path}: not valid TOML: a dotted key of more than {MOST_PARTS} parts")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of too many digits, and deep nesting
        raise DesignError(f"{path}: not valid TOML: {error}") from error


def read_text(path: Path, most_bytes: int = TABLE_BYTES) -> str:
    """The text of a UTF-8 file, without a byte order mark, or a DesignError that names the file.

    Ends of lines become newlines.
    """
    data = read_input(path, most_bytes, DesignError)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DesignError(f"cannot read {path}: not a text file in UTF-8") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def validate(model: type[Model], data: dict[str, Any], source: str | Path) -> Model:
    """Check data against a model; all faults go into one DesignError, a line each.

    Parameters
    ----------
    model
        The pydantic model to build.
    data
        Tables as read from a file.
    source
        What to call the place where the data came from, usually the file.
    """
    try:
        return model.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as error:
        count = error.error_count()
        lines = sorted(_fault_lines(error.errors(include_url=False)[:MOST_FAULTS], model))
        lines += [f"and {count - MOST_FAULTS} more faults"] if count > MOST_FAULTS else []
        raise DesignError("\n".join(f"{source}: {line}" for line in lines)) from None


def pick(registry: Mapping[str, Entry], table: Mapping[str, Any], key: str, source: str) -> Entry:
    """The registry's entry that a table asks for by name.

    Parameters
    ----------
    registry
        What there is, by name.
    table, key
        The table, and the key under which it gives the name.
    source
        What to call the table in messages.

    Raises
    ------
    DesignError
        If the key is missing, or names nothing that there is; the message lists what there is.
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
    """Faults of a file, one a line; of very many, the first ones, and how many more there are.

    Each line is cut where it is longer than anybody reads.
    """
    lines = [line for fault in faults for line in fault.splitlines()]
    shown = [
        line if len(line) <= LONGEST_FAULT else f"{line[:LONGEST_FAULT]}..." for line in lines[:MOST_FAULTS]
    ]
    if len(lines) > MOST_FAULTS:
        shown.append(f"and {len(lines) - MOST_FAULTS} more faults")
    return "\n".join(shown)


def unknown_key(key: str, allowed: Iterable[str]) -> str:
    """`unknown key; allowed: ...`, with the key that was meant, as far as one can tell."""
    allowed = list(allowed)
    listed = f"; allowed: {', '.join(allowed)}" if allowed else ""
    return f"unknown key{listed}{did_you_mean(key, allowed)}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean ...?` where a known name is near, else nothing."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {near[0]}?" if near else ""


def _fault_lines(faults: Iterable[Any], model: type[BaseModel]) -> list[str]:
    """One line for each place: what all types that it may have say of it, and nothing of what holds it."""
    places: dict[tuple[int | str, ...], list[str]] = {}
    for fault in faults:
        loc = tuple(i for i in fault["loc"] if isinstance(i, int) or not _is_union_branch(i))
        head, message = _fault(fault, loc, model)
        said = places.setdefault(loc, [])
        said.append(f"or {message.removeprefix('must be ')}" if said else f"{head}: {message}".strip(": "))
    holders = {loc[:depth] for loc in places for depth in range(1, len(loc))}
    return [" ".join(said) for loc, said in places.items() if loc not in holders]


def _fault(fault: Any, loc: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, str]:
    """Where a fault is, with the value if that says something, and what is allowed."""
    where, kind, context = _where(loc), fault["type"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return where, unknown_key(str(loc[-1]), _allowed_keys(model, loc[:-1]))
    if kind == "missing":
        return where, "missing value" if isinstance(loc[-1], int) else "missing key"
    if kind == "value_error":
        return where, fault["msg"].removeprefix("Value error, ")
    plain = {
        "tuple_type": f"must be tables, each headed [[{where}]]"
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
    return f"{where} = {_shown(fault['input'])}", message


def _items(count: int | None) -> str:
    return f"{count} item" if count == 1 else f"{count} items"


def _where(loc: tuple[int | str, ...]) -> str:
    """`surface 2, radius_mm` for ("surface", 1, "radius_mm"): people count from one."""
    parts: list[str] = []
    for item in loc:
        if isinstance(item, int):
            parts[-1:] = [f"{parts[-1]} {item + 1}"] if parts else [str(item + 1)]
        else:
            parts.append(item if len(item) <= 60 else item[:57] + "...")
    return ", ".join(parts)


def _is_union_branch(item: str) -> bool:
    starts = ("constrained-", "function-", "literal[", "tuple[")
    return item in {"str", "float", "int", "bool", "none"} or item.startswith(starts)


def _shown(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else text[:57] + "..."


def _allowed_keys(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys of the table at `loc`, found by walking the model's annotations."""
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
