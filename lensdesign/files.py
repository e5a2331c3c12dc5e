"""Design files (TOML): read with every fault named, written without loss."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError

from lensdesign.errors import DesignError, InputError, atomic_path
from lensdesign.system import Lens

Model = TypeVar("Model", bound=BaseModel)


def load_design(path: str | os.PathLike[str]) -> Lens:
    """Read a lens from a design file.

    Parameters
    ----------
    path
        A TOML file. Paths of glass catalogues in it are relative to its own folder.

    Returns
    -------
    Lens

    Raises
    ------
    DesignError
        If the file cannot be read or does not describe a lens; the message names file, key, value and
        what is allowed.
    MaterialError
        If a glass is unknown, or not known at one of the wavelengths.
    """
    path = Path(path)
    data = read_toml(path)
    lens = validate(Lens, data, path)
    catalogs = tuple((path.parent / c).resolve() for c in lens.glass_catalogs)
    lens = lens.model_copy(update={"glass_catalogs": catalogs})
    for wavelength in lens.wavelengths_um:
        try:
            lens.indices(wavelength)
        except InputError as error:
            raise type(error)(f"{path}: {error}") from error
    return lens


def save_design(lens: Lens, path: str | os.PathLike[str]) -> None:
    """Write a lens to a design file; reading it back gives an equal lens.

    Raises
    ------
    InputError
        If the file cannot be written; whatever stood there stays.
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(design_text(lens, path.parent), encoding="utf-8")


def design_text(lens: Lens, folder: Path = Path()) -> str:
    """A lens as the text of a design file in `folder`."""
    data = lens.model_dump(mode="json", by_alias=True, exclude_defaults=True, exclude_none=True)
    if lens.glass_catalogs:
        data["glass_catalogs"] = [os.path.relpath(c, folder.resolve()) for c in lens.glass_catalogs]
    return tomli_w.dumps(data)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, or a DesignError that names the file and the line."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DesignError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DesignError(f"cannot read {path}: not a text file in UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        raise DesignError(f"{path}: not valid TOML: {error}") from error


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
        lines = sorted({_fault(fault, model) for fault in error.errors()})
        raise DesignError("\n".join(f"{source}: {line}" for line in lines)) from None


def _fault(fault: Any, model: type[BaseModel]) -> str:
    where = _where(fault["loc"])
    kind, message = fault["type"], fault["msg"].removeprefix("Value error, ")
    if kind == "extra_forbidden":
        allowed = ", ".join(_allowed_keys(model, fault["loc"][:-1]))
        return f"{where}: unknown key" + (f"; allowed: {allowed}" if allowed else "")
    if kind == "missing":
        return f"{where}: missing key"
    if kind == "value_error":
        return f"{where}: {message}" if where else message
    message = message.replace("Input should", "must", 1)
    return f"{where} = {_shown(fault['input'])}: {message}"


def _where(loc: tuple[int | str, ...]) -> str:
    """`surface 2, radius_mm` for ("surface", 1, "radius_mm"): people count from one."""
    parts: list[str] = []
    for item in loc:
        if isinstance(item, int):
            parts[-1:] = [f"{parts[-1]} {item + 1}"] if parts else [str(item + 1)]
        elif not _is_union_branch(item):
            parts.append(item)
    return ", ".join(parts)


def _is_union_branch(item: str) -> bool:
    return item in {"str", "float", "int", "bool", "none"} or item.startswith(("constrained-", "function-"))


def _shown(value: Any) -> str:
    text = repr(value)
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
