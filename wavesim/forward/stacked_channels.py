"""Linear model of partially coherent light: the channels of a source as parts of one tall field.

The light of a wide or broadband source consists of modes whose intensities add up
(:mod:`wavesim.scene.source`). Their fields on the exit grid are stacked along y, so that an operator from the
object to all of them, and the measurement of all of them, have the interfaces of coherent light.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.engine import GridPair, Grids

ComplexArray = NDArray[np.complexfloating[Any, Any]]
RealArray = NDArray[np.floating[Any]]


class ChannelsOperator:
    """Operator from the light behind the object to the fields of all channels on the exit grid.

    Parameters
    ----------
    model
        Forward model with the modes of a source.
    """

    def __init__(self, model: ChannelModel) -> None:
        self.model = model
        scene = model.engine.scene
        rows, columns = scene.exit_grid.shape
        stacked = replace(scene.exit_grid, shape=(len(model.channels) * rows, columns))
        self.scene: Grids = GridPair(scene.object_grid, stacked)

    def forward(self, field: Field) -> Field:
        """Propagate the light of the middle of the source, changed to that of each channel, to the exit
        grid.
        """
        on_exit = [one.engine.forward(one.on(field)) for one in self.model.channels]
        values = np.concatenate([one.values for one in on_exit])
        return Field(self.scene.exit_grid, values, field.wavelength_um, on_exit[0].index)

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint of :meth:`forward`."""
        model, total = self.model, np.zeros(self.scene.object_grid.shape, field.values.dtype)
        exit_grid = model.engine.scene.exit_grid
        even = model.illumination.with_values(np.ones_like(model.illumination.values))
        for one, part in zip(model.channels, np.split(field.values, len(model.channels)), strict=True):
            on_exit = Field(exit_grid, part, one.wavelength_um, field.index)
            total += one.engine.adjoint(on_exit).values * one.on(even).values.conj()
        return Field(self.scene.object_grid, total, field.wavelength_um)


class ChannelsMeasurement:
    """Sums of the intensities of all channels on the pixels of all planes, and their first-order changes.

    Parameters
    ----------
    model
        Forward model with the modes of a source.
    measurements
        Measurement of each channel alone.
    """

    def __init__(self, model: ChannelModel, measurements: Sequence[Any]) -> None:
        self.weights = [mode.weight for mode in model.modes]
        self.measurements = measurements

    def intensities(self) -> list[RealArray]:
        """Return each pixel's mean intensity, plane by plane."""
        return self.weighted_intensities(self.weights)

    def weighted_intensities(self, weights: Sequence[float]) -> list[RealArray]:
        """Return the sum of the intensities of all channels with other weights, plane by plane."""
        return self._sum([one.intensities() for one in self.measurements], weights)

    def products(self, change: ComplexArray) -> list[RealArray]:
        """Return the products with a change of the stacked fields, plane by plane."""
        parts = np.split(change, len(self.measurements))
        return self._sum(
            [one.products(part) for one, part in zip(self.measurements, parts, strict=True)], self.weights
        )

    def products_of_channel(self, index: int, change: ComplexArray) -> list[RealArray]:
        """Return the part of :meth:`products` that is due to a change of the field of one channel."""
        weight = self.weights[index]
        return [part.dtype.type(weight) * part for part in self.measurements[index].products(change)]

    def adjoint(self, planes: list[RealArray]) -> ComplexArray:
        """Return the adjoint of :meth:`products`: a change of the stacked fields for factors of pixels."""
        return np.concatenate(
            [
                one.adjoint(planes) * planes[0].dtype.type(weight)
                for one, weight in zip(self.measurements, self.weights, strict=True)
            ]
        )

    def by_distance(self, plane: int) -> RealArray:
        """Return the products per mm of a plane's distance."""
        return self._sum_on_plane(lambda one: one.by_distance(plane))

    def by_shift(self, plane: int, axis: int) -> RealArray:
        """Return the products per um of a plane's shift along x (axis 0) or y (axis 1)."""
        return self._sum_on_plane(lambda one: one.by_shift(plane, axis))

    def by_tilt(self, axis: int) -> list[RealArray]:
        """Return the products per degree of the sensor's tilt about x (axis 0) or y (axis 1)."""
        return self._sum([one.by_tilt(axis) for one in self.measurements], self.weights)

    def by_blur(self) -> list[RealArray]:
        """Return the products per square um of the variance of the blur, plane by plane."""
        return self._sum([one.by_blur() for one in self.measurements], self.weights)

    def _sum_on_plane(self, of_channel: Callable[[Any], RealArray]) -> RealArray:
        return self._sum([[of_channel(one)] for one in self.measurements], self.weights)[0]

    @staticmethod
    def _sum(of_channels: Sequence[Sequence[RealArray]], weights: Sequence[float]) -> list[RealArray]:
        return [
            np.asarray(sum(part.dtype.type(w) * part for w, part in zip(weights, parts, strict=True)))
            for parts in zip(*of_channels, strict=True)
        ]
