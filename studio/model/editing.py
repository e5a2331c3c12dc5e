"""Editing of a design: its tables and lens, with undo and redo.

Every change returns a new value. A change that does not yield a valid lens raises an error; the last valid
design stays.
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
from lensdesign.lens.shapes.base import COEFFICIENTS
from lensdesign.lens.shapes.registry import SHAPES, shape_class

TablePath = tuple[str | int, ...]
"""Position of a value in a design's tables: ("surface", 0, "radius_mm"); indices start at 0."""

Tables = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Step:
    """A state of a design.

    Attributes
    ----------
    tables
        Tables of the design file; never changed in place.
    lens
        The lens of these tables.
    description
        Description of the change that led to this state.
    """

    tables: Tables
    lens: Lens
    description: str


@dataclass(frozen=True, eq=False)
class Editing:
    """A design with its undo and redo history.

    Attributes
    ----------
    path
        The design file; it need not exist.
    now
        Present state.
    undo_steps, redo_steps
        Earlier states, the most recent last; and undone states, the most recent first.
    gesture
        Identifier of the last gesture, such as a drag; its changes are undone together.
    """

    path: Path
    now: Step
    undo_steps: tuple[Step, ...] = ()
    redo_steps: tuple[Step, ...] = ()
    gesture: str = ""

    @property
    def lens(self) -> Lens:
        """Present lens."""
        return self.now.lens

    def changed(self, tables: Tables, description: str, gesture: str = "") -> Editing:
        """Return the editing with other tables.

        Raises
        ------
        InputError
            If the tables do not describe a valid lens.
        """
        step = Step(tables, lens_from(tables, self.path), description)
        if gesture and gesture == self.gesture:
            return replace(self, now=step, redo_steps=())
        # Largest number of steps that can be undone.
        max_steps = 1000
        return replace(
            self,
            now=step,
            undo_steps=(*self.undo_steps, self.now)[-max_steps:],
            redo_steps=(),
            gesture=gesture,
        )

    def undone(self) -> Editing:
        """Return the editing one step back; unchanged if there is none."""
        if not self.undo_steps:
            return self
        *rest, last = self.undo_steps
        return replace(
            self, now=last, undo_steps=tuple(rest), redo_steps=(self.now, *self.redo_steps), gesture=""
        )

    def redone(self) -> Editing:
        """Return the editing one undone step forward; unchanged if there is none."""
        if not self.redo_steps:
            return self
        first, *rest = self.redo_steps
        return replace(
            self, now=first, undo_steps=(*self.undo_steps, self.now), redo_steps=tuple(rest), gesture=""
        )


def lens_from(tables: Tables, path: Path) -> Lens:
    """Return the lens of tables, with the validation of a design file."""
    return lens_of(deepcopy(tables), path)


def value_at(tables: Tables, table_path: TablePath) -> Any:
    """Return the value at a position of the tables; None if there is none."""
    found: Any = tables
    for key in table_path:
        try:
            found = found[key]
        except (KeyError, IndexError):
            return None
    return found


def with_value(tables: Tables, table_path: TablePath, value: Any) -> Tables:
    """Return tables with another value at a position; None removes the key."""
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
    """Return tables with an additional plane in the middle of the space behind a surface (index from 0)."""
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
    """Return tables without one surface and the space behind it.

    Raises
    ------
    InputError
        If the surface is the only one, or the stop.
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
    """Return tables with the stop on another surface, which inherits its size unless it has one."""
    changed = deepcopy(tables)
    sizes = [s.get("semi_diameter_mm") for s in changed["surface"] if s.get("stop")]
    for i, surface in enumerate(changed["surface"]):
        surface.pop("stop", None)
        if i == index:
            surface["stop"] = True
            surface.setdefault("semi_diameter_mm", (sizes or [None])[0])
    return changed


def with_shape(tables: Tables, index: int, shape: str) -> Tables:
    """Return tables with another shape of a surface, which keeps radius and conic.

    Parameters
    ----------
    tables
        Tables of a design.
    index
        Index of the surface, from 0.
    shape
        Name in :data:`lensdesign.lens.shapes.registry.SHAPES`.
    """
    changed = deepcopy(tables)
    surface = changed["surface"][index]
    before, keys = surface.get("shape"), set(shape_class(shape).KEYS)
    others = {key for one in SHAPES for key in shape_class(one).KEYS} - keys - {"radius_mm", "conic"}
    for key in ("shape", *others):
        surface.pop(key, None)
    if shape == "even asphere":
        surface["asphere"] = [0.0]
    elif "q_mm" in keys:
        surface["shape"] = shape
        scene = changed["object"]
        reach = scene["numerical_aperture"] * scene["working_distance_mm"]
        surface.setdefault("normalization_radius_mm", surface.get("semi_diameter_mm", reach))
        if before != shape:  # the polynomials differ
            surface["q_mm"] = [0.0]
        if "conic" not in keys:
            surface.pop("conic", None)
    elif shape == "odd asphere":
        surface |= {"shape": shape, "odd_asphere": [0.0]}
    elif shape != "conic":
        surface["shape"] = shape
        for key, across in (("radius_mm", "radius_x_mm"), ("conic", "conic_x")):
            if key in surface and across in keys and across not in surface:
                surface[across] = surface[key]
    return changed


def with_term(tables: Tables, index: int) -> Tables:
    """Return tables with a further aspheric term of 0 on a surface (index from 0)."""
    changed = deepcopy(tables)
    surface = changed["surface"][index]
    keys = shape_class(surface.get("shape", "even asphere")).KEYS
    key = next(key for key in COEFFICIENTS if key in keys)
    surface[key] = [*surface.get(key, []), 0.0]
    return changed
