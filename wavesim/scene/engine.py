"""What every way of carrying a field through a lens has in common.

An engine is a linear operator between an object grid in front of the lens and an exit grid behind it. Its
`adjoint` is that of the inner product <f, g> = cell * sum(conj(f) g): with ideal coatings nearly the inverse,
where the aperture takes in what the object sends out.
"""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.scene.light import Light
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complexfloating]

Way = Literal["forward", "adjoint"]

SAFETY = 2.0
"""Makes 19 of 20 estimates upper bounds; measured by `python -m benchmarks.chooser`."""


@dataclass(frozen=True)
class Cost:
    """What an engine will take, told before it runs.

    Attributes
    ----------
    seconds : float
        For one `forward` or `adjoint` on this machine, after set-up.
    setup_seconds : float
        Once for each engine.
    peak_bytes : int
        Most memory at one time, set-up included, arguments and result not; for values in double precision.
    single_bytes : int, optional
        The same for values in single precision, if these take less.
    """

    seconds: float
    setup_seconds: float
    peak_bytes: int
    single_bytes: int | None = None

    @property
    def peak_bytes_in_single(self) -> int:
        """Most memory at one time where values are of complex64."""
        return self.peak_bytes if self.single_bytes is None else self.single_bytes


@dataclass(frozen=True)
class ErrorTerm:
    """Something that an engine leaves out, and how much that may matter.

    Attributes
    ----------
    what : str
        In a few words.
    relative_error : float
        Estimate of the exit field's relative L2 error from it, for an object that fills its grid evenly and
        sends light in all directions; NaN where it is not known.
    at_rim : bool
        Whether it goes with the amplitude at the aperture's rim.
    """

    what: str
    relative_error: float
    at_rim: bool = False


def upper_bound(parts: Iterable[ErrorTerm]) -> float:
    """Of the exit field's relative L2 error, from all that is neglected; infinite where it is not known.

    Parts are taken as independent, so that squares add, and taken `SAFETY` times over, since estimates
    scatter. Fields of equal energy differ by no more than twice their size.
    """
    error = SAFETY * math.sqrt(sum(part.relative_error**2 for part in parts))
    return min(error, 2.0) if math.isfinite(error) else math.inf


class Grids(Protocol):
    """Between which grids light is carried."""

    @property
    def object_grid(self) -> Grid: ...

    @property
    def exit_grid(self) -> Grid: ...


class Operator(Protocol):
    """What a reconstruction asks of an engine: grids, the way there, and its adjoint."""

    @property
    def scene(self) -> Grids: ...

    def forward(self, field: Field) -> Field: ...

    def adjoint(self, field: Field) -> Field: ...


