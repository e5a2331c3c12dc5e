"""Yields of drawings by a study, which also gives the values that the drawing does not state.

A value that the study does not state is the general tolerance if this loses almost no yield, and otherwise
the largest round value that loses little. No value is tighter than the high-precision grade.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.predicted_yield import MAX_YIELD_LOSS, DerivedTolerances, DrawingYield
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances
from tolerancing.perturbations.grades import HIGH_PRECISION
from tolerancing.prediction.as_drawn_study import (
    HOMOGENEITY,
    AsDrawnStudy,
    as_drawn_study,
    drawing_indications,
    indication_key,
    with_value,
)
from tolerancing.prediction.drawing_indication import OF_ELEMENT, DrawingIndication, Key
from tolerancing.prediction.factor_yields import FirstOrderYield, JointYield
from tolerancing.prediction.ray_prediction import predicted_merits
from tolerancing.prediction.study_prediction import (
    StudyPrediction,
    is_predicted,
    is_scored_at_once,
    predict_study,
)
from tolerancing.prediction.wavefront_prediction import is_predicted_wavefront
from tolerancing.study.files import check_against, save_study
from tolerancing.study.study import Study

LOSS_EACH, LOSS_ALL = 0.002, 0.01
"""Accepted loss of yield by one derived value alone, and by all values that the study does not state."""

WAVE_STEPS, JOINT_STEPS = 100, 15
"""Largest numbers of steps that tighten values because all of them together lose too much yield: for yields
from wavefronts, and for joint yields."""

YieldOf = Callable[[Array], float]


@dataclass(frozen=True)
class DrawingYieldPredictor:
    """Predictor of the yields of drawings by a study.

    It is a :class:`lensdesign.manufacture.drawing.predicted_yield.YieldPredictor`.

    Attributes
    ----------
    study
        The study.
    source
        Name of the study file.
    """

    study: Study
    source: str

    @property
    def _predictable(self) -> bool:
        waves = any(is_predicted_wavefront(merit) for merit in self.study.merits)
        return waves or bool(predicted_merits(self.study))

    def derive(self, lens: Lens, sheets: Sequence[DrawingTolerances]) -> DerivedTolerances:
        """Derive the values that the study does not state for the lens of a drawing.

        Parameters
        ----------
        lens
            The lens as drawn.
        sheets
            Tolerances of each element. General tolerances and missing values are replaced by derived ones.

        Raises
        ------
        DesignError
            If the lens does not have a perturbed parameter, or rays do not pass.
        """
        check_against(self.study, lens, self.source)
        items = drawing_indications(lens, self.study, sheets)
        if not self._predictable or all(item.origin not in ("general", "open") for item in items):
            return DerivedTolerances(tuple(sheets), ())
        as_drawn = as_drawn_study(lens, self.study, items)
        joint = JointYield(lens, as_drawn.study).at
        waves = None
        if any(is_predicted_wavefront(merit) for merit in self.study.merits):
            waves = FirstOrderYield(lens, as_drawn.study).at
        search = _Search(lens, sheets, items, as_drawn)
        search.share_wedges(waves or joint)
        search.tighten(waves or joint, WAVE_STEPS if waves else JOINT_STEPS)
        if waves and predicted_merits(self.study) and search.loss(joint) > search.loss(waves) + LOSS_EACH:
            search.tighten(joint, JOINT_STEPS)
        return DerivedTolerances(
            tuple(_written(sheet, search.chosen, k, lens) for k, sheet in enumerate(sheets)),
            tuple(_notes(search, self.study)),
        )

    def predict(
        self, designed: Lens, drawn: Lens, sheets: Sequence[DrawingTolerances]
    ) -> DrawingYield | None:
        """Predict the yield of a drawing; None if none of the study's merits can be predicted.

        Parameters
        ----------
        designed, drawn
            The lens of the study, and the lens of the drawing.
        sheets
            Tolerances of each element.

        Raises
        ------
        DesignError
            If the study does not fit the lens, or rays do not pass.
        """
        if not any(is_predicted(merit) for merit in self.study.merits):
            return None
        check_against(self.study, drawn, self.source)
        own = predict_study(designed, self.study)
        items = drawing_indications(drawn, self.study, sheets)
        as_drawn = as_drawn_study(drawn, self.study, items)
        found = predict_study(drawn, as_drawn.study)
        loss = _loss(own, found)
        losses: list[tuple[str, float]] = []
        if loss > MAX_YIELD_LOSS:
            losses = _losses(drawn, as_drawn)

        def save(path: Path, design: str) -> None:
            named = [p.file_name for p in as_drawn.study.perturbations if p.file_name is not None]
            if named and path.resolve().parent != Path(self.source).resolve().parent:
                raise InputError(
                    f"the study as drawn reads {named[0]} from its own folder; write it beside {self.source}"
                )
            title = f"{self.study.title or self.source}: as drawn"
            save_study(as_drawn.study.model_copy(update={"title": title, "design": design}), path)

        by_study, as_drawn_yield = (own.joint, found.joint) if own.joint and found.joint else (None, None)
        return DrawingYield(
            None if by_study is None else by_study.fraction,
            None if as_drawn_yield is None else as_drawn_yield.fraction,
            None if by_study is None else (by_study.low, by_study.high),
            None if as_drawn_yield is None else (as_drawn_yield.low, as_drawn_yield.high),
            loss,
            tuple(losses),
            own.is_trustworthy and found.is_trustworthy,
            found.reason or own.reason,
            save,
        )


def _loss(own: StudyPrediction, found: StudyPrediction) -> float:
    """Return the loss of yield by a drawing, from the predictions of the study as given and as drawn."""
    loss = own.within_wavefronts_and_rays - found.within_wavefronts_and_rays
    if math.isnan(loss):  # the study has no limits on wavefronts and rays
        loss = 0.0
    # Merits that are scored draw by draw have fewer draws, so only a clear difference counts.
    if own.joint and found.joint and found.joint.high < own.joint.low:
        loss = max(loss, own.joint.fraction - found.joint.fraction)
    return loss


def _losses(lens: Lens, as_drawn: AsDrawnStudy) -> list[tuple[str, float]]:
    """Return the loss of yield by each indication that the study does not have, largest first."""
    at = JointYield(lens, as_drawn.study).at
    added = list({item.key: item for item in as_drawn.items if item is not None}.values())

    def factors(one: DrawingIndication | None) -> Array:
        return np.array([float(item is None or item is one) for item in as_drawn.items])

    base = at(factors(None))
    found = [(item.text, base - at(factors(item))) for item in added]
    return sorted(found, key=lambda pair: -pair[1])


class _Search:
    """Search for values that a study does not state, tightened until they lose little yield."""

    def __init__(
        self,
        lens: Lens,
        sheets: Sequence[DrawingTolerances],
        items: Sequence[DrawingIndication],
        as_drawn: AsDrawnStudy,
    ) -> None:
        self.items = {item.key: item for item in items}
        self.opened = tuple(item for item in items if item.origin in ("general", "open"))
        self.chosen = {item.key: item for item in self.opened}
        self.shared = set[Key]()
        self.costs = dict.fromkeys(self.chosen, 0.0)
        self._lens, self._sheets = lens, sheets
        # Indication of each perturbation: that of the sheet if the sheet states or adds it.
        keys = (indication_key(p, lens) for p in as_drawn.study.perturbations)
        self._keys = tuple(
            key if item is None else item.key for key, item in zip(keys, as_drawn.items, strict=True)
        )

    def share_wedges(self, yield_of: YieldOf) -> None:
        """Divide the wedge between both surfaces of elements of which the study tilts only one.

        The tilt in the study is the wedge between the surfaces, but a sheet limits the tilt of each against
        the ground edge. Both surfaces get the same fraction of the wedge, the largest that loses little
        yield. The wedge is not divided if the other surface may have its own tilt without such a loss.
        """
        base = self._yield(yield_of, {})
        # Fractions of a wedge for the tilt of each of the two surfaces.
        fractions = (0.7, 0.6, 0.5, 0.4, 0.3, 0.2)
        for front in self._lens.glass_fronts:
            pair = [self.items.get(("centring", surface)) for surface in (front, front + 1)]
            stated = [item for item in pair if item is not None and item.origin == "study"]
            opened = [item for item in pair if item is not None and item.key in self.chosen]
            if len(stated) != 1 or len(opened) != 1 or stated[0].key in self.shared:
                continue
            wedge, other = stated[0], opened[0]
            added = self._valued(other, min(other.value, _floor(fractions[0] * wedge.value)))
            if base - self._yield(yield_of, {other.key: added}) <= LOSS_EACH:
                continue
            for fraction in fractions:
                both = {one.key: self._valued(one, _floor(fraction * wedge.value)) for one in (wedge, other)}
                if base - self._yield(yield_of, both) <= LOSS_EACH:
                    break
            self.chosen |= both
            self.shared |= set(both)

    def tighten(self, yield_of: YieldOf, most_steps: int) -> None:
        """Tighten values until each alone, and all of them together, lose little yield."""
        shared = {key: self.chosen[key] for key in self.shared}
        own = {key: one for key, one in self.chosen.items() if key not in self.shared}
        base = self._yield(yield_of, shared)

        def cost(key: Key, one: DrawingIndication) -> float:
            return base - self._yield(yield_of, shared | {key: one})

        # Yield that a general tolerance may cost alone and still stand.
        negligible_loss = 0.001
        for key, one in own.items():
            self.costs[key] = cost(key, one)
            if self.costs[key] > (LOSS_EACH if one is not self.items[key] else negligible_loss):
                self.chosen[key] = self._widest(
                    one, partial(self._is_acceptable, yield_of, base, shared, key)
                )
                self.costs[key] = cost(key, self.chosen[key])
        for _ in range(most_steps):
            if base - self._yield(yield_of, self.chosen) <= LOSS_ALL:
                break
            costly = (key for key in own if self.costs[key] > 0.5 * negligible_loss)
            steps = {key: closer for key in costly if (closer := self._closer(self.chosen[key]))}
            if not steps:
                break
            key = max(steps, key=lambda key: self.costs[key])
            self.chosen[key] = steps[key]
            self.costs[key] = cost(key, steps[key])

    def _is_acceptable(
        self,
        yield_of: YieldOf,
        base: float,
        shared: dict[Key, DrawingIndication],
        key: Key,
        one: DrawingIndication,
    ) -> bool:
        """Return whether a value alone loses little yield."""
        return base - self._yield(yield_of, shared | {key: one}) <= LOSS_EACH

    def _widest(
        self, item: DrawingIndication, is_acceptable: Callable[[DrawingIndication], bool]
    ) -> DrawingIndication:
        """Return the widest acceptable tighter value, by bisection, or else the tightest value."""
        ladder = [item]
        while (closer := self._closer(ladder[-1])) is not None:
            ladder.append(closer)
        low, high = 0, len(ladder) - 1  # the first value is not acceptable
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if is_acceptable(ladder[middle]) else (middle, high)
        return ladder[high]

    def loss(self, yield_of: YieldOf) -> float:
        """Return the loss of yield by all chosen values together."""
        return self._yield(yield_of, {}) - self._yield(yield_of, self.chosen)

    def _yield(self, yield_of: YieldOf, values: dict[Key, DrawingIndication]) -> float:
        """Return the yield with some values; other values that the study does not state are 0."""
        return yield_of(np.array([self._factor(key, values) for key in self._keys]))

    def _factor(self, key: Key | None, values: dict[Key, DrawingIndication]) -> float:
        """Return the fraction of its widest deviation to which a perturbation is reduced."""
        if key is None or key not in self.items:
            return 1.0
        if key not in values:
            return 1.0 if self.items[key].origin in ("study", "sheet") else 0.0
        return values[key].deviations[0].tolerance / self.items[key].deviations[0].tolerance

    def _valued(self, item: DrawingIndication, value: float) -> DrawingIndication:
        return with_value(item, self._lens, self._sheets[item.element], value)

    def _closer(self, item: DrawingIndication) -> DrawingIndication | None:
        """Return the item with the next tighter value; None if it is beyond the high-precision grade."""
        value = item.value + 1.0 if item.kind == "inhomogeneity" else _rounded_below(item.value)
        least = _least(item, self._lens)
        beyond = value >= len(HOMOGENEITY) if item.kind == "inhomogeneity" else value < least
        if beyond:
            return None
        return self._valued(item, value)


def _floor(value: float) -> float:
    """Return a value rounded down to two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{step * math.floor(value / step + 1e-9):.4g}")


