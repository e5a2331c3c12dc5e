"""Options of the commands that choose an engine and set it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from lensdesign.common.console import message_console
from lensdesign.errors import InputError

Slices = Annotated[int | None, typer.Option(help="slices: number of slices.")]
Compensation = Annotated[str | None, typer.Option(help="slices: vertical or oblique.")]
TileWidthMm = Annotated[float | None, typer.Option(help="eikonal, two-level: width of a tile of the object.")]
Spacing = Annotated[str | None, typer.Option(help="slices: equal, paper or equal-phase.")]
Interface = Annotated[str | None, typer.Option(help="wpm: substep or staircase.")]
StepUm = Annotated[float | None, typer.Option(help="wpm: step along z.")]
PitchUm = Annotated[float | None, typer.Option(help="slices, wpm, thin-lens: pitch of the working grid.")]


def engine_settings(**options: Any) -> dict[str, Any]:
    """Settings of an engine, in its own words, from the options that were given.

    Parameters
    ----------
    **options
        By the names of the options above; None where left out.

    Raises
    ------
    InputError
        If a number is not finite and greater than 0.
    """
    settings: dict[str, Any] = {}
    for name, value in options.items():
        if value is None:
            continue
        if isinstance(value, int | float) and not (math.isfinite(value) and value > 0):
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option} = {value:g}: must be finite and greater than 0")
        if name == "pitch_um":
            name, value = "pitch_mm", 1e-3 * value
        settings[name] = value
    return settings


def numbers(text: str, option: str, count: int | None = None) -> list[float]:
    """Numbers of an option, separated by commas.

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
        wanted = "numbers" if count is None else f"{count} numbers"
        raise InputError(f"{option} = {text!r}: must be {wanted}, separated by commas")
    return values


def settings_text(settings: dict[str, Any]) -> str:
    """Settings of an engine in one line."""
    return ", ".join(
        f"{name} = {value:.6g}" if isinstance(value, float) else f"{name} = {value}"
        for name, value in settings.items()
    )


def print_warnings(messages: Iterable[str]) -> None:
    """Tell on standard error what engines warned of."""
    for message in messages:
        message_console().print(f"warning: {message}", soft_wrap=True, markup=False, highlight=False)
