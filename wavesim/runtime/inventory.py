"""Inventory of a run's arrays, from which its memory and its allocations follow."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from enum import Flag
from functools import reduce
from typing import Literal

import numpy as np
from numpy.typing import DTypeLike

from wavesim.runtime.memory import MemoryNeed


@dataclass(frozen=True)
class ArrayGroup:
    """Arrays of one kind.

    Attributes
    ----------
    name : str
        Name of each array, in messages.
    shape : tuple of int
        Shape of each array.
    dtype : numpy dtype
        Data type of each array.
    during : enum.Flag
        Phases of the run in which the arrays exist.
    count : int
        Number of arrays that exist at a time.
    lies : str
        Location: "memory"; "scratch" for memory or, where it is short, a file
        (:class:`wavesim.runtime.scratch.Scratch`); or "file".
    """

    name: str
    shape: tuple[int, ...]
    dtype: DTypeLike
    during: Flag
    count: int = 1
    lies: Literal["memory", "scratch", "file"] = "memory"

    @property
    def bytes_of_all(self) -> int:
        """Size of all `count` arrays in bytes."""
        return self.count * math.prod(self.shape) * np.dtype(self.dtype).itemsize


def work(name: str, count_bytes: float, during: Flag) -> ArrayGroup:
    """Return an entry for working memory whose total size is known or measured."""
    return ArrayGroup(name, (round(count_bytes),), np.uint8, during)


Inventory = tuple[ArrayGroup, ...]
"""All arrays of a run. Entries of one name, for several phases, have one shape and type."""


def need_during(arrays: Inventory, phase: Flag) -> MemoryNeed:
    """Return the memory that one phase needs."""
    memory, scratch, file = (
        sum(one.bytes_of_all for one in arrays if one.during & phase and one.lies == location)
        for location in ("memory", "scratch", "file")
    )
    return MemoryNeed(memory + scratch, memory, file)


def need_of(arrays: Inventory) -> MemoryNeed:
    """Return the largest need of all phases."""
    phases = {phase for one in arrays for phase in one.during}
    return reduce(operator.or_, (need_during(arrays, phase) for phase in phases), MemoryNeed(0, 0))


def named(arrays: Inventory, name: str) -> ArrayGroup:
    """Return the first entry of a name."""
    return next(one for one in arrays if one.name == name)
