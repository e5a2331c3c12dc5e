"""Which merit of a tolerance study tells what a perturbed lens does to the reconstruction.

Two twins of the paper's lens are perturbed. An amplitude and a complex object on and off the axis are
recorded through each with noise, and found with the nominal lens and, of some, with the mounting that frames
of a known chart tell. What every trial came to is added to a file, so that a run which was cut off goes on.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.merits_and_chain.chain import Chain, Kind, thing
from benchmarks.merits_and_chain.judging import (
    GOOD,
    MERITS,
    Agreement,
    agreement,
    merit_of,
    scores_of,
    with_compensators,
)
from benchmarks.merits_and_chain.perturbations import trials
from benchmarks.timing import DESIGNS
from lensdesign import load_design, scaled
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from wavesim.scene.system_state import AS_DESIGNED

SEED = 2
NOISE_SEED = 1000
CHART_SEED = 23
"""Of the object whose frames tell the mounting."""

FEWEST = 12
"""Trials whose ranks are printed."""


class Place(NamedTuple):
    """A part of a twin's object: how many times smaller the twin is, its middle, and its field stop."""

    scale: float
    name: str
    middle_mm: tuple[float, float]
    stop_mm: float


PLACES = (
    Place(48.0, "axis", (0.0, 0.0), 0.05),
    Place(48.0, "field", (0.0, 0.011), 0.04),
    Place(32.0, "axis", (0.0, 0.0), 0.065),
    Place(32.0, "field", (0.0, 0.018), 0.055),
)
OBJECTS: tuple[Kind, ...] = ("amplitude", "complex")
CALIBRATED_EVERY = 4
"""Of the first twin's trials, those that are calibrated, too."""


@cache
def twin(scale: float) -> Lens:
    """The paper's lens, so many times smaller."""
    return scaled(load_design(DESIGNS / "paper_singlet.toml"), 1.0 / scale)


def measured(path: Path) -> list[dict[str, Any]]:
    """What the chain made of all trials, of which those that the file lacks are done now."""
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {_key(row) for row in done}
    with path.open("a") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for work in _work():
            if _key(work) not in known:
                done.append(_row(**work))
                file.write(json.dumps(done[-1]) + "\n")
                file.flush()
    return done


def _key(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("scale", "place", "kind", "trial", "calibrated"))


def _work() -> Iterator[dict[str, Any]]:
    """Trials in turn through all places, so that a part of them is a fair one; the nominal lens is -1."""
    count = len(trials(twin(PLACES[0].scale), PLACES[0].scale, SEED)[1])
    order = sorted(range(-1, count), key=lambda n: (n * 29) % count if n >= 0 else -1)
    for turn, trial in enumerate(order):
        for place in PLACES:
            for kind in OBJECTS:
                calibrations = (False, True) if _calibrated(place, turn) else (False,)
                for calibrated in calibrations:
                    yield {
                        "scale": place.scale,
                        "place": place.name,
                        "kind": kind,
                        "trial": trial,
                        "calibrated": calibrated,
                    }


def _calibrated(place: Place, turn: int) -> bool:
    return place.scale == PLACES[0].scale and turn % CALIBRATED_EVERY == 0


@cache
def _chain(scale: float, name: str, kind: Kind) -> tuple[Chain, Any, Any, list[str]]:
    (place,) = (one for one in PLACES if (one.scale, one.name) == (scale, name))
    lens = twin(scale)
    context, batch, groups = trials(lens, scale, SEED)
    chain = Chain(lens, place.middle_mm, place.stop_mm, kind)
    return chain, thing(chain), context.states(batch, None), groups


def _row(scale: float, place: str, kind: Kind, trial: int, calibrated: bool) -> dict[str, Any]:
    chain, true, systems, groups = _chain(scale, place, kind)
    system = AS_DESIGNED if trial < 0 else systems[trial]
    row = {
        "scale": scale,
        "place": place,
        "kind": kind,
        "trial": trial,
        "calibrated": calibrated,
        "group": "nominal" if trial < 0 else groups[trial],
    }
    begun = time.process_time()
    try:
        planes = chain.recorded(system, true, NOISE_SEED + trial)
        bench = None
        if calibrated:
            chart = thing(chain, CHART_SEED)
            bench = chain.mounting(chain.recorded(system, chart, 2 * NOISE_SEED + trial), chart)
        found, misfit = chain.found(planes, bench)
        row |= {"correlation": chain.correlation(found, true), "misfit": misfit}
    except TransferLensError as error:
        row |= {"correlation": None, "error": str(error)}
    return row | {"processor_s": round(time.process_time() - begun, 3)}


