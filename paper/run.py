"""Makes elements, one after the other: what is finished is kept, and a run that was cut off goes on."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from lensdesign.common.console import message_console, progress_bar
from lensdesign.errors import InputError
from paper.element import Budget, Element, Work
from paper.results import PARTS, PICTURES, Result, inputs, kept, write_result
from paper.style import chart_style


def wanted(elements: Mapping[str, Element], only: Iterable[str]) -> list[Element]:
    """Those that are asked for, all if none is, and those that they need, in the paper's order.

    Raises
    ------
    InputError
        If one is unknown.
    """
    only = list(only)
    unknown = [key for key in only if key not in elements]
    if unknown:
        raise InputError(f"--only {unknown[0]}: unknown; there are {', '.join(elements)}")
    asked, found = only or list(elements), dict[str, Element]()
    while asked:
        key = asked.pop()
        found[key] = elements[key]
        asked += [other for other in elements[key].needs if other not in found]
    return _in_order(found, [key for key in elements if key in found])


def _in_order(found: Mapping[str, Element], keys: list[str]) -> list[Element]:
    """Each behind those that it needs, else as they stand."""
    ordered: dict[str, Element] = {}

    def put(key: str) -> None:
        for other in found[key].needs:
            put(other)
        ordered.setdefault(key, found[key])

    for key in keys:
        put(key)
    return list(ordered.values())


def make_all(
    elements: Mapping[str, Element],
    folder: Path,
    budget: Budget,
    only: Iterable[str] = (),
    fresh: bool = False,
) -> list[Result]:
    """Make what is asked for and not yet there.

    Parameters
    ----------
    elements
        All there are, by key, in the paper's order.
    folder
        Where results, pictures and what is kept on the way lie.
    budget
        What it may take.
    only
        Keys; none stands for all.
    fresh
        Whether to make anew what is finished.

    Returns
    -------
    list of Result
        Of those asked for and those that they need.
    """
    asked = wanted(elements, only)
    done = {} if fresh else {e.key: r for e in asked if (r := kept(folder, e, budget, elements)) is not None}
    console, total = message_console(), sum(_seconds(e, budget) for e in asked if e.key not in done)
    results = []
    with progress_bar() as bar:
        task = bar.add_task("", total=round(total))
        for element in asked:
            if element.key not in done:
                bar.update(task, description=element.key)

                def progress(text: str, key: str = element.key) -> None:
                    bar.update(task, description=f"{key}: {text}")

                done[element.key] = _made(element, folder, budget, elements, progress)
                bar.advance(task, round(_seconds(element, budget)))
                console.print(f"{element.key}: {done[element.key].seconds:.1f} s", highlight=False)
            results.append(done[element.key])
    return results


def _made(
    element: Element,
    folder: Path,
    budget: Budget,
    others: Mapping[str, Element],
    progress: Callable[[str], None],
) -> Result:
    from wavesim import SamplingWarning
    from wavesim.sensor.sensor import FootprintWarning

    parts = {key: folder / PARTS / key for key in (element.key, *element.needs)}
    settings = element.settings.get(budget, {})
    work = Work(element.key, settings, folder / PICTURES, parts, progress)
    started = time.monotonic()
    with chart_style(), warnings.catch_warnings():
        for kind in (SamplingWarning, FootprintWarning):
            warnings.simplefilter("ignore", kind)
        made = element.make(work)
    seconds = time.monotonic() - started
    result = Result(element.key, budget, inputs(element, budget, others), round(seconds, 1), made)
    write_result(folder, result)
    return result


def _seconds(element: Element, budget: Budget) -> float:
    return max(1.0, element.seconds.get(budget, 1.0))
