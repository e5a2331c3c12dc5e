"""What every way of carrying a field through a lens has in common.

An engine is a linear operator between an object grid in front of the lens and an exit grid behind it. Its
`adjoint` is that of the inner product <f, g> = cell * sum(conj(f) g): with ideal coatings nearly the inverse,
where the aperture takes in what the object sends out.
"""

from __future__ import annotations

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.tracing.compiled import CompiledSystem, compile_system
from wavesim.fields.field import Field, Grid

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complexfloating]
Coating = Literal["ideal", "bare"]

SAFETY = 2.0
"""Makes 19 of 20 estimates upper bounds; measured by `python -m benchmarks.chooser`."""


@dataclass(frozen=True)
class Scene:
    """A lens, and the two grids between which a field is carried.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    object_grid, exit_grid : Grid
        In front of the lens and behind it; both lines, or both planes.
    wavelength_um : float
        Vacuum wavelength.
    pose, surface_perturbations
        As in :func:`lensdesign.trace`: one displaced or perturbed lens. The grids stay where they are.
    coating : {"ideal", "bare"}
        Whether surfaces transmit everything, or what Fresnel's formulas leave (TE on a line; the mean of
        both polarizations on a plane).

    Raises
    ------
    InputError
        If the grids do not fit each other, or the lens.
    """

    lens: Lens
    object_grid: Grid
    exit_grid: Grid
    wavelength_um: float
    pose: Pose = Pose()
    surface_perturbations: Mapping[int, SurfacePerturbation] = field(default_factory=dict)
    coating: Coating = "ideal"

    def __post_init__(self) -> None:
        if self.object_grid.is_line != self.exit_grid.is_line:
            raise InputError("object grid and exit grid: both must be lines, or both planes")
        if self.object_grid.z_mm >= 0.0:
            raise InputError(
                f"object grid at z = {self.object_grid.z_mm:g} mm: must lie in front of the front vertex, "
                "z < 0"
            )
        exit_vertex = self.lens.exit_vertex_z_mm
        if self.exit_grid.z_mm < exit_vertex:
            raise InputError(
                f"exit grid at z = {self.exit_grid.z_mm:g} mm: must not lie in front of the exit vertex, "
                f"z >= {exit_vertex:g} mm"
            )
        if self.coating not in ("ideal", "bare"):
            raise InputError(f"coating = {self.coating!r}: allowed: ideal, bare")
        if self.system.trials is not None:
            raise InputError("a scene is that of one lens: the perturbations hold many trials")

    @cached_property
    def system(self) -> CompiledSystem:
        """The lens as arrays, in place."""
        return compile_system(self.lens, self.wavelength_um, self.pose, self.surface_perturbations)

    @property
    def wavenumber_per_mm(self) -> float:
        """2 pi over the vacuum wavelength."""
        return 2e3 * np.pi / self.wavelength_um


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
        Most memory at one time, set-up included, arguments and result not.
    """

    seconds: float
    setup_seconds: float
    peak_bytes: int


@dataclass(frozen=True)
class Neglected:
    """Something that an engine leaves out, and how much that may matter.

    Attributes
    ----------
    what : str
        In a few words.
    relative_error : float
        Estimate of the exit field's relative L2 error from it; NaN where it is not known.
    """

    what: str
    relative_error: float


class Engine(ABC):
    """A linear operator from fields on the object grid to fields on the exit grid.

    Parameters
    ----------
    scene : Scene
        What is carried where.
    """

    name: ClassVar[str]

    any_plane: ClassVar[bool] = False
    """Whether the way to another plane costs what the first did, with no free space to be carried through."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

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
    def neglected(self) -> tuple[Neglected, ...]:
        """What is left out, the worst first."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """The settings in use, as plain values."""

    def key(self) -> str:
        """A digest of engine, scene and settings: equal for equal operators, in other processes too."""
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # figures in full, to the last digit
            told = f"{self.name} {self.scene!r} {self.settings()!r}"
        return sha256(told.encode()).hexdigest()

    def predicted_error(self) -> float:
        """Upper bound of the exit field's relative L2 error; infinite where it is not known.

        What is neglected is taken as independent, so that squares add, and taken `SAFETY` times over, since
        estimates scatter. Fields of equal energy differ by no more than twice their size.
        """
        error = SAFETY * math.sqrt(sum(part.relative_error**2 for part in self.neglected()))
        return min(error, 2.0) if math.isfinite(error) else math.inf

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
