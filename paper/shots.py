"""Frames that a camera takes of an object in front of a small twin, and what is found behind them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from lensdesign import Lens, load_design, scaled
from paper.element import DESIGNS, PAPER_DESIGN
from paper.twin import MARGIN, OBJECT_PITCH_UM, STOP_SHARE, Thing
from wavesim import Engine, Field, Imaged, ReconstructionSettings, image
from wavesim.metrics import element_contrasts, object_correlation, smallest_resolved_element, transmitted_part
from wavesim.reconstruction import Retrieved
from wavesim.reconstruction.problem import ReconstructionProblem, reconstruction_problem
from wavesim.reconstruction.resumable import retrieve_resumably
from wavesim.targets.usaf import UsafElement

ONE, BRACKET = (1.0,), (1.0, 30.0, 1000.0)
"""Exposures of each plane: set by its brightest pixel, as the paper's; and longer ones for what is faint."""

ENGINE_ERROR, SEED = 0.1, 1


@dataclass(frozen=True, eq=False)
class Shot:
    """An object, and frames of it.

    Attributes
    ----------
    lens
        The twin.
    imaged
        The object, and its frames.
    """

    lens: Lens
    imaged: Imaged

    @cached_property
    def case(self) -> ReconstructionProblem:
        """The frames as a reconstruction takes them, through the nominal lens."""
        chosen = self.imaged.settings
        settings = ReconstructionSettings(
            method="paper",
            engine="eikonal",
            error=ENGINE_ERROR,
            patch_mm=chosen.patch_mm,
            field_stop_mm=chosen.field_stop_mm,
            object_pitch_um=chosen.object_pitch_um,
        )
        return reconstruction_problem(self.lens, self.imaged.frames, settings, None, None, None)

    @property
    def light(self) -> Field:
        """On the object, the field stop in it."""
        return self.case.light

    @property
    def elements(self) -> tuple[UsafElement, ...]:
        """Of the chart."""
        return self.imaged.target.elements

    def retrieved(self, iterations: int, start: str = "model") -> Retrieved:
        """The field on the nearest plane by Appendix A, from the forward model's field or another start."""
        case = self.case
        return retrieve_resumably(case.engine, case.light, case.recorded, iterations=iterations, start=start)[
            0
        ]

    def object_of(self, field: Field, back: Engine | None = None) -> Field:
        """A field on the nearest plane carried back to the object, brightest where light is 1."""
        found = (back or self.case.engine).adjoint(field)
        return found.with_values(found.values * self._scale)

    @cached_property
    def _scale(self) -> float:
        """Amplitude of the light, for 1 as it was recorded."""
        model, first = self.case.engine.forward(self.light), self.case.recorded[0].amplitude
        return float(np.linalg.norm(model.values) ** 2 / np.sum(np.abs(model.values) * first))

    def correlation(self, found: Field) -> float:
        """With the object as the lens passes it, the illumination taken out of both."""
        return object_correlation(found, *self._passed, np.abs(self.light.values) > 0.0)

    @cached_property
    def _passed(self) -> tuple[Field, Field]:
        """Object and light."""
        light, engine = self.light, self.case.engine
        behind = light.with_values(light.values * self.imaged.target.transmission.values)
        return transmitted_part(behind, engine), transmitted_part(light, engine)


@cache
def shot(
    scale: float,
    thing: Thing = "chart",
    exposures: tuple[float, ...] = ONE,
    planes: int = 2,
    farther_um: float = 0.0,
    fill_factor: float = 1.0,
) -> Shot:
    """Take frames.

    Parameters
    ----------
    scale
        Of the twin.
    thing
        The object, in a field stop that fills the field.
    exposures
        Of each plane.
    planes
        How many, from the design's nearest to its farthest.
    farther_um
        How much farther from the lens the object is than the nominal working distance.
    fill_factor
        Of a pixel; 0 is a point.
    """
    lens = scaled(load_design(DESIGNS / PAPER_DESIGN), scale)
    stop_mm = STOP_SHARE * lens.object.field_diameter_mm
    near, far = lens.sensor.plane_distances_mm[0], lens.sensor.plane_distances_mm[-1]
    imaged = image(
        lens,
        "usaf" if thing == "chart" else "tissue",
        engine="eikonal",
        error=ENGINE_ERROR,
        seed=SEED,
        patch_mm=min(MARGIN * stop_mm, lens.object.field_diameter_mm),
        field_stop_mm=stop_mm,
        object_pitch_um=OBJECT_PITCH_UM,
        planes_mm=tuple(float(z) for z in np.linspace(near, far, planes)),
        exposures=exposures,
        working_distance_error_mm=1e-3 * farther_um,
        fill_factor=fill_factor,
    )
    return Shot(lens, imaged)


@cache
def retrieved_of(one: Shot, iterations: int, start: str = "model") -> Retrieved:
    """Of a shot, for all elements that show it."""
    return one.retrieved(iterations, start)


def finest(found: Field, elements: tuple[UsafElement, ...]) -> UsafElement | None:
    """The element of a chart down to which all are resolved."""
    return smallest_resolved_element(element_contrasts(found.values, found.grid, elements))


def element_text(element: UsafElement | None) -> str:
    """An element as the paper names it."""
    return "none" if element is None else f"{element.group}-{element.element}, {element.line_width_um:.3g} µm"
