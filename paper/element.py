"""One thing of the paper that is made here: an equation, a table or a figure, and its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lensdesign import Lens, load_design
from paper.style import write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DESIGNS = Path(__file__).resolve().parents[1] / "designs"
PAPER_DESIGN = "paper_singlet.toml"

Budget = Literal["small", "quick", "full"]
BUDGETS: tuple[Budget, ...] = ("small", "quick", "full")
"""What a run may take, from the tests' to hours; each gives all that those before it give, and more."""


@dataclass(frozen=True)
class Number:
    """A number as it comes out here, beside the paper's.

    Attributes
    ----------
    name, unit
        What it is, and in what.
    here
        As it was computed; text where it is none.
    paper
        As the paper states it; None where it states none.
    within
        How far the two may differ, in the unit: half of the paper's last digit, as a rule.
    relation
        What the paper says of it: equal, no more than, no less than.
    remark
        Why they differ, or what has to be known.
    digits
        That are shown.

    Raises
    ------
    ValueError
        If the two differ and no remark says why.
    """

    name: str
    here: float | str
    unit: str = ""
    paper: float | str | None = None
    within: float = 0.0
    relation: Literal["=", "<=", ">="] = "="
    remark: str = ""
    digits: int = 4

    def __post_init__(self) -> None:
        if self.agrees is False and not self.remark:
            raise ValueError(f"{self.name}: {self.here} is not the paper's {self.paper}: a remark says why")

    @property
    def agrees(self) -> bool | None:
        """Whether it is the paper's; None where there is nothing to compare with."""
        if self.paper is None:
            return None
        if isinstance(self.here, str) or isinstance(self.paper, str):
            return self.here == self.paper
        above = self.here - self.paper
        return (self.relation == "<=" or above >= -self.within) and (
            self.relation == ">=" or above <= self.within
        )


@dataclass(frozen=True)
class Picture:
    """A file among the pictures, and what it shows."""

    file: str
    caption: str


@dataclass(frozen=True)
class Made:
    """What an element came to.

    Attributes
    ----------
    numbers
        Beside the paper's.
    commands
        That give the same.
    difference
        In one or two sentences: what differs from the paper, and why.
    pictures
        In the order of the page.
    """

    numbers: tuple[Number, ...]
    commands: tuple[str, ...]
    difference: str
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True)
class Work:
    """What an element is made with.

    Attributes
    ----------
    key
        Of the element.
    settings
        Of its budget.
    pictures
        Folder for pictures.
    parts
        Folder for what it keeps while it is made, and for others that need it; there is one for each element.
    progress
        Progress callback, called with a text.
    """

    key: str
    settings: Mapping[str, Any]
    pictures: Path
    parts: Mapping[str, Path]
    progress: Callable[[str], None]

    @cached_property
    def lens(self) -> Lens:
        """The paper's lens."""
        return load_design(DESIGNS / PAPER_DESIGN)

    @property
    def folder(self) -> Path:
        """Its own folder for what it keeps; made if needed."""
        folder = self.parts[self.key]
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def picture(self, figure: Figure, caption: str, name: str = "") -> Picture:
        """Write a picture; `name` tells several of one element apart."""
        file = f"{self.key}{'-' if name else ''}{name}.png"
        write_picture(figure, self.pictures / file)
        return Picture(file, caption)


@dataclass(frozen=True)
class Element:
    """One thing of the paper.

    Attributes
    ----------
    key
        As ``--only`` names it, and its files.
    title
        On the page.
    statement
        What the paper says, in short.
    make
        Makes it.
    settings
        By budget; left out where all are alike.
    seconds
        What it takes about, by budget; for the estimate of the time left.
    needs
        Elements that are made before, and from whose parts it takes.
    designs
        Files of ``designs/`` that it reads.
    documented
        Budget of which the documentation tells, at the least.
    """

    key: str
    title: str
    statement: str
    make: Callable[[Work], Made]
    settings: Mapping[Budget, Mapping[str, Any]] = field(default_factory=dict)
    seconds: Mapping[Budget, float] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    designs: tuple[str, ...] = (PAPER_DESIGN,)
    documented: Budget = "quick"
