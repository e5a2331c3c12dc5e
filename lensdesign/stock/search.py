"""Search for stock lenses that meet a specification: single lenses and air-spaced pairs of two.

Estimates of first and third order choose the most promising arrangements. Rays find the working distance and
the spacing of each. The best of them are checked exactly as `lensdesign check` checks a design against the
specification.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.report import CheckReport, Constraint
from lensdesign.analysis.space_bandwidth import smallest_exit_beam_diameter_mm
from lensdesign.common.arrays import Array
from lensdesign.common.processes import Processes, follow_parent
from lensdesign.common.text import counted_reasons
from lensdesign.errors import DesignError, InputError, MaterialError, TransferLensError, validate_whole_number
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface
from lensdesign.optimization.as_built import TrialsOf, as_built_by, check_trials_by
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification_check import check_against
from lensdesign.stock.arrangement import (
    Arrangement,
    OrientedLens,
    StockLens,
    geometry_key,
    orientations,
    working_distances_mm,
)
from lensdesign.stock.distances import COARSE, FINE, MARGIN, find_distances
from lensdesign.stock.estimates import (
    BACK_MM,
    FRONT_MM,
    FRONT_SAG_MM,
    EstimateLimits,
    best_pairs,
    lens_table,
    single_ranks,
)
from lensdesign.stock.index import IndexedFile, Progress, StockIndex

YIELD_LENSES = 3
"""Number of the best lenses whose yield as built is found."""

_REFINED_FOR_EACH, _REFINED_BESIDES = 2, 10
"""Arrangements that are traced finely for each one to be kept, and in addition."""

_BATCH = 20
"""Arrangements that a worker traces at a time."""


@dataclass(frozen=True)
class StockSettings:
    """Settings of a search for stock lenses.

    Attributes
    ----------
    keep
        Largest number of lenses to return.
    traced
        Largest number of single lenses, and of pairs, through which rays are traced: the most promising ones.
    clear_fraction
        Fraction of the semi-diameters in the files that is clear (above 0 to 1). Many vendors state the
        diameter of the glass, of which some 90 % are clear.
    tolerances
        Grade or study file with manufacturing tolerances, for the yield of the three best lenses as built;
        None omits it.
    yield_trials
        Number of Monte Carlo trials of each of these lenses; with 0 their yield is only predicted. A trial
        with the merits of a grade takes a second or more.

    Examples
    --------
    >>> from lensdesign import StockSettings
    >>> StockSettings(keep=3).traced
    300
    """

    keep: int = 10
    traced: int = 300
    clear_fraction: float = 1.0
    tolerances: str | None = None
    yield_trials: int = 0

    def __post_init__(self) -> None:
        validate_whole_number("keep", self.keep, 1)
        validate_whole_number("traced", self.traced, 1)
        validate_whole_number("yield_trials", self.yield_trials, 0)
        if not 0.0 < self.clear_fraction <= 1.0:
            raise InputError(f"clear_fraction = {self.clear_fraction!r}: must be above 0 and at most 1")
        if self.yield_trials and self.tolerances is None:
            raise InputError(f"yield_trials = {self.yield_trials}: needs tolerances, a grade or a study file")


@dataclass(frozen=True, eq=False)
class StockMatch:
    """An arrangement of stock lenses with its check.

    Attributes
    ----------
    arrangement : Arrangement
        The lenses and their orientations.
    lens : Lens
        The design.
    report : CheckReport
        Check against the specification.
    spacing_mm : float or None
        Distance between the two lenses of a pair.
    predicted_yield : float or None
        Predicted fraction of good lenses as built, if requested; NaN if it is not predicted.
    built : TrialsOf or None
        Trials of the lens as built, if requested.
    """

    arrangement: Arrangement
    lens: Lens
    report: CheckReport
    spacing_mm: float | None
    predicted_yield: float | None = None
    built: TrialsOf | None = None

    @property
    def order(self) -> tuple[float, float]:
        """Spread angle in steps of 0.001 degrees, then length; smaller is better."""
        return round(self.report.max_spread_deg, 3), self.lens.track_mm

    @property
    def excess(self) -> float:
        """Largest relative amount by which a constraint is missed; 0 if all are met."""
        return max((_excess(one) for one in self.report.constraints if not one.met), default=0.0)


@dataclass(frozen=True, eq=False)
class StockResult:
    """Result of a search for stock lenses.

    Attributes
    ----------
    matches : tuple of StockMatch
        Arrangements that meet the specification, the best first.
    nearest : StockMatch or None
        The arrangement that misses least, if none meets the specification.
    left_out : dict
        Reason why a file can be neither a single lens nor a part of a pair, by the name of the file.
    skipped : dict
        Number of single lenses and pairs that were not traced or checked, by the reason.
    lenses, singles, pairs
        Number of different lenses, and of single lenses and pairs with all orientations.
    traced
        Number of arrangements through which rays were traced.

    Examples
    --------
    >>> from lensdesign import find_stock_lenses, index_stock, load_design, load_specification, write_zmx
    >>> write_zmx(load_design("designs/feasible_singlet.toml"), "one_lens/singlet.zmx")
    >>> specification = load_specification("designs/feasible_singlet_spec.toml")
    >>> result = find_stock_lenses(index_stock("one_lens"), specification)
    >>> result.lenses, result.singles, result.pairs  # each with both orientations
    (1, 2, 4)
    """

    matches: tuple[StockMatch, ...]
    nearest: StockMatch | None
    left_out: dict[str, str]
    skipped: dict[str, int]
    lenses: int
    singles: int
    pairs: int
    traced: int


def find_stock_lenses(
    index: StockIndex,
    specification: Specification,
    settings: StockSettings = StockSettings(),
    workers: int | None = 1,
    progress: Progress = lambda *_: None,
) -> StockResult:
    """Find single stock lenses and air-spaced pairs of them that meet a specification.

    Each lens is tried in both orientations, with the stop on the first surface. The working distance is found
    within the bounds of its variable, or has the value of the specification. The sensor planes are those of
    the specification. Its surfaces, their variables and its goal have no effect.

    Parameters
    ----------
    index
        Index of the vendors' files.
    specification
        Specification with object, sensor, wavelengths and constraints.
    settings
        Settings of the search.
    workers
        Number of processes; None means one for each processor.
    progress
        Progress callback: ``progress(completed, total, description)``.

    Returns
    -------
    StockResult

    Raises
    ------
    InputError
        If stock lenses cannot answer the specification, or the index contains no lens.

    Examples
    --------
    >>> from lensdesign import find_stock_lenses, index_stock, load_design, load_specification, write_zmx
    >>> write_zmx(load_design("designs/feasible_singlet.toml"), "suitable/singlet.zmx")
    >>> specification = load_specification("designs/feasible_singlet_spec.toml")
    >>> found = find_stock_lenses(index_stock("suitable"), specification)
    >>> best = found.matches[0]
    >>> best.arrangement.name, round(best.report.max_spread_deg, 2), best.report.feasible
    ('singlet', 4.64, True)
    """
    _check_answerable(specification)
    if settings.tolerances is not None and settings.yield_trials:
        check_trials_by(settings.tolerances)
    if not index.lenses:
        raise InputError(
            f"{index.folder}: none of the {len(index.files)} files contains a usable lens, such as "
            f"{index.files[0].name}: {index.files[0].reason}"
        )
    left_out = {file.name: file.reason for file in index.refused}
    lenses = _different_lenses(index.lenses, specification, settings, index.glass_catalogs, left_out)
    parts = [part for lens in lenses for part in orientations(lens)]
    skipped: Counter[str] = Counter()
    chosen = _promising(parts, specification, index.glass_catalogs, settings.traced, skipped, left_out)
    work = _Work(specification, index.glass_catalogs)
    with _mapping(work, len(chosen), workers) as each:
        ranked: list[tuple[float, Arrangement]] = []
        for done, (arrangement, rank) in enumerate(each(_rank_by_rays, chosen), start=1):
            if isinstance(rank, str):
                skipped[rank] += 1
            else:
                ranked.append((rank, arrangement))
            progress(done, len(chosen), "tracing arrangements")
        ranked.sort(key=lambda one: one[0])
        matches, nearest = _checked(each, [one for _, one in ranked], settings.keep, progress, skipped)
    matches.sort(key=lambda one: one.order)
    kept = matches[: settings.keep]
    if settings.tolerances is not None:
        best = kept[:YIELD_LENSES]
        for i, one in enumerate(best):
            progress(i, len(best), "yield of the best lenses as built")
            kept[i] = _as_built(one, settings.tolerances, settings.yield_trials)
    return StockResult(
        tuple(kept),
        nearest,
        left_out,
        counted_reasons(skipped),
        len(lenses),
        len(parts),
        len(parts) ** 2,
        len(chosen),
    )


def _check_answerable(specification: Specification) -> None:
    """Refuse constraints that name surfaces of the specification's own lens."""
    limits = specification.constraints
    for key in ("min_yield", "max_as_built_rms_waves", "max_as_built_reconstruction_loss"):
        if getattr(limits, key) is not None:
            raise DesignError(
                f"constraints: {key} = {getattr(limits, key):g}: stock lenses cannot answer it, because its "
                "study perturbs the surfaces of the specification's own lens; remove it, and use "
                "--tolerances for the yield of the best lenses"
            )


