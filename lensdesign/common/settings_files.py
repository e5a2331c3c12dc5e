"""Settings files: options of a command in TOML, and the settings that a folder of results was made with."""

from __future__ import annotations

import difflib
import inspect
import os
import re
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import typer

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.help_pages import HELP_ALL, GroupedCommand
from lensdesign.common.option_groups import OptionGroup
from lensdesign.common.outputs import output_file, output_folder
from lensdesign.common.text import printable_name
from lensdesign.common.toml_files import read_toml
from lensdesign.errors import InputError

SETTINGS_OPTION, SETTINGS_NAME = "--settings", "settings_file"
"""Option of every command, and its parameter."""

SETTINGS_FILE = "settings.toml"
"""Name of the file that states the settings of the results in its folder."""

COMMAND_LINE_ONLY = frozenset({"--trust", "--force", "--fresh", "--cluster", SETTINGS_OPTION})
"""Options that a file, which may be from another person, must not set: they execute, delete or send data."""

SettingsFile = Annotated[
    Path | None,
    typer.Option(
        SETTINGS_OPTION,
        metavar="FILE",
        help="Options in a file (TOML); those on the command line take precedence.",
        rich_help_panel=OptionGroup.INPUT,
    ),
]


def with_settings_file(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function of a command with the further option `--settings`, which Typer reads.

    :class:`SettingsCommand` reads the file before the function is called.
    """

    def run(settings_file: SettingsFile = None, **values: Any) -> Any:
        return function(**values)

    own = inspect.signature(function, eval_str=True).parameters.values()
    added = inspect.signature(run, eval_str=True).parameters["settings_file"]
    keyword = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in (*own, added)]
    run.__name__, run.__doc__ = function.__name__, function.__doc__
    run.__dict__.update(vars(function))
    run.__signature__ = inspect.Signature(keyword)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in keyword}
    return run


@dataclass(frozen=True)
class Parameter:
    """An argument or option of a command, as settings files state it.

    Parameters
    ----------
    name
        Name of the parameter of the command's function.
    options
        Names of the option, and those that switch it off; empty for an argument.
    annotation
        Annotation of the parameter, with Typer's description.
    """

    name: str
    options: tuple[str, ...]
    off_options: tuple[str, ...]
    annotation: Any

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Keys of the parameter in a file: the names of the option without dashes in front."""
        names = [one.removeprefix("--") for one in self.options if one.startswith("--")]
        return tuple(names) or (self.name.strip("_").replace("_", "-"),)

    @cached_property
    def kind(self) -> Any:
        """Type of the values, without None."""
        return _plain_type(self.annotation)

    @cached_property
    def info(self) -> Any:
        """Typer's description of the parameter."""
        return getattr(self.annotation, "__metadata__", (typer.Option(),))[0]

    @property
    def metavar(self) -> str:
        """How the help shows the value; empty if by its type."""
        return self.info.metavar or ""

    @property
    def is_output_folder(self) -> bool:
        """Whether the value is the folder of the results."""
        return self.info.callback is output_folder

    @property
    def is_settable(self) -> bool:
        """Whether a file may state the parameter: files do not state what is written, deleted or executed."""
        writes = self.info.callback in (output_file, output_folder)
        stored = self.kind is Path and self.info.rich_help_panel == OptionGroup.OUTPUT
        return not (writes or stored or COMMAND_LINE_ONLY.intersection(self.options))

    def is_path(self, value: Any) -> bool:
        """Return whether a value is a path, not a word such as the name of a built-in object."""
        kind = _plain_type(get_args(self.kind)[0]) if get_origin(self.kind) is list else self.kind
        if kind is Path:
            return True
        *words, last = self.metavar.replace("[", "").replace("]", "").split("|")
        return kind is str and last in ("FILE", "STUDY") and value not in words

    def converted(self, value: Any, folder: Path) -> Any:
        """Return a value of a file as the command line has it; relative paths start at a folder.

        Raises
        ------
        ValueError
            If the value has another type. The message says what is allowed.
        """
        kind = self.kind
        if get_origin(kind) is list:
            inner = _plain_type(get_args(kind)[0])
            # A text that may be repeated, such as an object, may also be given once.
            items = [value] if inner is str and isinstance(value, str) else value
            if not isinstance(items, list):
                raise ValueError(f"must be an array, each item {_TYPE_NAMES.get(inner, 'a text')}")
            return [self._item(inner, item, folder) for item in items]
        if get_origin(kind) is tuple:
            kinds = get_args(kind)
            if not isinstance(value, list) or len(value) != len(kinds):
                raise ValueError(f"must be an array of {len(kinds)}")
            return tuple(self._item(one, item, folder) for one, item in zip(kinds, value, strict=True))
        return self._item(kind, value, folder)

    def _item(self, kind: Any, value: Any, folder: Path) -> Any:
        """Return one value as the command line has it."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if kind is bool and isinstance(value, bool):
            return value
        if (kind is int and is_number and isinstance(value, int)) or (kind is float and is_number):
            return value
        if isinstance(value, str) and not (isinstance(kind, type) and issubclass(kind, bool | int | float)):
            return os.path.join(folder, value) if self.is_path(value) else value
        if kind is str and self._has_numbers and (is_number or isinstance(value, list)):
            items = value if isinstance(value, list) else [value]
            if items and all(
                isinstance(one, int | float | str) and not isinstance(one, bool) for one in items
            ):
                return ",".join(one if isinstance(one, str) else repr(one) for one in items)
        more = ", or an array of values" if self._has_numbers else ""
        if isinstance(kind, type) and issubclass(kind, Enum):
            raise ValueError(f"allowed: {', '.join(str(one.value) for one in kind)}")
        raise ValueError(f"must be {_TYPE_NAMES.get(kind, 'a text')}{more}")

    @property
    def _has_numbers(self) -> bool:
        """Whether the text on the command line contains numbers, or values separated by commas."""
        return re.search(r"NUMBER|SIDE|,", self.metavar) is not None


_TYPE_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "a text", Path: "a path"}


def _plain_type(annotation: Any) -> Any:
    """Return the type of an annotation without its metadata and without None."""
    if get_origin(annotation) is Annotated:
        return _plain_type(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        (kind,) = (one for one in get_args(annotation) if one is not types.NoneType)
        return _plain_type(kind)
    return annotation


class SettingsCommand(GroupedCommand):
    """A command that reads options from a file, and writes its settings into the folder of its results."""

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """All arguments and options, by the names of the function's parameters."""
        annotations = {
            name: one.annotation
            for name, one in inspect.signature(self.callback, eval_str=True).parameters.items()  # type: ignore[arg-type]
        }
        found = {}
        for param in self.params:
            is_option = param.param_type_name == "option"
            options = tuple(param.opts) if is_option else ()
            off = tuple(param.secondary_opts) if is_option else ()
            found[param.name] = Parameter(param.name, options, off, annotations[param.name])
        return found

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; those that are not given are taken from the settings file."""
        if {"-h", "--help", HELP_ALL}.isdisjoint(args):
            given, _, _ = self.make_parser(ctx).parse_args(args=list(args))
            if isinstance(file := given.get(SETTINGS_NAME), str):
                stated = self._read(Path(file), ctx)
                ctx.default_map = {n: v for n, v in stated.items() if not _is_given(given.get(n))}
        try:
            found = super().parse_args(ctx, args)
            self._check_names(ctx)
            return found
        except typer.BadParameter as error:
            name = str(getattr(getattr(error, "param", None), "name", None))
            if name not in (ctx.default_map or {}):
                raise
            key, value = self.parameters[name].keys[0], ctx.default_map[name]
            reason = error.message.removeprefix("Value error, ").replace("Input should be", "must be")
            raise InputError(f"{file}: {key} = {value!r}: {reason}") from None

    def _check_names(self, ctx: Any) -> None:
        """Refuse names that the settings of the results cannot state, before anything is computed."""
        if not any(one.is_output_folder and ctx.params.get(one.name) for one in self.parameters.values()):
            return
        for one in self.parameters.values():
            value = ctx.params.get(one.name)
            for item in value if isinstance(value, list | tuple) else [value]:
                if isinstance(item, str | Path) and (shown := printable_name(str(item))) != str(item):
                    raise InputError(
                        f"{shown}: its name is not UTF-8, so the settings of the results cannot state it; "
                        "rename it"
                    )

    def invoke(self, ctx: Any) -> Any:
        """Run the command, and write the settings into the folder of its results."""
        try:
            result = super().invoke(ctx)
        except InputError as error:
            # Messages name an option as `--patch-mm` or by its parameter, `patch_mm`.
            named = set(re.findall(r"--[a-z][\w-]*|\b[a-z][a-z_]*(?= = )", str(error)))
            set_here = [self.parameters[name] for name in ctx.default_map or ()]
            found = [one.keys[0] for one in set_here if not named.isdisjoint({one.name, *one.options})]
            if found:
                raise InputError(
                    f"{error} ({', '.join(found)}: set in {ctx.params[SETTINGS_NAME]})"
                ) from error
            raise
        except typer.Exit as stop:
            if stop.exit_code in (0, 1):
                self._write(ctx)
            raise
        self._write(ctx)
        return result

    def _read(self, file: Path, ctx: Any) -> dict[str, Any]:
        """Return the values of a settings file for this command, by the names of parameters."""
        data = read_toml(file)
        commands = ctx.parent.command.commands if ctx.parent is not None else {self.name: self}
        tables = {key: one for key, one in data.items() if isinstance(one, dict) and key in commands}
        own = {key: one for key, one in data.items() if key not in tables}
        if tables and not own and self.name not in tables:
            raise InputError(
                f"{file}: nothing for `{ctx.command_path}`: the file has settings for {', '.join(tables)}"
            )
        faults = []
        for name, table in tables.items():
            faults += [f"[{name}] {one}" for one in commands[name].faults(table, file.parent)]
        faults += self.faults(own, file.parent)
        merged = own | tables.get(str(self.name), {})
        values: dict[str, Any] = {}
        for key, value in merged.items():
            found = self._parameter(key)
            if found is not None:
                if found.name in values:
                    faults.append(f"{key}: give {' or '.join(found.keys)}, not both")
                values[found.name] = value
        if faults:
            raise InputError("\n".join(f"{file}: {one}" for one in dict.fromkeys(faults)))
        return {name: self.parameters[name].converted(value, file.parent) for name, value in values.items()}

    def faults(self, table: Mapping[str, Any], folder: Path) -> list[str]:
        """Return what is wrong in the settings of a file: unknown keys, and values of another type."""
        found, unknown = list[str](), list[str]()
        settable = [key for one in self.parameters.values() if one.is_settable for key in one.keys[:1]]
        for key, value in table.items():
            parameter = self._parameter(key)
            if parameter is None:
                near = difflib.get_close_matches(key.replace("_", "-"), settable, 1)
                hint = f" (did you mean {near[0]}?)" if near else ""
                unknown.append(f"{key}{hint}")
            elif not parameter.is_settable:
                found.append(f"{key}: a file cannot set it; give it on the command line")
            else:
                try:
                    parameter.converted(value, folder)
                except ValueError as error:
                    found.append(f"{key} = {value!r}: {error}")
        if unknown:
            found.append(f"no option of {self.name}: {', '.join(unknown)}; allowed: {', '.join(settable)}")
        return found

    def _parameter(self, key: str) -> Parameter | None:
        return next((one for one in self.parameters.values() if key in one.keys), None)

    def _write(self, ctx: Any) -> None:
        """Write the settings of this run into the folder of its results, if it has one."""
        folder = next(
            (ctx.params[one.name] for one in self.parameters.values() if one.is_output_folder), None
        )
        if folder is None or not folder.is_dir():
            return
        with atomic_path(folder / SETTINGS_FILE) as temporary:
            temporary.write_text(self._settings_text(ctx, folder), encoding="utf-8")

    def _settings_text(self, ctx: Any, folder: Path) -> str:
        """Return the settings of a run as a file for `--settings`."""
        from importlib.metadata import version

        import tomli_w

        tables: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
        for one in self.parameters.values():
            value = ctx.params.get(one.name)
            if one.is_settable and one.name != "as_json" and value is not None and value not in ([], ()):
                source = ctx.get_parameter_source(one.name).name
                is_default = source == "DEFAULT" and one.name not in (ctx.default_map or {})
                tables[is_default][one.keys[0]] = _stored(one, value, folder.resolve())
        (is_output,) = (one for one in self.parameters.values() if one.is_output_folder)
        repeat = f"{ctx.command_path} {SETTINGS_OPTION} {SETTINGS_FILE} {is_output.options[0]} FOLDER"
        return (
            f"# Settings of the results in this folder, by transferlens {version('transferlens')}.\n"
            f"# To repeat the run: {repeat}\n"
            f"# Paths are relative to this folder.\n\n"
            f"[{self.name}]\n{tomli_w.dumps(tables[0])}\n"
            f"# Defaults of this version:\n{tomli_w.dumps(tables[1])}"
        )


def _is_given(value: Any) -> bool:
    """Return whether Click's parser found a value: it has a mark for arguments that are not given."""
    return isinstance(value, bool) or (isinstance(value, str | tuple | list) and len(value) > 0)


def _stored(parameter: Parameter, value: Any, folder: Path) -> Any:
    """Return the value of a parameter for a settings file in a folder."""
    if isinstance(value, list | tuple):
        return [_stored(parameter, item, folder) for item in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, str | Path) and parameter.is_path(str(value)):
        return Path(os.path.relpath(Path(value).resolve(), folder)).as_posix()
    return value
