"""Registry of the analytic cases: scenes with an object field whose exit field is known without an engine.

The command `wavesim check-engine` compares engines with them. To add a case, write a module and add a line to
`ANALYTIC_CASES`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError

if TYPE_CHECKING:
    from wavesim.fields.field import Field
    from wavesim.scene.scene import Scene

ANALYTIC_CASES: dict[str, str] = {
    "cylinder": "wavesim.analytic.cylinder:cylinder_scene",
    "sphere": "wavesim.analytic.sphere:sphere_scene",
    "stigmatic": "wavesim.analytic.stigmatic:stigmatic_scene",
    "plate": "wavesim.analytic.plane_interface:plate_scene",
    "tilted-plate": "wavesim.analytic.tilted_plate:tilted_plate_scene",
    "half-plane": "wavesim.analytic.half_plane:half_plane_scene",
    "slit": "wavesim.analytic.aperture_diffraction:slit_scene",
    "hole": "wavesim.analytic.aperture_diffraction:hole_scene",
    "plane": "wavesim.analytic.plane_interface:plane_scene",
    "beam": "wavesim.analytic.plane_interface:beam_scene",
}
"""Location of each case as `module:function`. A module is imported when it is first requested."""


@dataclass(frozen=True, eq=False)
class AnalyticCase:
    """A scene whose exit field is known.

    Attributes
    ----------
    scene : Scene
        Lens, object grid and exit grid.
    object_field : Field
        Field on the scene's object grid.
    exact : Field
        Field on the scene's exit grid after one passage through the lens.
    uncertainty : float
        Relative L2 error of `exact` itself, due to terms that its closed form neglects, or to the scene's
        aperture.
    """

    scene: Scene
    object_field: Field
    exact: Field
    uncertainty: float


def analytic_case(name: str, **arguments: Any) -> AnalyticCase:
    """Return an analytic case by name.

    Parameters
    ----------
    name
        One of `ANALYTIC_CASES`.
    **arguments
        Arguments of the function that creates it.

    Raises
    ------
    InputError
        If there is no such case, or an argument is unknown or has an invalid value.
    """
    if name not in ANALYTIC_CASES:
        raise InputError(
            f"solution = {name!r}: there is no such solution; allowed: {', '.join(ANALYTIC_CASES)}"
            f"{did_you_mean(name, ANALYTIC_CASES)}"
        )
    make = _maker(name)
    allowed = tuple(inspect.signature(make).parameters)
    for argument in arguments:
        if argument not in allowed:
            raise InputError(
                f"solution {name}: {argument} = {arguments[argument]!r}: there is no such argument; "
                f"allowed: {', '.join(allowed)}{did_you_mean(argument, allowed)}"
            )
    return _cached_case(name, tuple(sorted(arguments.items())))


def _maker(name: str) -> Callable[..., AnalyticCase]:
    module, _, attribute = ANALYTIC_CASES[name].partition(":")
    make: Callable[..., AnalyticCase] = getattr(import_module(module), attribute)
    return make


# Cases are cached, since the exact field of a large cylinder takes longer than an engine.
@lru_cache(maxsize=8)
def _cached_case(name: str, arguments: tuple[tuple[str, Any], ...]) -> AnalyticCase:
    case = _maker(name)(**dict(arguments))
    for field in (case.object_field, case.exact):
        field.values.flags.writeable = False
    return case
