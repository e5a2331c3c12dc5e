"""The command: makes what is asked for into a folder, and the page from all that lies there."""

from __future__ import annotations

import argparse
from pathlib import Path

from lensdesign.common.console import fail
from lensdesign.common.interrupts import stoppable
from lensdesign.errors import TransferLensError
from paper.element import Budget
from paper.page import DOCS, write_pages
from paper.registry import ELEMENTS
from paper.run import make_all


def main(arguments: list[str] | None = None) -> None:
    """Run the command; exit with status 2 for bad input, 130 after an interrupt: what is finished is kept."""
    parser = argparse.ArgumentParser(
        prog="python -m paper", description="The paper's equations, tables, figures and numbers, on one page."
    )
    parser.add_argument("--quick", action="store_true", help="small twins of the lens: minutes, not hours")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("paper_output"), help="folder for all of it"
    )
    parser.add_argument("--only", nargs="+", default=[], metavar="ELEMENT", help="such as figure-2d")
    parser.add_argument("--fresh", action="store_true", help="make anew what is finished")
    parser.add_argument(
        "--docs", action="store_true", help="write the documentation's page and pictures, too"
    )
    parser.add_argument("--list", action="store_true", help="say what elements there are, and make nothing")
    asked = parser.parse_args(arguments)
    if asked.list:
        for key, element in ELEMENTS.items():
            print(f"{key:22} {element.title}")
        return
    with stoppable():
        try:
            budget: Budget = "quick" if asked.quick else "full"
            make_all(ELEMENTS, asked.output, budget, asked.only, asked.fresh)
            print(f"wrote {write_pages(asked.output, ELEMENTS, DOCS if asked.docs else None)}")
        except TransferLensError as error:
            fail(str(error))
        except KeyboardInterrupt:
            raise KeyboardInterrupt("interrupted; the same command goes on behind what is finished") from None


if __name__ == "__main__":
    main()
