"""A design as it is edited: tables and the lens they make, with what was undone and can be redone.

Every change gives a new value; a change that makes no lens raises, and the last good one stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError
from lensdesign.files.design import lens_of
from lensdesign.lens.lens import Lens

TablePath = tuple[str | int, ...]
"""Where a value stands in a design's tables: ("surface", 0, "radius_mm"); tables are counted from 0."""

Tables = dict[str, Any]

MAX_STEPS = 1000
"""That can be undone."""


@dataclass(frozen=True, eq=False)
class Step:
    """A design at one moment.

    Attributes
    ----------
    tables
        As of a design file; never changed in place.
    lens
        What they make.
    what
        What was done to come here, for the reader.
    """

    tables: Tables
    lens: Lens
    description: str


@dataclass(frozen=True, eq=False)
class Editing:
    """A design, what it was before, and what was undone.

    Attributes
    ----------
    path
        The design file; it need not exist.
    now
        The design as it is.
    before, after
        What undoing and redoing lead to, the nearest last and first.
    gesture
        Of the last change: those of one gesture, such as a drag, are undone together.
    """

    path: Path
    now: Step
    undo_steps: tuple[Step, ...] = ()
    redo_steps: tuple[Step, ...] = ()
    gesture: str = ""

    @property
    def lens(self) -> Lens:
        """The lens as it is."""
        return self.now.lens

    def changed(self, tables: Tables, description: str, gesture: str = "") -> Editing:
        """With other tables.

        Raises
        ------
        InputError
            If they make no lens; the message is that of the commands.
        """
        step = Step(tables, lens_from(tables, self.path), description)
        if gesture and gesture == self.gesture:
            return replace(self, now=step, redo_steps=())
        return replace(
            self,
            now=step,
            undo_steps=(*self.undo_steps, self.now)[-MAX_STEPS:],
            redo_steps=(),
            gesture=gesture,
        )

    def undone(self) -> Editing:
        """One step back; the same where there is none."""
        if not self.undo_steps:
            return self
        *rest, last = self.undo_steps
        return replace(
            self, now=last, undo_steps=tuple(rest), redo_steps=(self.now, *self.redo_steps), gesture=""
        )

    def redone(self) -> Editing:
        """One step forward again; the same where nothing was undone."""
        if not self.redo_steps:
            return self
        first, *rest = self.redo_steps
        return replace(
            self, now=first, undo_steps=(*self.undo_steps, self.now), redo_steps=tuple(rest), gesture=""
        )


def lens_from(tables: Tables, path: Path) -> Lens:
    """The lens that tables make, refused as the commands refuse a file that holds them."""
    return lens_of(deepcopy(tables), path)


def value_at(tables: Tables, table_path: TablePath) -> Any:
    """The value at a place, None where there is none."""
    found: Any = tables
    for key in table_path:
        try:
            found = found[key]
        except (KeyError, IndexError):
            return None
    return found


def with_value(tables: Tables, table_path: TablePath, value: Any) -> Tables:
    """Tables with another value at a place; None takes the key out."""
    changed = deepcopy(tables)
    *parents, last = table_path
    inner: Any = changed
    for key in parents:
        inner = inner.setdefault(key, {}) if isinstance(inner, dict) else inner[key]
    if value is None and isinstance(inner, dict):
        inner.pop(last, None)
    else:
        inner[last] = value
    return changed


def with_surface_after(tables: Tables, index: int) -> Tables:
    """Tables with a plane surface more behind one, counted from 0, in the middle of the space there."""
    changed = deepcopy(tables)
    surfaces = changed["surface"]
    own = surfaces[index]
    if index == len(surfaces) - 1:
        own["thickness_mm"] = 1.0
        surfaces.append({})
    else:
        half = 0.5 * own["thickness_mm"]
        own["thickness_mm"] = half
        added: Tables = {"thickness_mm": half}
        if "material" in own:
            added["material"] = own["material"]
        surfaces.insert(index + 1, added)
    return changed


def without_surface(tables: Tables, index: int) -> Tables:
    """Tables without one surface; its space is the next one's.

    Raises
    ------
    InputError
        If it is the only one, or the stop.
    """
    surfaces: Sequence[Tables] = tables["surface"]
    if len(surfaces) == 1:
        raise InputError("surface 1: the only surface stays; a lens has one at least")
    if surfaces[index].get("stop"):
        raise InputError(f"surface {index + 1}: is the stop; make another surface the stop first")
    changed = deepcopy(tables)
    changed["surface"].pop(index)
    if index == len(surfaces) - 1:
        changed["surface"][-1].pop("thickness_mm", None)
        changed["surface"][-1].pop("material", None)
    return changed


def with_stop(tables: Tables, index: int) -> Tables:
    """Tables whose stop, and its size where there is none, is on another surface."""
    changed = deepcopy(tables)
    sizes = [s.get("semi_diameter_mm") for s in changed["surface"] if s.get("stop")]
    for i, surface in enumerate(changed["surface"]):
        surface.pop("stop", None)
        if i == index:
            surface["stop"] = True
            surface.setdefault("semi_diameter_mm", (sizes or [None])[0])
    return changed