def _different_lenses(
    files: Sequence[IndexedFile],
    specification: Specification,
    settings: StockSettings,
    catalogs: Sequence[Path],
    left_out: dict[str, str],
) -> list[StockLens]:
    """Return the lenses with different geometry whose index is known at all wavelengths."""
    found: dict[str, StockLens] = {}
    unknown: dict[str, str] = {}
    for file in files:
        whole = [Surface(**table) for table in file.surfaces]
        surfaces = tuple(_clear(surface, settings.clear_fraction) for surface in whole)
        edge = max(surface.semi_diameter_mm or 0.0 for surface in whole)
        fault = next(
            (f for s in surfaces if (f := _unknown(s.material, specification, catalogs, unknown))), ""
        )
        if fault:
            left_out[file.name] = fault
            continue
        key = geometry_key(surfaces)
        same = found.get(key)
        found[key] = (
            StockLens((file.name,), file.title, surfaces, edge)
            if same is None
            else replace(same, files=(*same.files, file.name))
        )
    return list(found.values())


def _clear(surface: Surface, fraction: float) -> Surface:
    if fraction == 1.0 or surface.semi_diameter_mm is None:
        return surface
    return surface.replaced(semi_diameter_mm=fraction * surface.semi_diameter_mm)


def _unknown(
    material: str | float | None,
    specification: Specification,
    catalogs: Sequence[Path],
    known: dict[str, str],
) -> str:
    """Return why the index of a material is unknown at a wavelength; empty if it is known."""
    if not isinstance(material, str):
        return ""
    if material not in known:
        try:
            for wavelength in specification.wavelengths_um:
                refractive_index(material, wavelength, catalogs)
            known[material] = ""
        except MaterialError as error:
            known[material] = str(error)
    return known[material]


