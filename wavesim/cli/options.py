"""Options of commands: common options, and options that are made from settings models."""

from __future__ import annotations

import inspect
import math
import types
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic import AliasChoices, ValidationError
from pydantic.fields import FieldInfo

from lensdesign.common.console import say
from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.options import output_option
from lensdesign.errors import InputError
from wavesim.scene.settings import SettingError

DesignOption = Annotated[
    Path,
    typer.Option("--design", metavar="DESIGN", help="Design file (TOML).", rich_help_panel=OptionGroup.INPUT),
]
Frames = Annotated[
    list[Path],
    typer.Argument(
        metavar="FRAMES...",
        help="Frames (TIFF), one or more for each plane. Those of other programs than `wavesim image` need "
        "options of the groups Frames and Camera (--help-all).",
    ),
]
Empty = Annotated[
    list[Path] | None,
    typer.Option(
        help="Frames without an object, for the errors of the light: a file or a folder; may be repeated.",
        rich_help_panel=OptionGroup.INPUT,
    ),
]
Priors = Annotated[
    Path | None,
    typer.Option(
        metavar="STUDY",
        help="Tolerance study (TOML), whose tolerances are the expected deviations of the lens.",
        rich_help_panel=OptionGroup.INPUT,
    ),
]
Output = Annotated[Path, output_option("Folder to write to.", "DIR", is_folder=True)]

Command = Callable[..., None]


def with_settings(command: Command) -> Command:
    """Return a command in which each field of a settings model becomes an option.

    An option has its field's name (or alias), default and description. The numbers of a tuple are separated
    by commas. Messages about invalid settings name the options.
    """
    own = inspect.signature(command, eval_str=True).parameters
    models: dict[str, type[FrozenModel]] = {
        name: one.annotation
        for name, one in own.items()
        if inspect.isclass(one.annotation) and issubclass(one.annotation, FrozenModel)
    }

    shown = {
        field: _option(_names(model, field)[0]) for model in models.values() for field in model.model_fields
    }

    def run(**values: Any) -> None:
        try:
            for name, model in models.items():
                texts = {field: values.pop(field) for field in model.model_fields}
                values[name] = _settings(model, texts)
            command(**values)
        except SettingError as error:
            raise InputError(error.naming(lambda name: shown.get(name, _option(name)))) from None

    parameters = []
    for name, parameter in own.items():
        parameters += _parameters(models[name]) if name in models else [parameter]
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__dict__.update(vars(command))
    keyword = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in parameters]
    run.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in keyword}
    return run


def _parameters(model: type[FrozenModel]) -> list[inspect.Parameter]:
    """Return one parameter for each field, annotated for Typer."""
    # A field that a subclass defines again keeps the group of the class that defined it first.
    groups = {
        name: getattr(one, "option_group", OptionGroup.OUTPUT)
        for one in model.__mro__
        for name in inspect.get_annotations(one)
        if name in model.model_fields
    }
    made = []
    for name, field in model.model_fields.items():
        flags = [] if bool in _kinds(field.annotation) else [_option(one) for one in _names(model, name)]
        kind = _typed(field)
        option = typer.Option(
            *flags,
            help=field.description,
            metavar=_stated(model, name, "metavar") or _metavar(field),
            rich_help_panel=_stated(model, name, "group") or groups[name],
        )
        typed: Any = Annotated[kind, option]
        default = field.get_default(call_default_factory=True)
        made.append(
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=_text(default), annotation=typed)
        )
    return made


def _stated(model: type[FrozenModel], name: str, key: str) -> Any:
    """Return what a field, or its definition in a base class, states for the help; None if nothing."""
    for one in model.__mro__:
        field = one.model_fields.get(name) if issubclass(one, FrozenModel) else None
        extra = None if field is None else field.json_schema_extra
        if isinstance(extra, dict) and key in extra:
            return extra[key]
    return None


def _metavar(field: FieldInfo) -> str | None:
    """Return how the help shows the value of an option; None: by its type."""
    kinds = _kinds(field.annotation)
    words = "|".join(word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind))
    if words:
        return f"NUMBER|{words}" if float in kinds else f"[{words}]"
    pairs = [kind for kind in kinds if get_origin(kind) is tuple]
    if not pairs:
        return None
    return "X,Y" if _is_list(pairs[0]) or get_args(pairs[0]) == (float, float) else "NUMBER,..."


def _names(model: type[FrozenModel], name: str) -> list[str]:
    """Return the name of a field as an option, and its former names."""
    field = model.model_fields[name]
    if stated := _stated(model, name, "options"):
        return list(stated)
    if isinstance(field.validation_alias, AliasChoices):
        return [str(choice) for choice in field.validation_alias.choices]
    return [field.alias or name]


