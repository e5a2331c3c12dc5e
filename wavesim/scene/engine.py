"""Interface of all engines, which propagate a field through a lens.

An engine is a linear operator from an object grid in front of the lens to an exit grid behind it. Its
`adjoint` belongs to the inner product <f, g> = cell * sum(conj(f) g), where `cell` is the area of a sample.
With ideal coatings and an aperture that transmits all light of the object, the adjoint is nearly the inverse.
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

from lensdesign.common.text import finite_or_none
from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.scene.polarization import is_vector
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complexfloating]

Direction = Literal["forward", "adjoint"]

SAFETY = 2.0
"""Factor on the root sum square of the error terms. With it 19 of 20 predictions are upper bounds, as
`python -m benchmarks.chooser` measures."""


@dataclass(frozen=True)
class Cost:
    """Predicted time and memory of an engine.

    Attributes
    ----------
    seconds : float
        Time of one `forward` or `adjoint` on this machine, without the set-up.
    setup_seconds : float
        Time of the set-up, which each engine does once.
    peak_bytes : int
        Peak memory in double precision. It includes the set-up, but neither the argument nor the result.
    single_bytes : int, optional
        Peak memory in single precision. Default: the same as `peak_bytes`.
    """

    seconds: float
    setup_seconds: float
    peak_bytes: int
    single_bytes: int | None = None

    @property
    def peak_bytes_in_single(self) -> int:
        """Peak memory for values of complex64."""
        return self.peak_bytes if self.single_bytes is None else self.single_bytes


@dataclass(frozen=True)
class ErrorTerm:
    """Neglected effect of an engine, and the error that it causes.

    Attributes
    ----------
    description : str
        Name of the effect in a few words.
    relative_error : float
        Estimated relative L2 error of the exit field. The estimate assumes an object that fills its grid
        evenly and scatters light in all directions. It is NaN where no estimate exists.
    at_rim : bool
        Whether the error is proportional to the amplitude at the aperture's rim.
    """

    description: str
    relative_error: float
    at_rim: bool = False


def upper_bound(terms: Iterable[ErrorTerm]) -> float:
    """Return an upper bound of the exit field's relative L2 error; infinite where a term is unknown.

    The terms count as independent, so that their squares add. The factor `SAFETY` covers the scatter of the
    estimates. The bound never exceeds 2, since two fields of equal energy differ by twice their norm at most.
    """
    error = SAFETY * math.sqrt(sum(term.relative_error**2 for term in terms))
    return min(error, 2.0) if math.isfinite(error) else math.inf


class Grids(Protocol):
    """The two grids that an operator connects."""

    @property
    def object_grid(self) -> Grid: ...

    @property
    def exit_grid(self) -> Grid: ...


@dataclass(frozen=True)
class GridPair:
    """Object grid and exit grid of an operator that has no scene of its own."""

    object_grid: Grid
    exit_grid: Grid


class Operator(Protocol):
    """The part of an engine that a reconstruction uses: its grids, `forward` and `adjoint`."""

    @property
    def scene(self) -> Grids: ...

    def forward(self, field: Field) -> Field: ...

    def adjoint(self, field: Field) -> Field: ...


class Engine(ABC):
    """A linear operator from fields on the object grid to fields on the exit grid.

    :func:`wavesim.engine_for` builds engines. All of them propagate forward and adjoint, and predict their
    error and their cost beforehand. The adjoint belongs to the inner product
    <f, g> = cell * sum(conj(f) g), where `cell` is the area of a sample.

    Parameters
    ----------
    scene : Scene
        Lens, grids and wavelength.

    Attributes
    ----------
    name : str
        Name of the engine in :func:`wavesim.engine_for`.
    scene : Scene
        The scene.

    Examples
    --------
    Light from a meridional line through the lens, and back by the adjoint:

    >>> import numpy as np
    >>> from lensdesign import load_design
    >>> from wavesim import Field, engine_for, patch_scene
    >>> scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.02, meridional=True)
    >>> engine = engine_for(scene, "eikonal")
    >>> light = Field(scene.object_grid, np.ones(scene.object_grid.shape), scene.wavelength_um)
    >>> behind = engine.forward(light)
    >>> round(behind.energy / light.energy, 2), round(engine.adjoint(behind).energy / light.energy, 2)
    (1.0, 1.0)
    >>> engine.predicted_error() < 0.05
    True
    """

    name: ClassVar[str]

    key_name: ClassVar[str] = ""
    """Name in keys of stored fields, if it differs, so that earlier results stay usable after a renaming."""

    gain: ClassVar[float] = math.inf
    """Largest ratio of the predicted errors of two successive candidates for which a third one is tried."""

    carries_polarization: ClassVar[bool] = False
    """Whether the engine carries the components of light with a polarization."""

    def __init__(self, scene: Scene) -> None:
        if is_vector(scene.polarization) and not self.carries_polarization:
            raise InputError(
                f"polarization = {scene.polarization!r}: engine {self.name} propagates scalar waves; use "
                "engine eikonal with hierarchical = False"
            )
        self.scene = scene

    @property
    def components(self) -> int:
        """Number of components of the field behind the lens, whose intensities add up; 1 for scalar waves."""
        return 1

    def component(self, index: int) -> Engine:
        """Return the engine of one component of the field behind the lens.

        Raises
        ------
        InputError
            If there is no such component.
        """
        if index != 0:
            raise InputError(f"component = {index}: scalar waves have one component, 0")
        return self

    def _validate_scalar(self) -> None:
        if is_vector(self.scene.polarization):
            raise InputError(
                f"polarization = {self.scene.polarization!r}: the field behind the lens has "
                f"{self.components} components; use forward_components, or component(index)"
            )

    def at_wavelength(self, wavelength_um: float) -> Engine:
        """Return the engine with the same settings for light of another wavelength.

        Parameters
        ----------
        wavelength_um
            Vacuum wavelength.
        """
        if wavelength_um == self.scene.wavelength_um:
            return self
        return type(self)(replace(self.scene, wavelength_um=wavelength_um), **self.settings())

    @classmethod
    def implementations(cls) -> tuple[type[Engine], ...]:
        """Return the classes whose candidates compete with each other in the choice of an engine."""
        return (cls,)

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        """Yield the settings that are worth trying for an allowed relative L2 error, the cheapest first."""
        yield {}

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        """Return settings over a range of cost, by the label of their curve in a comparison of engines."""
        return {cls.name.replace("-", " "): [{}]}

    @abstractmethod
    def _forward(self, values: Any) -> Any:
        """Return the values on the exit grid."""

    @abstractmethod
    def _adjoint(self, values: Any) -> Any:
        """Return the values on the object grid."""

    @abstractmethod
    def cost(self) -> Cost:
        """Predict time and memory, without work that grows with the size of the scene."""

    @abstractmethod
    def error_terms(self) -> tuple[ErrorTerm, ...]:
        """Return the neglected effects, the largest error first."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Return the settings in use as plain values."""

    def key(self) -> str:
        """Return a digest of engine, scene and settings. Equal operators have equal keys in all processes."""
        with np.printoptions(threshold=sys.maxsize, floatmode="unique"):  # arrays in full, to the last digit
            name = self.key_name or self.name
            text = f"{name} {self.scene.lens.model_dump_json()} {self.scene.key_text()} {self.settings()!r}"
        return sha256(text.encode()).hexdigest()

    def edge_illumination(self, light: Light) -> float:
        """Return the amplitude at the aperture's rim over that of light which fills the aperture evenly.

        Engines without an error at the rim return 1.

        Parameters
        ----------
        light
            Light behind the object.
        """
        return 1.0

    def error_terms_of(self, light: Light | None = None) -> tuple[ErrorTerm, ...]:
        """Return the neglected effects for the light of one object, the largest error first.

        Parameters
        ----------
        light
            Light behind the object. Default: light that fills the object grid evenly, in all directions.

        Raises
        ------
        InputError
            If the light has another grid or wavelength than the scene.
        """
        terms = self.error_terms()
        if light is None:
            return terms
        light.validate_same_scene(self.scene)
        at_edge = self.edge_illumination(light) if any(term.at_rim for term in terms) else 1.0
        own = (replace(t, relative_error=at_edge * t.relative_error) if t.at_rim else t for t in terms)
        return tuple(sorted(own, key=lambda term: -term.relative_error))

    def predicted_error(self, light: Light | None = None) -> float:
        """Return an upper bound of the exit field's relative L2 error; infinite where a term is unknown.

        The bound is :func:`upper_bound` of the error terms.

        Parameters
        ----------
        light
            Light behind the object. Default: light that fills the object grid evenly, in all directions.

        Raises
        ------
        InputError
            If the light has another grid or wavelength than the scene.
        """
        return upper_bound(self.error_terms_of(light))

    def forward(self, field: Field) -> Field:
        """Propagate a field from the object grid to the exit grid.

        Parameters
        ----------
        field
            Complex amplitude behind the object, on the scene's object grid.

        Returns
        -------
        Field
            Complex amplitude on the scene's exit grid.

        Raises
        ------
        InputError
            If the field has another grid or wavelength than the scene, or values that are not finite.
        SamplingError
            If the engine's internal grids cannot sample the field.
        """
        self._validate_field(field, self.scene.object_grid, "object")
        index = float(self.scene.system.index[0, -1])
        return Field(self.scene.exit_grid, self._forward(field.values), field.wavelength_um, index)

    def forward_components(self, field: Field) -> tuple[Field, ...]:
        """Propagate a field from the object grid, and return all components on the exit grid.

        For scalar waves it is the field of :meth:`forward`; see there for parameters and errors.
        """
        self._validate_field(field, self.scene.object_grid, "object")
        index = float(self.scene.system.index[0, -1])
        components = range(self.components) if is_vector(self.scene.polarization) else (None,)
        found = self._forward_components(field.values, components)
        return tuple(Field(self.scene.exit_grid, values, field.wavelength_um, index) for values in found)

    def adjoint_components(self, fields: Sequence[Field]) -> Field:
        """Apply the adjoint of :meth:`forward_components` to one field on the exit grid for each component.

        Raises
        ------
        InputError
            If the number of fields differs from that of components; see also :meth:`adjoint`.
        """
        if len(fields) != self.components:
            raise InputError(f"{len(fields)} fields: must be {self.components}, one for each component")
        for field in fields:
            self._validate_field(field, self.scene.exit_grid, "exit")
        index = float(self.scene.system.index[0, 0])
        components = range(self.components) if is_vector(self.scene.polarization) else (None,)
        values = self._adjoint_components([field.values for field in fields], components)
        return Field(self.scene.object_grid, values, fields[0].wavelength_um, index)

    def _forward_components(self, values: Any, components: Sequence[int | None]) -> list[Any]:
        """Return the values of some components on the exit grid; None is the field of scalar waves."""
        return [self._forward(values)]

    def _adjoint_components(self, planes: Sequence[Any], components: Sequence[int | None]) -> Any:
        """Return the values on the object grid of the adjoint for some components."""
        return self._adjoint(planes[0])

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint operator to a field on the exit grid.

        Parameters
        ----------
        field
            Complex amplitude on the scene's exit grid.

        Returns
        -------
        Field
            Complex amplitude on the scene's object grid.

        Raises
        ------
        InputError
            If the field has another grid or wavelength than the scene, or values that are not finite.
        SamplingError
            If the engine's internal grids cannot sample the field.
        """
        self._validate_field(field, self.scene.exit_grid, "exit")
        index = float(self.scene.system.index[0, 0])
        return Field(self.scene.object_grid, self._adjoint(field.values), field.wavelength_um, index)

    def _validate_field(self, field: Field, grid: Grid, which: str) -> None:
        if field.grid != grid:
            raise InputError(f"the field's grid {field.grid} is not the scene's {which} grid {grid}")
        if field.wavelength_um != self.scene.wavelength_um:
            raise InputError(
                f"the field's wavelength of {field.wavelength_um:g} µm is not the scene's "
                f"{self.scene.wavelength_um:g} µm"
            )
        if not math.isfinite(abs(complex(field.values.sum()))):
            raise InputError("the field contains values that are not finite: remove NaN and infinities")


class Tiled(Engine):
    """An engine that processes the object in tiles and works on planes of any size.

    Its tiles can be stored, and it reports its progress.

    Attributes
    ----------
    progress : callable or None
        Progress callback after each tile: ``progress(completed, total)``.
    """

    progress: Callable[[int, int], None] | None = None

    @property
    @abstractmethod
    def parts(self) -> int:
        """Number of tiles."""

    @property
    @abstractmethod
    def sums_bytes(self) -> int:
        """Memory of the fields of all tiles on their own grids, in bytes."""

    @abstractmethod
    def forward_in_bands(
        self, field: Field, rows: int, sums: MutableMapping[int, NDArray]
    ) -> Iterator[tuple[slice, NDArray[np.complex64]]]:
        """Propagate a field as :meth:`forward` does, and yield the exit grid in bands of rows.

        The whole exit grid need not fit into memory.

        Parameters
        ----------
        field
            Field on the object grid.
        rows
            Number of rows in a band.
        sums
            Store of the tiles' fields on their own grids, by the index of the tile. Fields that it contains
            are not computed again. A dict keeps them in memory,
            :class:`wavesim.engines.eikonal.tile_store.TileStore` in files.

        Yields
        ------
        rows : slice
            Rows of the exit grid.
        values : ndarray of complex64
            Field on these rows.

        Raises
        ------
        InputError
            If the field has another grid or wavelength than the scene, or values that are not finite.
        """

    @abstractmethod
    def adjoint_on(self, field: Field, indices: Sequence[int]) -> Field:
        """Apply the adjoint for some tiles of the object only; the field is 0 outside them.

        Parameters
        ----------
        field
            Field on the exit grid.
        indices
            Indices of the tiles.

        Raises
        ------
        InputError
            If the field has another grid or wavelength than the scene, or values that are not finite.
        """


def engine_summary(engine: Engine, predicted_error: float) -> dict[str, Any]:
    """Return name, settings and predicted error of an engine for JSON."""
    return {
        "name": engine.name,
        "settings": engine.settings(),
        "predicted_error": finite_or_none(predicted_error),
    }
