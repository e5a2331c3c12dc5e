"""Searches for lenses from the page: variables, constraints, and the search."""

from __future__ import annotations

import json
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.text import name_with_unit, number_with_unit
from lensdesign.errors import InputError
from lensdesign.files.design import design_text
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import length_power
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS
from studio.model.built import ManufacturingQuality
from studio.model.studies import write_study

if TYPE_CHECKING:
    from lensdesign.optimization.specification.specification import Specification

GOALS = (
    "smallest spread",
    "thinnest lens",
    "smallest aperture",
    "shortest track",
    "longest working distance",
    "largest field",
    "as-built rms",
    "yield",
)

CONSTRAINTS = (
    ("max_spread_deg", "spread, at most", "deg"),
    ("max_footprint_radius_mm", "footprint, at most", "mm"),
    ("max_lens_thickness_mm", "thickness, at most", "mm"),
    ("max_track_mm", "track, at most", "mm"),
    ("min_edge_thickness_mm", "edge, at least", "mm"),
    ("max_semi_diameter_mm", "semi-diameter, at most", "mm"),
    ("min_yield", "yield, at least", ""),
)
"""Key, label and unit of constraints; for those of `SENSOR_LIMITS`, ``sensor`` means the sensor's limit."""

SENSOR_LIMITS = ("max_spread_deg", "max_footprint_radius_mm")
"""Constraints that may be given by the sensor."""


@dataclass(frozen=True)
class Search:
    """Settings of a search.

    Attributes
    ----------
    variables
        Names of variables; see :func:`variables_of`.
    goal
        One of `GOALS` (default: smallest spread).
    constraints
        Values by the keys of `CONSTRAINTS` (default: defaults of a specification).
    starts
        Largest number of starts (default: 6).
    ranges
        Bounds of variables by name, in place of those of :func:`variables_of`: one number for a radius (the
        smallest), two for others.
    """

    variables: tuple[str, ...]
    goal: str = "smallest spread"
    constraints: dict[str, float | str] = field(default_factory=dict)
    starts: int = 6
    ranges: dict[str, tuple[float, ...]] = field(default_factory=dict)

    @classmethod
    def of_texts(
        cls,
        variables: tuple[str, ...],
        goal: str,
        limits: Mapping[str, str],
        ranges: Mapping[str, tuple[float, ...]],
    ) -> Search:
        """Return the search with constraints given as texts; an empty text means no limit.

        Raises
        ------
        InputError
            If there is no variable, or a limit is neither a number nor an allowed word.
        """
        if not variables:
            raise InputError("no variable is selected: tick at least one")
        constraints: dict[str, float | str] = {}
        for key, label, unit in CONSTRAINTS:
            given = limits.get(key, "").strip()
            if key in SENSOR_LIMITS and given in ("", "none", "sensor"):
                constraints[key] = given or "none"
            elif given:
                try:
                    constraints[key] = float(given)
                except ValueError:
                    allowed = "a number, sensor, or empty" if key in SENSOR_LIMITS else "a number, or empty"
                    name = name_with_unit(label, unit)
                    raise InputError(f"{name}: {given!r}: must be {allowed}") from None
        return cls(variables, goal, constraints, ranges=dict(ranges))

    @property
    def needs_tolerances(self) -> bool:
        """True if the goal or a constraint is of lenses as built."""
        return self.goal in AS_BUILT_GOALS or "min_yield" in self.constraints


@dataclass(frozen=True, eq=False)
class SearchSummary:
    """Result of a search in plain values.

    Attributes
    ----------
    text
        The lens as the text of a design file.
    feasible, violations, binding
        Whether the lens meets the specification, one sentence for each violation, and binding constraints.
    summary
        Summary in one line.
    """

    text: str
    feasible: bool
    violations: tuple[str, ...]
    binding: tuple[str, ...]
    summary: str


def variables_of(lens: Lens) -> dict[str, dict[str, Any]]:
    """Return the variables of a search by name, with bounds around the values of the lens."""
    found: dict[str, dict[str, Any]] = {}
    for i, surface in enumerate(lens.surfaces, start=1):
        reach = surface.semi_diameter_mm or lens.stop_semi_diameter_mm
        for name in surface.shape_parameters:
            if name.startswith("radius"):
                limits: dict[str, Any] = {"smallest_radius_mm": round(1.01 * reach, 6)}
            elif name.startswith("conic"):
                limits = {"bounds": [-5.0, 1.0]}
            else:
                largest_sag_mm = 0.05 * reach if name.startswith("q_") else 0.05
                most = largest_sag_mm * reach ** (length_power(name) - 1)
                limits = {"bounds": [-most, most]}
            found[f"surface {i} {name}"] = {"surface": i, "parameter": name, **limits}
        if surface.thickness_mm is not None:
            bounds = [0.3 * surface.thickness_mm, 2.0 * surface.thickness_mm]
            found[f"surface {i} thickness_mm"] = {"surface": i, "parameter": "thickness_mm", "bounds": bounds}
    for name in ("working_distance_mm", "field_diameter_mm"):
        length = getattr(lens.object, name)
        found[name] = {"parameter": name, "bounds": [0.5 * length, 2.0 * length]}
    return found