def _typed(field: FieldInfo) -> Any:
    """Return the type that Typer reads from the command line for a field."""
    kinds = _kinds(field.annotation)
    optional = type(None) in kinds
    kinds = [kind for kind in kinds if kind is not type(None)]
    plain: Any = kinds[0] if len(kinds) == 1 and kinds[0] in (bool, int, float, str, Path) else str
    if _is_list(kinds[0]):
        plain, optional = list[str], True
    return plain | None if optional else plain


def _kinds(annotation: Any) -> list[Any]:
    """Return the members of a union without their annotations."""
    if get_origin(annotation) is Annotated:
        return _kinds(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return [kind for one in get_args(annotation) for kind in _kinds(one)]
    return [annotation]


def _is_list(kind: Any) -> bool:
    """Return whether an option may be repeated, with a group of numbers each time."""
    return get_origin(kind) is tuple and get_origin(_kinds(get_args(kind)[0])[0]) is tuple


def _text(default: Any) -> Any:
    """Return a default as it is written on the command line."""
    if not isinstance(default, tuple):
        return default
    return ",".join(f"{number:g}" for number in default) or None


def _settings(model: type[FrozenModel], texts: dict[str, Any]) -> FrozenModel:
    """Return the settings model with the values of the command line."""
    values = {}
    for name, text in texts.items():
        field = model.model_fields[name]
        if text is not None:
            values[name] = _value(_kinds(field.annotation), text, _option(_names(model, name)[0]))
    try:
        return model(**values)
    except ValidationError as error:
        raise InputError("\n".join(_fault(model, texts, fault) for fault in error.errors())) from None


def _value(kinds: list[Any], text: Any, option: str) -> Any:
    """Convert the text of an option to the value of its field."""
    pairs = [kind for kind in kinds if get_origin(kind) is tuple]
    if pairs and _is_list(pairs[0]):
        return tuple(_value(_kinds(get_args(pairs[0])[0]), one, option) for one in text)
    words = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
    if not isinstance(text, str) or text in words:
        return text
    if pairs and int not in kinds:
        inner = get_args(pairs[0])
        return tuple(numbers(text, option, None if inner[-1] is ... else len(inner)))
    if words and float in kinds:
        return numbers(text, option, 1, words)[0]
    return text


def _fault(model: type[FrozenModel], texts: dict[str, Any], fault: Any) -> str:
    """Return the message about one invalid option."""
    refused = fault.get("ctx", {}).get("error")
    if isinstance(refused, SettingError):
        return refused.naming(
            lambda one: _option(_names(model, one)[0] if one in model.model_fields else one)
        )
    name = str(fault["loc"][0])
    field = model.model_fields[name]
    reason = fault["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    if fault["type"] == "literal_error":
        words = (word for kind in _kinds(field.annotation) for word in get_args(kind))
        reason = f"allowed: {', '.join(words)}"
    value = texts[name]
    shown = f"{value:g}" if isinstance(value, int | float) else repr(value)
    return f"{_option(_names(model, name)[0])} = {shown}: {reason}"


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def numbers(text: str, option: str, count: int | None = None, words: Sequence[str] = ()) -> list[float]:
    """Return the numbers of an option, which are separated by commas.

    Parameters
    ----------
    text, option
        Value and name of the option.
    count
        How many numbers there must be; default: one or more.
    words
        Words that the option allows instead, for the message.

    Raises
    ------
    InputError
        If they are no finite numbers, or not as many as wanted.
    """
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not all(map(math.isfinite, values)) or (count is not None and len(values) != count):
        wanted = f"{'' if count is None else f'{count} '}numbers, separated by commas"
        if count == 1:
            wanted = " or ".join(("a finite number", *words))
        raise InputError(f"{option} = {text!r}: must be {wanted}")
    return values


def validate_picture_request(path: Path | None) -> None:
    """Check that the name of a picture file has a suffix of a picture format.

    Raises
    ------
    InputError
        If it does not end in .png, .pdf or .svg.
    """
    suffixes = (".png", ".pdf", ".svg")
    if path is not None and path.suffix.lower() not in suffixes:
        raise InputError(f"--output = {str(path)!r}: the file name must end in one of {', '.join(suffixes)}")


def settings_text(settings: dict[str, Any]) -> str:
    """Format the settings of an engine in one line."""
    return ", ".join(
        f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}"
        for name, value in settings.items()
    )


def warning_messages(caught: Iterable[warnings.WarningMessage]) -> list[str]:
    """Return the messages of recorded warnings, each of them once."""
    return list(dict.fromkeys(str(warning.message) for warning in caught))


def print_warnings(messages: Iterable[str]) -> None:
    """Print the warnings of engines to standard error."""
    for message in messages:
        say("warning:", message, to_errors=True)
