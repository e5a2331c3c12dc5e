"""What the verdict of a reconstruction says of wrong inputs, of perfect benches, and of what differs.

Frames of twins of the paper's lens are recorded, changed, written, read and reconstructed as the commands
do. A wrong input may end with exit status 0 only if its object is as good as without the error (correlation
within 0.01). A perfect bench must end with 0. With --frames the recorded frames stay in a folder, and the
next run reads them from there: remove it where the imaging has changed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from benchmarks.verdicts.cases import CASES, Case
from benchmarks.verdicts.judging import Judge, Result

HEAD = (
    "case",
    "made",
    "correlation",
    "right",
    "over noise",
    "held out",
    "status",
    "named",
    "seconds",
    "kept",
)


def chosen_cases(names: Sequence[str], groups: Sequence[str]) -> list[Case]:
    """Return the cases of some groups whose names contain one of some texts; all where none is given."""
    return [
        case
        for case in CASES
        if (not groups or case.group in groups) and (not names or any(name in case.name for name in names))
    ]


def table_row(result: Result) -> str:
    """Return a result as a row of a table."""
    figures = (result.correlation, result.right, result.over_noise, result.held_out_over_noise)
    cells = [result.name, result.made]
    cells += [
        "" if one is None else f"{one:.{digits}f}" for one, digits in zip(figures, (3, 3, 2, 2), strict=True)
    ]
    said = result.cause or ("" if result.status < 2 else result.message.strip().splitlines()[-1][:60])
    wrong_name = " (wrong)" if result.named is False else ""
    cells += [
        str(result.status),
        f"{said}{wrong_name}",
        f"{result.seconds:.1f}",
        "yes" if result.kept else "NO",
    ]
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"


def table_head() -> str:
    """Return the two rows above the results."""
    return f"| {' | '.join(HEAD)} |\n| {' | '.join('---' for _ in HEAD)} |"


def summary(results: Sequence[Result]) -> list[str]:
    """Return what the results come to, group by group."""
    lines = []
    rules = {
        "wrong": "end with 0 without the right object",
        "perfect": "do not end with 0",
        "cause": "end with 0 without the right object",
    }
    for group, rule in rules.items():
        own = [one for one in results if one.group == group]
        if not own:
            continue
        broken = [one.name for one in own if not one.kept]
        lines.append(
            f"{group}: {len(broken)} of {len(own)} {rule}{': ' if broken else ''}{'; '.join(broken)}"
        )
        asked = [one for one in own if one.named is not None]
        if asked:
            lines.append(
                f"{group}: cause named right: {sum(bool(one.named) for one in asked)} of {len(asked)}"
            )
    return lines


def main(arguments: Sequence[str] | None = None) -> list[Result]:
    """Run cases, print them as a table, and return their results."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.verdicts", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="part of a case's name; all cases if left out"
    )
    parser.add_argument("--group", action="append", choices=("wrong", "perfect", "cause"), default=[])
    parser.add_argument("--frames", type=Path, help="folder that keeps recorded frames for the next run")
    parser.add_argument("--json", type=Path, help="file to which the results are written, too")
    parser.add_argument("--verdict", choices=("full", "quick"), default="full", help="verdict that is tried")
    parser.add_argument("--list", action="store_true", help="print names alone")
    given = parser.parse_args(arguments)
    cases = chosen_cases(given.names, given.group)
    if not cases:
        parser.error("no case has such a name: see --list")
    if given.list:
        print("\n".join(f"{case.group}: {case.name}" for case in cases))
        return []
    results, begun = [], perf_counter()
    with ExitStack() as stack:
        folder = given.frames or Path(stack.enter_context(TemporaryDirectory()))
        judge = Judge(folder, given.verdict)
        print(table_head(), flush=True)
        for case in cases:
            results.append(judge.result(case))
            print(table_row(results[-1]), flush=True)
            if given.json is not None:
                given.json.write_text(json.dumps([one.as_dict() for one in results], indent=1))
    print()
    print("\n".join(summary(results)))
    print(f"{perf_counter() - begun:.0f} s")
    return results


if __name__ == "__main__":
    main()