def range_of(variable: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the bounds of a variable: the smallest radius, or the smallest and the largest value."""
    radius_mm = variable.get("smallest_radius_mm")
    return tuple(variable["bounds"]) if radius_mm is None else (radius_mm,)


def with_range(variable: Mapping[str, Any], bounds: tuple[float, ...] | None) -> dict[str, Any]:
    """Return a variable with other bounds; None keeps its own."""
    if bounds is None:
        return dict(variable)
    is_radius = "smallest_radius_mm" in variable
    return {**variable, **({"smallest_radius_mm": bounds[0]} if is_radius else {"bounds": list(bounds)})}


def specification_text(lens: Lens, search: Search, folder: Path, study: str | None) -> str:
    """Return the text of a specification file in a folder.

    Raises
    ------
    InputError
        If there is no variable, or the goal needs tolerances that are not chosen.
    """
    if not search.variables:
        raise InputError("no variable is selected: tick at least one")
    known = variables_of(lens)
    tables: dict[str, Any] = {
        "optimize": {
            "goal": search.goal,
            "starts": search.starts,
            "stop": "numerical aperture",
        },
        "constraints": dict(search.constraints),
        "variable": [
            with_range(known[name], search.ranges.get(name)) for name in search.variables if name in known
        ],
    }
    if study is not None:
        tables["tolerances"] = {"study": study}
    elif search.needs_tolerances:
        raise InputError(f"goal {search.goal!r}: choose tolerances first")
    # Tolerances of a figure refer to a clear aperture. Otherwise the footprint of rays may change freely.
    start = lens if study is not None else _without_sizes(lens)
    return tomli_w.dumps(tomllib.loads(design_text(start, folder)) | tables)


def run_search(
    lens: Lens, search: Search, quality: ManufacturingQuality | None, report: Callable[[str], None]
) -> SearchSummary:
    """Run a search in the calling process.

    Parameters
    ----------
    lens, search, quality
        The start, the settings, and the tolerances of goals as built.
    report
        Called with a JSON object for each line of progress (``{"text": ...}``) and for each improvement
        (``{"seconds": ..., "start": ..., "goal": ..., "feasible": ...}``).

    Raises
    ------
    InputError
        If the settings are not valid or no lens is found; see :func:`lensdesign.optimize`.
    """
    from lensdesign.optimization.search import optimize

    with _specification_of(lens, search, quality) as specification:
        result = optimize(
            specification,
            lambda line: report(json.dumps({"text": line})),
            on_improvement=lambda found: report(json.dumps(asdict(found))),
        )
    reached = number_with_unit(f"{result.goal_value:.6g}", result.goal_unit)
    summary = (
        f"{result.goal} {reached}; {result.evaluations} evaluations in "
        f"{result.seconds:.1f} s, {result.starts_at_best} of {result.starts} starts reached this lens"
    )
    text = design_text(result.lens.replaced(title=lens.title), Path("/"))
    return SearchSummary(text, result.feasible, tuple(result.violations), tuple(result.binding), summary)


def run_exploration(
    lens: Lens,
    search: Search,
    quality: ManufacturingQuality | None,
    over: str,
    count: int,
    report: Callable[[str], None],
) -> int:
    """Compute a Pareto front in the calling process; return the number of searches.

    Parameters
    ----------
    lens, search, quality
        See :func:`run_search`; the goal is ignored.
    over
        Objectives, as in `lensdesign explore --over`.
    count
        Approximate number of lenses.
    report
        Called with each lens that is found: a JSON object with its values and its design file.

    Raises
    ------
    InputError
        If the settings are not valid or no lens is found.
    """
    from lensdesign.exploration.front import Exploration, ExploredPoint
    from lensdesign.exploration.objectives import axes_of

    def keep(one: ExploredPoint) -> None:
        if one.lens is not None:
            found = design_text(one.lens.replaced(title=lens.title), Path("/"))
            report(json.dumps({"values": one.values, "text": found}))

    with _specification_of(lens, search, quality) as specification:
        return len(Exploration(specification, axes_of(over, specification), count, on_result=keep).run())


@contextmanager
def _specification_of(
    lens: Lens, search: Search, quality: ManufacturingQuality | None
) -> Iterator[Specification]:
    """Provide the specification of a search while its temporary files exist."""
    from lensdesign.common.input_files import files_from
    from lensdesign.optimization.specification.specification import load_specification

    with tempfile.TemporaryDirectory() as name, files_from("/"):
        folder = Path(name)
        if quality is not None:
            write_study(lens, quality, 100, folder)
        study = None if quality is None else "study.toml"
        with atomic_path(folder / "asked.toml") as file:
            file.write_text(specification_text(lens, search, folder, study), encoding="utf-8")
        yield load_specification(folder / "asked.toml")


def _without_sizes(lens: Lens) -> Lens:
    """Return the lens without figures, edges, and semi-diameters except that of the stop."""
    surfaces = tuple(
        s if i == lens.stop_index else s.model_copy(update={"semi_diameter_mm": None, "figure": None})
        for i, s in enumerate(lens.surfaces)
    )
    return lens.model_copy(update={"surfaces": surfaces, "edges": ()})