def _promising(
    parts: Sequence[OrientedLens],
    specification: Specification,
    catalogs: Sequence[Path],
    most: int,
    skipped: Counter[str],
    left_out: dict[str, str],
) -> list[Arrangement]:
    """Return the most promising single lenses and pairs, at most `most` of each."""
    if not parts:
        return []
    limits = EstimateLimits.of(specification)
    table = lens_table(parts, specification.wavelengths_um[0], catalogs)
    # No lens behind the first one can gather light that misses it, and no beam can be narrower at the last
    # one than the Lagrange invariant allows.
    can_be_first = _can_be_first(parts, table, specification)
    narrowest = 0.5 * smallest_exit_beam_diameter_mm(
        2.0 * limits.half_field_mm, specification.object.numerical_aperture, limits.spread
    )
    can_be_last = table[:, BACK_MM] >= narrowest
    for part, first, last in zip(parts, can_be_first, can_be_last, strict=True):
        if not (first or last):
            reason = (
                f"too narrow for the numerical aperture at the nearest object, and for the beam of "
                f"{2.0 * narrowest:.4g} mm that the spread limit needs"
            )
            left_out |= dict.fromkeys(part.lens.files, reason)
    for part, first, last in zip(parts, can_be_first, can_be_last, strict=True):
        if first or last:  # the other orientation can be used
            for name in part.lens.files:
                left_out.pop(name, None)
    both = np.flatnonzero(can_be_first & can_be_last)
    ranks = single_ranks(table[both], limits)
    order = np.argsort(ranks, kind="stable")[:most]
    singles = [Arrangement((parts[int(i)],)) for i in both[order][np.isfinite(ranks[order])]]
    fronts, backs = np.flatnonzero(can_be_first), np.flatnonzero(can_be_last)
    pairs, _, estimated = best_pairs(table[fronts], table[backs], limits, most)
    count = len(parts)
    _count(
        skipped,
        "single lens: first surface too narrow for the light of the object",
        count - can_be_first.sum(),
    )
    _count(
        skipped,
        f"single lens: last surface narrower than the beam of {2.0 * narrowest:.4g} mm that the spread needs",
        (can_be_first & ~can_be_last).sum(),
    )
    _count(skipped, "single lens: estimated worse than those traced", len(both) - len(singles))
    possible = len(fronts) * len(backs)
    _count(
        skipped,
        "pair: first lens too narrow for the light, or second one for the beam",
        count * count - possible,
    )
    _count(skipped, "pair: summed power too strong or too weak", possible - estimated)
    _count(skipped, "pair: estimated worse than those traced", estimated - len(pairs))
    return singles + [Arrangement((parts[fronts[i]], parts[backs[j]])) for i, j in pairs]