class Engine(ABC):
    """A linear operator from fields on the object grid to fields on the exit grid.

    Parameters
    ----------
    scene : Scene
        What is carried where.
    """

    name: ClassVar[str]

    gain: ClassVar[float] = math.inf
    """Of the error of the candidate before, what the next may have at most for further ones to be tried."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        """Settings worth trying where a relative error of the exit field is allowed, the cheapest first."""
        yield {}

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        """Settings over a range, by what they make of the engine: its curves in a comparison on a scene."""
        return {cls.name.replace("-", " "): [{}]}

    @abstractmethod
    def _forward(self, values: Any) -> Any:
        """Values on the exit grid."""

    @abstractmethod
    def _adjoint(self, values: Any) -> Any:
        """Values on the object grid."""

    @abstractmethod
    def cost(self) -> Cost:
        """What it will take; does no work of the size of the scene."""

    @abstractmethod
    def neglected(self) -> tuple[ErrorTerm, ...]:
        """What is left out, the worst first."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """The settings in use, as plain values."""

    def key(self) -> str:
        """A digest of engine, scene and settings: equal for equal operators, in other processes too."""
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # figures in full, to the last digit
            told = f"{self.name} {self.scene.lens.model_dump_json()} {self.scene!r} {self.settings()!r}"
        return sha256(told.encode()).hexdigest()

    def edge_illumination(self, light: Light) -> float:
        """Amplitude of light at the aperture's rim, over that of light which fills the aperture evenly.

        Of engines that err at the rim; 1 for others.
        """
        return 1.0

    def neglected_of(self, light: Light | None = None) -> tuple[ErrorTerm, ...]:
        """What is left out of the light of one object, the worst first; left out, of all directions alike.

        Raises
        ------
        InputError
            If the light is not that of the scene.
        """
        parts = self.neglected()
        if light is None:
            return parts
        light.validate_same_scene(self.scene)
        share = self.edge_illumination(light) if any(part.at_rim for part in parts) else 1.0
        own = (replace(p, relative_error=share * p.relative_error) if p.at_rim else p for p in parts)
        return tuple(sorted(own, key=lambda part: -part.relative_error))

    def predicted_error(self, light: Light | None = None) -> float:
        """Upper bound of the exit field's relative L2 error; infinite where it is not known.

        Parameters
        ----------
        light
            Behind the object; left out, it fills its grid evenly and goes in all directions.

        Raises
        ------
        InputError
            As :meth:`neglected_of`.
        """
        return upper_bound(self.neglected_of(light))

    def forward(self, field: Field) -> Field:
        """Carry a field from the object grid to the exit grid.

        Raises
        ------
        InputError
            If the field does not lie on the object grid, has another wavelength, or is not finite.
        SamplingError
            If the grids cannot hold the field on its way.
        """
        self._refuse_stranger(field, self.scene.object_grid, "object")
        behind = float(self.scene.system.index[0, -1])
        return Field(self.scene.exit_grid, self._forward(field.values), field.wavelength_um, behind)

    def adjoint(self, field: Field) -> Field:
        """Carry a field back from the exit grid to the object grid.

        Raises
        ------
        InputError, SamplingError
            As :meth:`forward`.
        """
        self._refuse_stranger(field, self.scene.exit_grid, "exit")
        before = float(self.scene.system.index[0, 0])
        return Field(self.scene.object_grid, self._adjoint(field.values), field.wavelength_um, before)

    def _refuse_stranger(self, field: Field, grid: Grid, which: str) -> None:
        if field.grid != grid:
            raise InputError(f"the field's grid {field.grid} is not the scene's {which} grid {grid}")
        if field.wavelength_um != self.scene.wavelength_um:
            raise InputError(
                f"the field's wavelength of {field.wavelength_um:g} um is not the scene's "
                f"{self.scene.wavelength_um:g} um"
            )
        if not math.isfinite(abs(complex(field.values.sum()))):
            raise InputError("the field holds values that are not finite")


class Tiled(Engine):
    """An engine that does its work in parts of the object, on any plane alike.

    Parts can be kept, and told of as they are done.

    Attributes
    ----------
    report : callable or None
        Told after every part how many are done and how many there are, as (done, all).
    """

    report: Callable[[int, int], None] | None = None

    @property
    @abstractmethod
    def parts(self) -> int:
        """How many parts there are."""

    @property
    @abstractmethod
    def sums_bytes(self) -> int:
        """Of the fields of all parts on their own grids."""

    @abstractmethod
    def forward_in_bands(
        self, field: Field, rows: int, sums: MutableMapping[int, NDArray]
    ) -> Iterator[tuple[slice, NDArray[np.complex64]]]:
        """As :meth:`forward`, some rows of the exit grid at a time, so that it need not fit into memory.

        Parameters
        ----------
        field
            On the object grid.
        rows
            In a band.
        sums
            Where the fields of parts on their own grids are kept, by number; those that it holds are not
            computed again. A dict keeps them in memory,
            :class:`wavesim.engines.whole_field.tile_store.TileStore` in files.

        Yields
        ------
        rows : slice
            Of the exit grid.
        values : ndarray of complex64

        Raises
        ------
        InputError
            As :meth:`forward`.
        """

    @abstractmethod
    def adjoint_on(self, field: Field, numbers: Sequence[int]) -> Field:
        """As :meth:`adjoint`, on some parts of the object alone; 0 beside them.

        Parameters
        ----------
        field
            On the exit grid.
        numbers
            Of the parts.

        Raises
        ------
        InputError
            As :meth:`adjoint`.
        """
