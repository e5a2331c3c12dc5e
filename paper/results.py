"""Results on disk: one JSON for each element, by which a run knows what is finished."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from paper.element import BUDGETS, DESIGNS, Budget, Element, Made, Number, Picture

PICTURES, PARTS, PAGE = "pictures", "parts", "paper.md"

LOOKS = {"paper.element", "paper.style", "paper.drawing"}
"""Modules that no number depends on."""


@dataclass(frozen=True)
class Result:
    """What an element came to, and from what.

    Attributes
    ----------
    key
        Of the element.
    budget
        With which it was made.
    inputs
        Digest of all that it depends on.
    seconds
        That it took.
    made
        What came out.
    """

    key: str
    budget: Budget
    inputs: str
    seconds: float
    made: Made


def inputs(element: Element, budget: Budget, others: Mapping[str, Element]) -> str:
    """Digest of an element's settings, designs and modules, and of those that it needs."""
    parts = [
        json.dumps(element.settings.get(budget, {}), sort_keys=True),
        *(path.read_text(encoding="utf-8") for path in _modules(element)),
        *((DESIGNS / name).read_text(encoding="utf-8") for name in element.designs),
        *(inputs(others[key], budget, others) for key in element.needs),
    ]
    return sha256("\0".join(parts).encode()).hexdigest()


def _modules(element: Element) -> list[Path]:
    """The module that makes it, and those of ours from which that takes functions; looks do not count."""
    own = sys.modules[element.make.__module__]
    names = {own.__name__, *(getattr(value, "__module__", None) for value in vars(own).values())}
    ours = {name for name in names if name and name.startswith("paper.")} - LOOKS | {own.__name__}
    return [Path(path) for name in sorted(ours) if (path := sys.modules[name].__file__)]


def kept(folder: Path, element: Element, budget: Budget, others: Mapping[str, Element]) -> Result | None:
    """The result in a folder, unless inputs have changed, or a picture is gone; a larger budget's will do."""
    found = read_result(folder, element.key)
    if found is None:
        return None
    enough = BUDGETS[BUDGETS.index(budget) :]
    if found.inputs not in {inputs(element, one, others) for one in enough}:
        return None
    there = all((folder / PICTURES / picture.file).is_file() for picture in found.made.pictures)
    return found if there else None


def read_result(folder: Path, key: str) -> Result | None:
    """The result of an element; None if there is none.

    Raises
    ------
    InputError
        If the file is not one of ours.
    """
    path = folder / f"{key}.json"
    if not path.is_file():
        return None
    try:
        written = json.loads(path.read_text(encoding="utf-8"))
        made = written.pop("made")
        numbers = tuple(Number(**one) for one in made.pop("numbers"))
        pictures = tuple(Picture(**one) for one in made.pop("pictures"))
        return Result(**written, made=Made(numbers, tuple(made["commands"]), made["difference"], pictures))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: no result of this program ({error}); remove it") from None


def write_result(folder: Path, result: Result) -> None:
    """Keep a result, all of it or nothing."""
    text = json.dumps(asdict(result), indent=2, ensure_ascii=False, allow_nan=False)
    with atomic_path(folder / f"{result.key}.json") as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