def _can_be_first(
    parts: Sequence[OrientedLens], table: Array, specification: Specification
) -> NDArray[np.bool_]:
    """Return which lenses admit the light of the nearest object through their first surface."""
    clear = table[:, FRONT_MM]
    if specification.optimize.stop == "fixed":
        return np.asarray(specification.stop_semi_diameter_mm <= clear)
    near, na = working_distances_mm(specification)[0], specification.required_object.numerical_aperture
    tangent = math.tan(math.asin(na))
    # Where the edge of the surface lies outside the marginal ray, the ray meets the surface inside its edge.
    admitted = np.asarray((near + table[:, FRONT_SAG_MM]) * tangent <= clear)
    # A steep convex surface may be met before its edge lies inside the ray.
    for i in np.flatnonzero(~admitted & (table[:, FRONT_SAG_MM] > 0.0) & (near * tangent <= clear)):
        stop = Arrangement((parts[int(i)],)).stop_semi_diameter_mm(specification, np.array(near))[0]
        admitted[i] = stop <= clear[i]
    return admitted


def _count(skipped: Counter[str], reason: str, number: int) -> None:
    if number:
        skipped[reason] += int(number)


@dataclass(frozen=True, eq=False)
class _Work:
    """Specification and catalogues, which a worker process uses."""

    specification: Specification
    catalogs: tuple[Path, ...]


def _rank_by_rays(work: _Work, arrangement: Arrangement) -> float | str:
    """Return the rank of an arrangement at its best distances, or the reason why it has none."""
    try:
        return find_distances(arrangement, work.specification, work.catalogs, COARSE).rank
    except InputError as error:
        return f"{'pair' if len(arrangement.parts) > 1 else 'single lens'}: {error}"


Function = Callable[[_Work, Arrangement], Any]
Each = Callable[[Function, Sequence[Arrangement]], Iterator[tuple[Arrangement, Any]]]
"""Function that yields each arrangement with the result of a function for it, in order."""


