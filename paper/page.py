"""The page, in the paper's order: what it says, what comes out here, the command, and why they differ."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError
from paper.element import BUDGETS, Element, Number
from paper.results import PAGE, PICTURES, Result, read_result

DOCS = Path(__file__).resolve().parents[1] / "docs"
DOCS_PICTURES = "images/paper"

HEAD = """# The paper, figure by figure

This page compares this toolkit with *Computational diffraction-limited imaging with a non-imaging spatial
information transfer lens* (Chinese Laser Press, 2024). For every equation, table, figure and number it shows
our result and the command that gives it. The page is made by

    make paper

which is `python -m paper --quick -o paper_output`. It takes minutes, because it propagates waves only on
small twins of the lens. Without `--quick` it takes hours. Finished elements are kept, and an interrupted run
continues. `--only figure-2d` makes one element, and `--list` lists their names. Photographs (Figs. 1b and
2f) are not included.

If a number differs from the paper's, the remark states the reason.
"""

NO_BREAK = "\u00a0"
COMMAND = "python -m paper "
TABLE = "| | the paper | here | |\n| --- | --- | --- | --- |"


def write_pages(folder: Path, elements: Mapping[str, Element], docs: Path | None = None) -> Path:
    """Write the page of all results in a folder, and with `docs` the documentation's page and pictures.

    Raises
    ------
    InputError
        If there are no results; with `docs`, which stay as they are, if some lack or had too small a budget.
    """
    results = {key: found for key in elements if (found := read_result(folder, key)) is not None}
    _write(folder / PAGE, elements, results, PICTURES)
    if docs is not None:
        _refuse_less(folder, elements, results)
        for result in results.values():
            for picture in result.made.pictures:
                with atomic_path(docs / DOCS_PICTURES / picture.file) as temporary:
                    shutil.copyfile(folder / PICTURES / picture.file, temporary)
        _write(docs / PAGE, elements, results, DOCS_PICTURES)
    return folder / PAGE


def _refuse_less(folder: Path, elements: Mapping[str, Element], results: Mapping[str, Result]) -> None:
    """Refuse results that would take something from the documentation."""
    for key, element in elements.items():
        least = element.documented
        if key not in results or BUDGETS.index(results[key].budget) < BUDGETS.index(least):
            quick = "--quick " if least == "quick" else ""
            raise InputError(
                f"--docs: {folder} lacks {key} as it is documented: python -m paper {quick}--only {key}"
            )


def _write(path: Path, elements: Mapping[str, Element], results: Mapping[str, Result], pictures: str) -> None:
    if not results:
        raise InputError(f"{path.parent}: holds no results")
    shown = [key for key in elements if key in results]
    parts = [HEAD, *(section(elements[key], results[key], pictures) for key in shown)]
    parts.append(all_numbers((elements[key], results[key]) for key in shown))
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(parts), encoding="utf-8")


def section(element: Element, result: Result, pictures: str) -> str:
    """One element."""
    made = result.made
    lines = [f"## {element.title}", "", f"**The paper.** {element.statement}", ""]
    for picture in made.pictures:
        lines += [f"![{picture.caption}]({pictures}/{picture.file})", "", f"*{picture.caption}*", ""]
    if made.numbers:
        lines += [TABLE, *map(_row, made.numbers), ""]
    lines += [f"**Here.** {made.difference}{_settings(element, result)}", ""]
    quick = "--quick " if result.budget == "quick" else ""
    lines += [f"    {one.replace(COMMAND, COMMAND + quick)}" for one in made.commands]
    return "\n".join([*lines, ""])


def all_numbers(results: Iterable[tuple[Element, Result]]) -> str:
    """Every number that the paper states, in its order."""
    lines = [
        "## All numbers of the paper",
        "",
        "| | the paper | here | as in the paper | element |",
    ]
    lines.append("| --- | --- | --- | --- | --- |")
    for element, result in results:
        for number in result.made.numbers:
            if number.paper is not None:
                said = "yes" if number.agrees else "no"
                link = f"[{element.title.partition(':')[0]}](#{_anchor(element.title)})"
                lines.append(f"| {number.name} | {_paper(number)} | {_here(number)} | {said} | {link} |")
    return "\n".join([*lines, ""])


def _anchor(title: str) -> str:
    """Return the anchor of a heading, as code hosts and the documentation's site give it."""
    return re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-")


def _row(number: Number) -> str:
    return f"| {number.name} | {_paper(number)} | {_here(number)} | {number.remark} |"


def _paper(number: Number) -> str:
    if number.paper is None:
        return ""
    relation = {"=": "", "<=": "≤ ", ">=": "≥ "}[number.relation]
    return relation + _value(number.paper, number.unit, 8)


def _here(number: Number) -> str:
    return _value(number.here, number.unit, number.digits)


def _value(value: float | str, unit: str, digits: int) -> str:
    if isinstance(value, str):
        return value
    text = f"{value + 0.0:.{digits}g}"  # not -0
    if "e" in text:
        shown, power = text.split("e")
        text = f"{shown}e{int(power)}"
    return f"{text}{'' if unit in ('', '°') else NO_BREAK}{unit}"


def _settings(element: Element, result: Result) -> str:
    """With which settings it was made, where budgets differ."""
    own = element.settings.get(result.budget)
    if not own:
        return ""
    said = "; ".join(f"{name.replace('_', ' ')} {_setting(value)}" for name, value in own.items())
    return f" ({result.budget.capitalize()} budget: {said}.)"


def _setting(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_setting, value)) or "none"
    if isinstance(value, float) and len(f"{value:g}") > 5 and (1.0 / value).is_integer():
        return f"1/{1.0 / value:.0f}"
    return f"{value:,}" if isinstance(value, int) else f"{value}"
