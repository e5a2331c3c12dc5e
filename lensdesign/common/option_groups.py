"""Titles under which the help of all commands lists their options."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any, TypeVar

_Command = TypeVar("_Command", bound=Callable[..., Any])


class OptionGroup(StrEnum):
    """Titles of groups of options, in the order in which the help lists them.

    An option of a command states its group as `rich_help_panel`. A settings model states the group of its
    fields as the class variable `option_group`. A field of another group states it in :func:`setting`.
    """

    INPUT = "Input"
    LENS = "Lens"
    OBJECT = "Object"
    ILLUMINATION = "Illumination"
    MOUNTED_LENS = "Lens as mounted"
    CAMERA = "Camera"
    CAMERA_ERRORS = "Camera errors"
    FRAMES = "Frames"
    FREE_SPACE = "Free space"
    TOLERANCES = "Tolerances"
    EVALUATION = "Evaluation"
    ENGINE = "Engine"
    SOLVER = "Solver"
    OUTPUT = "Output and running"


def most_used(*names: str) -> Callable[[_Command], _Command]:
    """Return a decorator that states which options of a command its short help shows.

    Parameters
    ----------
    *names
        Names of parameters of the command, or of fields of its settings models.
    """

    def mark(command: _Command) -> _Command:
        command.most_used = names  # type: ignore[attr-defined]
        return command

    return mark


def setting(
    default: Any,
    description: str,
    group: OptionGroup | None = None,
    *,
    metavar: str | None = None,
    options: Sequence[str] | None = None,
    **field: Any,
) -> Any:
    """Return the field of a settings model whose description is the help of an option.

    Parameters
    ----------
    default, description
        Default (`...`: that of the model), and help.
    group
        Title under which the help lists the option. Default: that of the class.
    metavar
        How the help shows the value. Default: by its type.
    options
        Names of the option, the present one first. Default: the name or alias of the field.
    **field
        Further arguments of :func:`pydantic.Field`, such as limits.
    """
    from pydantic import Field

    stated = {"group": group, "metavar": metavar, "options": options}
    extra: dict[str, Any] = {key: value for key, value in stated.items() if value is not None}
    return Field(default, description=description, json_schema_extra=extra or None, **field)
