"""Objects of several layers: light passes one layer after the other, with free space between them.

The field on a layer is multiplied by its transmission, and propagates to the next layer as the angular
spectrum of plane waves (multi-slice model). The field behind the last layer is propagated to the object
plane, forwards or backwards, because engines start there. Light that a layer reflects is neglected.

The field stop limits the light on every layer, so that no layer is lit outside it. Light that spreads beyond
the grid on its way is lost.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.targets.illumination import field_stop
from wavesim.targets.patch import Patch

Array = NDArray[np.inexact[Any]]

MOST_LOST_LIGHT = 0.01
"""Largest fraction of the light that may leave the grid between the layers and the object plane."""


class LayerFields(NamedTuple):
    """Fields of an object of layers.

    Attributes
    ----------
    behind : ndarray, shape (ny, nx)
        Field behind all layers, in the object plane.
    arriving : tuple of ndarray
        Field that arrives at each layer, limited by the field stop.
    """

    behind: Array
    arriving: tuple[Array, ...]


@dataclass(frozen=True, eq=False)
class LayerStack:
    """Positions of the layers of an object, and the light on the first one.

    Attributes
    ----------
    grid : Grid
        Samples of the object plane; those of all layers have the same coordinates.
    light : Field
        Illumination of the first layer, 0 outside the field stop.
    distances_um : tuple of float
        Distances of the layers from the object plane along the light, ascending; negative in front of it.
    stop : ndarray, shape (ny, nx)
        Fraction of each sample that the field stop transmits. It limits the light on the layers behind the
        first one.

    Raises
    ------
    InputError
        If the distances are not ascending, or the grid of the light is not that of the object plane.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Field, Grid
    >>> from wavesim.targets.layers import LayerStack
    >>> grid = Grid((64, 64), 4e-4, 0.0)
    >>> stop = np.where(grid.radius_squared_mm2() < 0.01**2, 1.0, 0.0)
    >>> stack = LayerStack(grid, Field(grid, stop + 0j, 0.532), (-20.0, 0.0), stop)
    >>> fields = stack.forward([np.ones(grid.shape), np.full(grid.shape, 0.5)])
    >>> len(fields.arriving), fields.behind.shape
    (2, (64, 64))
    """

    grid: Grid
    light: Field
    distances_um: tuple[float, ...]
    stop: NDArray[np.floating[Any]]

    def __post_init__(self) -> None:
        validate_distances(self.distances_um)
        if self.light.grid.shape != self.grid.shape or self.light.grid.pitch_mm != self.grid.pitch_mm:
            raise InputError(f"light: its grid {self.light.grid} is not the object's {self.grid}")

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Samples of a layer that the field stop does not cover."""
        return np.asarray(self.stop > 0.0)

    @cached_property
    def _propagators(self) -> tuple[FreeSpacePropagator | None, ...]:
        """Propagators from each layer to the next one, and from the last one to the object plane."""
        ends = [*(self.grid.at(self.grid.z_mm + 1e-3 * um) for um in self.distances_um), self.grid]
        return tuple(
            None if start.z_mm == end.z_mm else FreeSpacePropagator(start, end, self.light.wavelength_um)
            for start, end in pairwise(ends)
        )

    def forward(self, transmissions: Sequence[Array]) -> LayerFields:
        """Return the fields that arrive at the layers, and the field behind them in the object plane.

        Parameters
        ----------
        transmissions
            Transmission of each layer, shape (ny, nx), in the order in which light passes them.
        """
        field: Array = self.light.values
        arriving = list[Array]()
        for transmission, propagator in zip(transmissions, self._propagators, strict=True):
            if arriving:
                field = field * self.stop
            arriving.append(field)
            field = field * transmission
            if propagator is not None:
                field = propagator.forward(field)
        return LayerFields(field, tuple(arriving))

    def adjoint(self, change: Array, transmissions: Sequence[Array], fields: LayerFields) -> list[Array]:
        """Return the changes of the transmissions that belong to a change of the field in the object plane.

        They are the adjoint of the derivative of :meth:`forward`: a change of the transmission of a layer
        changes the field in proportion to the light that arrives at the layer.

        Parameters
        ----------
        change
            Change of the field behind the layers, in the object plane.
        transmissions
            Transmissions at which the derivative is taken.
        fields
            Result of :meth:`forward` for these transmissions.
        """
        changes = []
        stages = zip(transmissions, fields.arriving, self._propagators, strict=True)
        for transmission, arriving, propagator in reversed(list(stages)):
            if propagator is not None:
                change = propagator.adjoint(change)
            changes.append(np.conj(arriving) * change)
            change = self.stop * np.conj(transmission) * change
        return changes[::-1]

    def check_lost_light(self, transmissions: Sequence[Array]) -> None:
        """Check that the light behind the last layer stays within the grid.

        Warns
        -----
        SamplingWarning
            If more than the fraction `MOST_LOST_LIGHT` of it leaves the grid before the object plane.
        """
        fields = self.forward(transmissions)
        last = fields.arriving[-1] * transmissions[-1]
        sent, received = (float(np.vdot(field, field).real) for field in (last, fields.behind))
        lost = 1.0 - received / sent if sent > 0.0 else 0.0
        if lost > MOST_LOST_LIGHT:
            warnings.warn(
                f"layers_um: {100.0 * lost:.2g} % of the light behind the last layer leaves the patch before "
                "the object plane; use a larger patch_mm with the same field_stop_mm",
                SamplingWarning,
                stacklevel=3,
            )


def layer_stack(patch: Patch, light: Field, distances_um: Sequence[float]) -> LayerStack:
    """Return the layers of an object on a patch, within its field stop.

    Parameters
    ----------
    patch
        Samples of the object plane, and the field stop.
    light
        Illumination of the first layer on these samples.
    distances_um
        Distances of the layers from the object plane, ascending.

    Raises
    ------
    InputError
        If the distances are not ascending.
    """
    stop = field_stop(patch.grid, "disc", patch.field_stop_mm, at_mm=patch.field_stop_at_mm)
    return LayerStack(light.grid, light, tuple(distances_um), stop)


def validate_distances(distances_um: Sequence[float]) -> None:
    """Check that distances of layers are finite and ascending.

    Raises
    ------
    InputError
        If they are not.
    """
    steps = np.diff(np.asarray(distances_um, float))
    if not len(distances_um) or not np.all(np.isfinite(distances_um)) or np.any(steps <= 0.0):
        given = ", ".join(f"{one:g}" for one in distances_um)
        raise InputError(
            f"layers_um = {given}: must be finite and ascending, in the order in which light passes them"
        )
