"""Arrays that a run holds, listed once: from the list follow what it takes, and what is allocated."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from enum import Flag
from functools import reduce
from typing import Literal

import numpy as np
from numpy.typing import DTypeLike

from wavesim.runtime.memory import Need


@dataclass(frozen=True)
class ArrayGroup:
    """Arrays of one kind.

    Attributes
    ----------
    name : str
        Of each, in messages.
    shape : tuple of int
        Of each.
    dtype : numpy dtype
        Of each.
    during : enum.Flag
        Phases of the run in which they are held.
    count : int
        How many are held at one time.
    lies : str
        In "memory"; where there is room, in memory or in a file ("scratch": :class:`wavesim.Scratch` gives
        them); or in a "file" in any case.
    """

    name: str
    shape: tuple[int, ...]
    dtype: DTypeLike
    during: Flag
    count: int = 1
    lies: Literal["memory", "scratch", "file"] = "memory"

    @property
    def bytes_of_all(self) -> int:
        """Of all `count` of them."""
        return self.count * math.prod(self.shape) * np.dtype(self.dtype).itemsize


def work(name: str, count_bytes: float, during: Flag) -> ArrayGroup:
    """Memory that something works in which is known, or was measured, as a whole."""
    return ArrayGroup(name, (round(count_bytes),), np.uint8, during)


Inventory = tuple[ArrayGroup, ...]
"""All arrays of a run. Lines of one name, for several phases, are of arrays of one shape and type."""


def need_during(arrays: Inventory, phase: Flag) -> Need:
    """What is held in one phase."""
    memory, scratch, file = (
        sum(one.bytes_of_all for one in arrays if one.during & phase and one.lies == place)
        for place in ("memory", "scratch", "file")
    )
    return Need(memory + scratch, memory, file)


def need_of(arrays: Inventory) -> Need:
    """The most that any phase takes."""
    phases = {phase for one in arrays for phase in one.during}
    return reduce(operator.or_, (need_during(arrays, phase) for phase in phases), Need(0, 0))


def named(arrays: Inventory, name: str) -> ArrayGroup:
    """The first line of a name."""
    return next(one for one in arrays if one.name == name)
