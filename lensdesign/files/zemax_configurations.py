"""Configurations of Zemax files (.zmx): the text of a file with the values of one of them.

``MNUM`` states the number of configurations, and the one whose values the surfaces hold. Rows behind it have
an operand, the surface (or field, wavelength, ...), the configuration and the value, such as
``THIC 2 3 10.5``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lensdesign.errors import InputError
from lensdesign.files.draft import quoted

SOLVES = ("MAZH", "CHZH", "PZUP", "PKUP", "EDGE", "PPAR", "MRAY", "PRAM")
"""Solves and pickups of a surface. The file also holds their values for the configuration in the surfaces."""

RECORDS = {"THIC": "DISZ", "CRVT": "CURV", "CONN": "CONI"}
"""Record of a surface that an operand sets: its distance, curvature or conic constant."""


@dataclass(frozen=True)
class ConfiguredText:
    """Text of a file with the values of one configuration.

    Attributes
    ----------
    lines : tuple of str
        Lines of the file; it has one configuration.
    losses, remarks : tuple of str
        Values of the configuration that are not applied, and what was chosen.
    """

    lines: tuple[str, ...]
    losses: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def text_of_configuration(lines: Sequence[str], number: int, source: str) -> ConfiguredText:
    """Return the text of a file with the values of one of its configurations.

    Parameters
    ----------
    lines
        Lines of the file.
    number
        Number of the configuration, from 1.
    source
        Name of the file, for messages.

    Raises
    ------
    InputError
        If the file has no such configuration, or changes a surface that it does not have.
    """
    start, count, active = _configurations(lines, source)
    if not 1 <= number <= count:
        raise InputError(f"{source}: configuration {number}: the file has {count}; allowed: {_range(count)}")
    values = _values(lines[start:], count)
    changed = list(lines)
    losses: list[str] = []
    operands: list[str] = []
    is_applied = False
    for (operand, item), of_configuration in values.items():
        if len(set(of_configuration.values())) > 1:
            operands.append(f"{operand} {item}")
        held, wanted = of_configuration.get(active), of_configuration.get(number)
        if wanted is None or wanted == held:
            continue
        if operand in RECORDS:
            is_applied = True
            _set_record(
                changed, item, RECORDS[operand], wanted, f"{source}: configuration {number}, {operand}"
            )
        else:
            read = f"that of configuration {active} is read"
            losses.append(f"configuration {number}: {operand} {item} of {quoted(wanted)}; {read}")
    if is_applied:
        losses += _solved(lines[:start], active)
    if (index := _line_of(changed, "MNUM")) is not None:
        changed[index] = "MNUM 1 1"
    others = f"; they differ in {', '.join(operands)}" if operands else ""
    remarks = (f"configuration {number} of {count} is read{others}",) if count > 1 else ()
    return ConfiguredText(tuple(changed), tuple(losses), remarks)


def _configurations(lines: Sequence[str], source: str) -> tuple[int, int, int]:
    """Return the line behind MNUM, the number of configurations, and the one that the surfaces hold."""
    index = _line_of(lines, "MNUM")
    if index is None:
        return len(lines), 1, 1
    values = lines[index].split()[1:3]
    if not all(value.isdecimal() for value in values) or not values:
        raise InputError(
            f"{source}, line {index + 1}: MNUM {quoted(' '.join(values))}: must be whole numbers"
        )
    return index + 1, int(values[0]), int(values[1]) if len(values) > 1 else 1


def _values(lines: Sequence[str], count: int) -> dict[tuple[str, int], dict[int, str]]:
    """Return the values by operand and item, then by configuration."""
    found: dict[tuple[str, int], dict[int, str]] = {}
    for line in lines:
        operand, *words = line.split() or [""]
        if len(words) < 3 or not (words[0].isdecimal() and words[1].isdecimal()):
            continue
        if 1 <= int(words[1]) <= count:
            # A parameter of a surface (PRAM) has its number behind the value and a status.
            name = f"{operand} {words[4]}" if operand == "PRAM" and len(words) > 4 else operand
            found.setdefault((name, int(words[0])), {})[int(words[1])] = words[2]
    return found


def _set_record(lines: list[str], surface: int, word: str, value: str, what: str) -> None:
    """Replace the value of a record of a surface, or add the record."""
    starts = [i for i, line in enumerate(lines) if line.split()[:2] == ["SURF", str(surface)]]
    if not starts:
        raise InputError(f"{what}: the file has no surface {surface}")
    for i in range(starts[0] + 1, len(lines)):
        words = lines[i].split()
        if words[:1] == ["SURF"] or words[:1] == ["MNUM"]:
            break
        if words[:1] == [word]:
            lines[i] = f"  {' '.join([word, value, *words[2:]])}"
            return
    lines.insert(starts[0] + 1, f"  {word} {value}")


def _solved(lines: Sequence[str], active: int) -> list[str]:
    """Return the values that solves and pickups gave another configuration, in words."""
    found, surface = [], ""
    for line in lines:
        word, *values = line.split() or [""]
        is_curvature_solve = word == "CURV" and len(values) > 1 and values[1] not in ("0", "1")
        if word == "SURF":
            surface = " ".join(values)
        elif surface and (word in SOLVES or is_curvature_solve):
            found.append(
                f"surface {surface}: {word} solve or pickup; its value of configuration {active} is read"
            )
    return found


def _line_of(lines: Sequence[str], word: str) -> int | None:
    return next((i for i, line in enumerate(lines) if line.split()[:1] == [word]), None)


def _range(count: int) -> str:
    return "1" if count == 1 else f"1 to {count}"
