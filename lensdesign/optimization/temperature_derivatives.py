"""The lens of a search at another temperature, with derivatives by the variables of the lens as designed.

All thermal changes follow from the lens as designed: terms of its shapes are multiplied by factors, and
spaces expand with their lengths and with the sags at the edges that the mount touches
(:mod:`lensdesign.lens.temperature`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.catalogues.thermal import REFERENCE_C
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.registry import class_with
from lensdesign.lens.surface import Surface
from lensdesign.lens.temperature import expansion_coefficients, heated_keys, heated_material
from lensdesign.optimization.operands.glass import edge_sag
from lensdesign.optimization.operands.operand import State
from lensdesign.raytrace.gradients import ChainRule, Variable


@dataclass(frozen=True)
class HeatedLens:
    """A lens at a temperature.

    Attributes
    ----------
    lens
        The lens, not validated.
    stop_semi_diameter_mm
        Semi-diameter of the expanded stop.
    chain_rule
        Derivatives of the variables of :attr:`TemperatureChange.own`, the stop and the sensor planes with
        respect to the variables of the search.
    """

    lens: Lens
    stop_semi_diameter_mm: float
    chain_rule: ChainRule


class TemperatureChange:
    """A temperature at which lenses of a search are evaluated.

    Parameters
    ----------
    base
        A lens with the glasses of the search.
    variables
        Variables of the search.
    temperature_c
        Temperature of lens, mount and air.
    mount_expansion_per_k
        Linear expansion coefficient of the mount.

    Raises
    ------
    MaterialError
        If the thermal data of a glass are not known.
    """

    def __init__(
        self, base: Lens, variables: tuple[Variable, ...], temperature_c: float, mount_expansion_per_k: float
    ) -> None:
        self.temperature_c, self.change_k = temperature_c, temperature_c - REFERENCE_C
        self.variables = variables
        self.coefficients = expansion_coefficients(base, mount_expansion_per_k)
        self.expansion_factors = 1.0 + self.change_k * self.coefficients.surfaces
        self.materials = [heated_material(base, i, temperature_c) for i in range(len(base.surfaces))]
        self.factors = np.array(
            [
                _scale_factor(base.surfaces[v.surface], v.kind, float(self.expansion_factors[v.surface]))
                if v.is_shape_term
                else float(v.kind == "log_field")
                for v in variables
            ]
        )
        spaces = (Variable("thickness", i) for i in range(len(base.surfaces) - 1))
        self.own = (*(v for v in variables if _is_kept(v)), Variable("working_distance"), *spaces)

    def with_glasses(self, base: Lens) -> Lens:
        """Return a lens with its glasses at the temperature and everything else unchanged."""
        surfaces = [
            s.model_copy(update={"material": m}) for s, m in zip(base.surfaces, self.materials, strict=True)
        ]
        return base.model_copy(update={"surfaces": tuple(surfaces)})

    def at(self, cold: State) -> HeatedLens:
        """Return the heated lens from the state of the lens as designed, with rays through the stop's rim."""
        lens, last = cold.lens, len(cold.lens.surfaces) - 1
        found = [edge_sag(cold, i) for i in range(last + 1)]
        sags, sags_by = np.array([value for value, _ in found]), np.array([by for _, by in found])
        thickness = np.array([s.thickness_mm or 0.0 for s in lens.surfaces[:last]])
        lengths = np.array([lens.object.working_distance_mm, *thickness])
        lengths_by = np.array([[float(_is_space(v, i - 1)) for v in cold.variables] for i in range(last + 1)])
        spaces = [self._expanded(i - 1, length, sags) for i, length in enumerate(lengths)]
        planes = self._expanded(last, np.array(lens.sensor.plane_distances_mm), sags)
        stop, trace = lens.stop_index, cold.traces[0]
        return HeatedLens(
            self._lens(lens, np.array(spaces), planes),
            float(self.expansion_factors[stop]) * trace.stop_semi_diameter_mm,
            ChainRule(
                self._jacobian(cold.variables, lengths_by, sags_by),
                self.expansion_factors[stop] * trace.stop_semi_diameter_by,
                self._expanded(last, np.zeros((len(planes), len(cold.variables))), sags_by[:, None]),
            ),
        )

    def _expanded(self, surface: int, length: Array, sags: Array) -> Array:
        """Return the expanded space behind a surface, or its derivatives."""
        return length + self.change_k * self.coefficients.of_space(surface, length, sags)

    def _jacobian(self, variables: tuple[Variable, ...], lengths_by: Array, sags_by: Array) -> Array:
        """Return the derivatives of the own variables by those of the search, shape (own, v)."""
        if not variables:
            return np.zeros((len(self.own), 0))
        shapes = np.diag(self.factors)[[_is_kept(v) for v in variables]]
        spaces = [self._expanded(i - 1, by, sags_by) for i, by in enumerate(lengths_by)]
        return np.vstack([shapes, *spaces])

    def _lens(self, cold: Lens, spaces: Array, planes: Array) -> Lens:
        thickness = [*spaces[1:].tolist(), None]
        surfaces = [
            surface.model_copy(
                update=heated_keys(surface, size - 1.0) | {"thickness_mm": t, "material": material}
            )
            for surface, size, t, material in zip(
                cold.surfaces, self.expansion_factors.tolist(), thickness, self.materials, strict=True
            )
        ]
        scene = cold.object.model_copy(update={"working_distance_mm": float(spaces[0])})
        sensor = cold.sensor.model_copy(update={"plane_distances_mm": tuple(planes.tolist())})
        return cold.model_copy(update={"surfaces": tuple(surfaces), "object": scene, "sensor": sensor})


def _is_kept(variable: Variable) -> bool:
    """Return whether a variable of the search is also one of the heated lens; spaces depend on others."""
    return variable.is_shape_term or variable.kind == "log_field"


def _is_space(variable: Variable, surface: int) -> bool:
    """Return whether a variable is the space behind a surface, or the working distance for -1."""
    if surface < 0:
        return variable.kind == "working_distance"
    return variable.kind == "thickness" and variable.surface == surface


def _scale_factor(surface: Surface, term: str, factor: float) -> float:
    """Return the factor of a term when all lengths are scaled by `factor`."""
    shape = class_with(term)
    keys = {key: getattr(surface, key) for key in shape.KEYS}
    keys |= shape.changed_keys(keys, term, 1.0)
    return shape.of_keys(shape.scaled_keys(keys, factor)).term(term)