def _rounded_below(value: float) -> float:
    """Return the next round value below a value."""
    decade = 10.0 ** math.floor(math.log10(value))
    # Derived values are these mantissas times powers of ten.
    mantissas = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    steps = [step * decade for step in mantissas] + [0.7 * decade]
    return float(f"{max(step for step in steps if step < value * (1.0 - 1e-9)):.4g}")


def _least(item: DrawingIndication, lens: Lens) -> float:
    """Return the tightest derived value, that of the high-precision grade, in the unit of the sheet."""
    grade = HIGH_PRECISION
    if item.kind == "radius":
        # Fringes are proportional to the change of the radius.
        radius = abs(lens.surfaces[item.surface].radius_mm or 0.0)
        return 0.01 * grade.radius_percent * radius / item.deviations[0].tolerance * item.value
    return {
        "irregularity": 2.0 * grade.irregularity_pv_waves,
        "centring": 60.0 * grade.wedge_deg,
        "decenter": grade.asphere_decenter_mm,
        "thickness": grade.thickness_mm,
        "index": grade.index,
        "Abbe number": grade.abbe_percent,
    }.get(item.kind, 0.0)


def _written(
    sheet: DrawingTolerances, chosen: dict[Key, DrawingIndication], element: int, lens: Lens
) -> DrawingTolerances:
    """Return the sheet of an element with the chosen values."""
    front = lens.glass_fronts[element]
    for item in chosen.values():
        # A cemented surface is stated on the sheets of both of its elements.
        if element != item.element if item.kind in OF_ELEMENT else item.surface not in (front, front + 1):
            continue
        side = None if item.kind in OF_ELEMENT else "left" if item.surface == front else "right"
        part = sheet if side is None else getattr(sheet, side)
        value = f"{item.value:g};1" if item.kind == "inhomogeneity" else item.value
        old = getattr(part, item.field)
        given = old not in (None, "") and item.field not in part.general
        stated = given and item.origin in ("general", "open")
        closer = isinstance(old, float) and old <= item.value
        if stated or closer or old == value:
            continue
        own = part.with_derived(**{item.field: value})
        sheet = own if side is None else sheet.replaced(**{side: own})
    return sheet


def _notes(search: _Search, study: Study) -> list[str]:
    """Return notes on the derived values."""
    known = [merit.label for merit in study.merits if is_scored_at_once(merit)]
    lost = "yield" if len(known) == len(study.merits) else f"the lenses within {', '.join(known)}"
    notes = []
    if search.shared:
        texts = ", ".join(search.chosen[key].text for key in sorted(search.shared))
        notes.append(
            f"derived from the study, whose tilt of one surface is divided between both surfaces: {texts}"
        )
    derived = [
        f"{item.text}, loses {100.0 * max(search.costs[item.key], 0.0):.1f} percentage points of {lost}"
        for old in search.opened
        if (item := search.chosen[old.key]).value != old.value or old.origin == "open"
        if item.key not in search.shared
    ]
    if derived:
        notes.append(f"derived from the study, which does not state them: {'; '.join(derived)}")
    return notes