class Column(NamedTuple):
    """Trials of one place and object, with the nominal or with calibrated lenses."""

    place: Place
    kind: Kind
    calibrated: bool

    def __str__(self) -> str:
        lens = "calibrated" if self.calibrated else "nominal"
        return f"1/{self.place.scale:.0f} {self.place.name}, {self.kind}, {lens}"


class Judged(NamedTuple):
    """What a merit said of a column's trials, and the chain; larger scores are better."""

    scores: Any
    truth: Any
    groups: list[str]
    agreement: Agreement


def judged(rows: list[dict[str, Any]]) -> Iterator[tuple[str, Column, Judged]]:
    """Every merit against the chain; trials that the chain could not carry are left out."""
    for place in PLACES:
        lens = twin(place.scale)
        context, batch, _ = trials(lens, place.scale, SEED)
        adapted = with_compensators(context, place)
        for column in (Column(place, kind, known) for known in (False, True) for kind in OBJECTS):
            own = [row for row in rows if _is_of(row, column)]
            if len(own) < FEWEST:
                continue
            planes = Chain(lens, place.middle_mm, place.stop_mm, column.kind).planes_mm
            truth, numbers = (np.array([row[name] for row in own]) for name in ("correlation", "trial"))
            for name in MERITS:
                merit = merit_of(name, place, column.kind, planes)
                scores = scores_of(merit, adapted if column.calibrated else context, batch)[numbers]
                groups = [row["group"] for row in own]
                yield name, column, Judged(scores, truth, groups, agreement(scores, truth))


def _is_of(row: dict[str, Any], column: Column) -> bool:
    known = (row["scale"], row["place"], row["kind"], row["calibrated"])
    place, kind, calibrated = column
    return (
        known == (place.scale, place.name, kind, calibrated)
        and row["trial"] >= 0
        and row["correlation"] is not None
    )


def draw(found: dict[str, dict[Column, Judged]], path: Path) -> None:
    """For each merit, its scores against correlations of the chain."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    across = 3
    figure = Figure(figsize=(11.0, 3.2 * -(-len(found) // across)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(-(-len(found) // across), across, squeeze=False).ravel()
    for panel in panels[len(found) :]:
        panel.axis("off")
    for panel, (name, columns) in zip(panels, found.items(), strict=False):
        for kind, colour in zip(OBJECTS, ("C0", "C1"), strict=True):
            own = [one for column, one in columns.items() if column.kind == kind and not column.calibrated]
            if own:
                scores, truth = (
                    np.concatenate([getattr(one, n) for one in own]) for n in ("scores", "truth")
                )
                panel.plot(np.abs(scores), truth, ".", color=colour, markersize=4, label=kind)
        panel.axhline(GOOD, color="0.7", linewidth=0.8)
        panel.set(title=name, ylabel="correlation of the object", ylim=(0.0, 1.02))
    panels[0].legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure what the file lacks, and print how every merit agrees with the chain."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--file", type=Path, default=Path("merits_and_chain.jsonl"), help="of what was done")
    parser.add_argument("--judge", action="store_true", help="what is done already, and no more")
    parser.add_argument("-o", "--chart", type=Path, help="picture to draw")
    asked = parser.parse_args()
    rows = [json.loads(line) for line in asked.file.read_text().splitlines()] if asked.judge else None
    rows = measured(asked.file) if rows is None else rows
    found: dict[str, dict[Column, Judged]] = {}
    for name, column, one in judged(rows):
        found.setdefault(name, {})[column] = one
    print(f"rank correlation / agreement on good, a correlation of {GOOD:g} or more, by column:")
    for number, column in enumerate(next(iter(found.values()), {}), start=1):
        truth = found["reconstruction_loss"][column].truth
        print(f"  {number:2d}  {column}: {len(truth)} trials, {np.count_nonzero(truth >= GOOD)} good")
    for name, columns in found.items():
        figures = [f"{one.agreement.rank:5.2f}/{one.agreement.good:.2f}" for one in columns.values()]
        print(f"{name:26s} {'  '.join(figures)}")
    lost = sum(row["correlation"] is None for row in rows)
    spent = sum(row["processor_s"] for row in rows)
    print(f"{len(rows)} chains, {lost} of them not carried; processor time {spent / 60.0:.1f} min")
    if asked.chart:
        draw(found, asked.chart)


if __name__ == "__main__":
    main()
