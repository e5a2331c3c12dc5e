"""A case from its frames to its result, on the path that the commands take."""

from __future__ import annotations

import re
import traceback
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.verdicts.benches import Bench, BenchFrames, write_frames
from benchmarks.verdicts.cases import Case
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import FrameSetSettings, ReconstructionSettings
from wavesim.sensor.frame_sets import read_frames
from wavesim.sensor.frames import Frame

EXPLAINED, NOT_EXPLAINED, REFUSED, FAILED = range(4)
"""Exit statuses of `wavesim reconstruct`; the last is a traceback."""

NEAR = 0.01
"""Correlation by which a wrong input's object may fall short of the right one, where it ends with 0."""


@dataclass(frozen=True)
class Result:
    """What a case came to.

    `correlation` is that with the true object, `right` that of the same case without the error; both and
    the residuals are None where nothing was reconstructed. `status` is the exit status, `cause` what the
    verdict names, `message` what is printed, `seconds` the time of reading and reconstruction. `kept` says
    whether the case's rule is kept, `named` whether the cause is right (None where none is asked for).
    """

    name: str
    group: str
    made: str
    correlation: float | None
    right: float | None
    over_noise: float | None
    held_out_over_noise: float | None
    status: int
    cause: str
    message: str
    warnings: tuple[str, ...]
    engine: str
    predicted_error: float | None
    seconds: float
    kept: bool
    named: bool | None

    def as_dict(self) -> dict[str, Any]:
        """Return all of it, ready for JSON."""
        return asdict(self)


class Judge:
    """Runs cases, and remembers what benches without an error came to."""

    def __init__(self, folder: Path, verdict: str = "full") -> None:
        self._folder, self._verdict = folder, verdict
        self._benches = dict[Bench, BenchFrames]()
        self._right = dict[str, float | None]()

    def result(self, case: Case) -> Result:
        """Run a case, and where there is an error the same case without it."""
        bench = self._bench(case.bench)
        place = self._folder / "cases" / re.sub(r"[^a-z0-9]+", "_", case.name.lower()).strip("_")
        try:
            frames = case.take(bench)
        except Exception:  # the other cases go on
            return _not_made(case, traceback.format_exc())
        begun = perf_counter()
        found, status, message, caught = self._reconstructed(case, frames, place, case.believed(bench.lens))
        seconds = perf_counter() - begun
        correlation = None if found is None else found.truth.get("object_correlation")
        right = correlation if case.group == "perfect" else self._without_error(case)
        verdict = None if found is None else found.verdict
        cause = "" if verdict is None else verdict.cause
        return Result(
            case.name,
            case.group,
            str(case.bench),
            correlation,
            right,
            None if verdict is None else verdict.over_noise,
            None if verdict is None else verdict.held_out_over_noise,
            status,
            cause,
            message,
            caught,
            "" if found is None else found.engine.name,
            None if found is None else found.predicted_error,
            seconds,
            rule_kept(case, status, correlation, right),
            _named(case, status, cause, message),
        )

    def _bench(self, bench: Bench) -> BenchFrames:
        if bench not in self._benches:
            self._benches[bench] = BenchFrames(bench, self._folder)
        return self._benches[bench]

    def _without_error(self, case: Case) -> float | None:
        """Return the correlation of the case without its error."""
        bench = self._bench(case.bench)
        frames = case.healthy(bench)
        key = str((case.bench, case.settings, [hash(frame.counts.tobytes()) for frame in frames]))
        if key not in self._right:
            place = self._folder / "cases" / "without_error"
            found, *_ = self._reconstructed(case, frames, place, bench.lens, stated=False)
            self._right[key] = None if found is None else found.truth.get("object_correlation")
        return self._right[key]

    def _reconstructed(
        self, case: Case, frames: Sequence[Frame], place: Path, lens: Lens, stated: bool = True
    ) -> tuple[FoundObject | None, int, str, tuple[str, ...]]:
        """Return the object, and exit status, message and warnings of the command `wavesim reconstruct`."""
        paths = write_frames(frames, place)
        truth = self._bench(case.bench).truth(case.stop_um)
        given: dict[str, Any] = {"kind": case.bench.kind, "patch_mm": case.bench.patch_mm}
        given |= dict(case.bench.reconstructed) | dict(case.settings)
        verdict = self._verdict if stated else "none"
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found, status, message = None, FAILED, ""
            try:
                read = read_frames(paths, FrameSetSettings(**dict(case.stated if stated else ())), lens=lens)
                settings = ReconstructionSettings(**given)
                found = reconstruct_frames(lens, read, settings, truth=truth, verdict=verdict)
                status = EXPLAINED if found.verdict.explained else NOT_EXPLAINED
                message = found.verdict.words
            except TransferLensError as error:
                status, message = REFUSED, str(error)
            except Exception:  # a traceback is a finding, and no reason to leave out the other cases
                message = traceback.format_exc()
        return found, status, message, tuple(dict.fromkeys(str(one.message) for one in caught))


def _not_made(case: Case, message: str) -> Result:
    """Return the result of a case whose frames cannot be made."""
    made = str(case.bench)
    none = (None, None, None, None)
    return Result(case.name, case.group, made, *none, FAILED, "", message, (), "", None, 0.0, False, None)


def rule_kept(case: Case, status: int, correlation: float | None, right: float | None) -> bool:
    """Return whether a case ends as it may."""
    if case.group == "perfect" or status != EXPLAINED:
        return status == EXPLAINED if case.group == "perfect" else status != FAILED
    return correlation is not None and right is not None and correlation >= right - NEAR


def _named(case: Case, status: int, cause: str, message: str) -> bool | None:
    """Return whether the right cause is named; None where none is asked for."""
    if not case.causes:
        return None
    if status == REFUSED:
        return any(word in message for word in case.causes)
    return cause in case.causes