@contextmanager
def _mapping(work: _Work, count: int, workers: int | None) -> Iterator[Each]:
    """Provide a function that does work in this process, or in several for many arrangements."""
    processes = min(len(os.sched_getaffinity(0)) if workers is None else workers, count // (2 * _BATCH))
    if processes <= 1:
        yield lambda function, arrangements: ((one, function(work, one)) for one in arrangements)
        return
    with Processes(processes, _start_worker, work) as pool:

        def each(
            function: Function, arrangements: Sequence[Arrangement]
        ) -> Iterator[tuple[Arrangement, Any]]:
            size = max(1, min(_BATCH, len(arrangements) // (4 * processes)))
            batches = [arrangements[i : i + size] for i in range(0, len(arrangements), size)]
            try:
                futures = [pool.submit(_work_on, function, batch) for batch in batches]
                for batch, future in zip(batches, futures, strict=True):
                    yield from zip(batch, future.result(), strict=True)
            except BrokenProcessPool as error:
                raise TransferLensError(
                    f"{pool.end()} ended a process of the search; use --workers 1 if it happens again"
                ) from error

        yield each


_work: _Work | None = None


def _start_worker(work: _Work) -> None:
    global _work
    follow_parent()
    _work = work


def _work_on(function: Function, arrangements: Sequence[Arrangement]) -> list[Any]:
    assert _work is not None  # _start_worker has set it
    return [function(_work, one) for one in arrangements]


def _checked(
    each: Each, arrangements: Sequence[Arrangement], keep: int, progress: Progress, skipped: Counter[str]
) -> tuple[list[StockMatch], StockMatch | None]:
    """Return arrangements that meet the specification, or else the one that misses least.

    Arrangements are ordered by coarse ranks, which are uncertain by some per cent. More of them than are kept
    are therefore traced finely. Those that may meet the specification are checked in their new order.
    """
    most = arrangements[: _REFINED_FOR_EACH * keep + _REFINED_BESIDES]
    refined: list[tuple[float, Arrangement]] = []
    for done, (arrangement, found) in enumerate(each(_distances, most), start=1):
        progress(done, len(most), "refining the best arrangements")
        if found is not None:
            refined.append((found, arrangement))
    refined.sort(key=lambda one: one[0])
    # Largest relative error of sampled rays.
    promising = [one for rank, one in refined if rank <= 1.02]
    matches: list[StockMatch] = []
    nearest: StockMatch | None = None
    group = keep + 2
    tries = promising or [one for _, one in refined[:3]]
    for start in range(0, len(tries), group):
        for done, (_, match) in enumerate(each(_best_check, tries[start : start + group]), start=start + 1):
            progress(done, len(tries), "checking the best arrangements")
            if match is None:
                skipped["no distances let all light pass"] += 1
            elif match.report.feasible:
                matches.append(match)
            elif nearest is None or match.excess < nearest.excess:
                nearest = match
        if len(matches) >= keep:
            break
    return matches, None if matches else nearest


def _distances(work: _Work, arrangement: Arrangement) -> float | None:
    """Return the rank of an arrangement by fine sampling."""
    try:
        return find_distances(arrangement, work.specification, work.catalogs, FINE).rank
    except InputError:
        return None


def _best_check(work: _Work, arrangement: Arrangement) -> StockMatch | None:
    """Return an arrangement at its best distances with its check; None if it forms no lens there.

    If a footprint or an aperture is missed by a little, the search is repeated with a larger margin.
    """
    margin, match = MARGIN, None
    for _ in range(3):
        try:
            found = find_distances(arrangement, work.specification, work.catalogs, FINE, margin)
            lens = arrangement.design(
                work.specification, found.working_distance_mm, found.spacing_mm, work.catalogs
            )
            report = check_against(lens, work.specification)
        except InputError:
            return match
        spacing = found.spacing_mm if len(arrangement.parts) > 1 else None
        tried = StockMatch(arrangement, lens, report, spacing)
        if match is None or tried.excess < match.excess:
            match = tried
        # The largest relative excess that sampled rays may have missed.
        sampling_error = 0.02
        if report.feasible or tried.excess > sampling_error:
            return match
        margin *= 1.0 - tried.excess - 0.002
    return match


def _excess(one: Constraint) -> float:
    """Return the relative amount by which a constraint is missed."""
    value, limit = one.value, one.limit
    if not (math.isfinite(value) and limit):
        return math.inf
    if one.unit == "deg":
        value, limit = (math.sin(math.radians(min(angle, 90.0))) for angle in (value, limit))
    return abs(value / limit - 1.0)


def _as_built(match: StockMatch, tolerances: str, trials: int) -> StockMatch:
    """Return a match with the yield of its lens as built."""
    study = as_built_by(tolerances, match.lens)
    if trials:
        built = study.trials([("stock", match.lens)], trials).rows[0]
        good = built.predicted_good
        return replace(match, built=built, predicted_yield=math.nan if good is None else good)
    return replace(match, predicted_yield=study.predict(match.lens).good)
