"""Analysis of a lens in four stages: rays, pupils, patch, and the lens as built."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from lensdesign.analysis.check import check_design
from lensdesign.analysis.report import CheckReport
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.built import AsBuiltPrediction, ManufacturingQuality, built
from studio.model.picture import Layout, field_heights_mm, layout_of
from studio.model.pupils import (
    COARSE,
    COARSE_PATCH,
    SAMPLES,
    PatchPicture,
    PupilAnalysis,
    analyse_pupils,
    patch_picture,
)
from studio.model.whatif import WhatIf
from wavesim.runtime.threads import one_blas_thread

Found = TypeVar("Found")

RESULTS = ("layout", "check", "pupils", "built", "patch")
"""Names of the results of an analysis."""


@dataclass(frozen=True, eq=False)
class LensAnalysis:
    """Results of the analysis of one lens.

    Attributes
    ----------
    lens
        The lens.
    settled
        Whether all results have the accuracy of the commands; while a value changes, they are coarser.
    layout, check, pupils, built, patch
        Results of the stages; None (or empty) if they are not available.
    reasons
        Reasons why results of this lens are not available, by their names. A result with a reason belongs to
        an earlier lens.
    exact
        Names of the results that have this accuracy.
    seconds
        Computing time of each stage in s.
    """

    lens: Lens
    settled: bool = False
    layout: Layout | None = None
    check: CheckReport | None = None
    pupils: tuple[PupilAnalysis, ...] = ()
    built: AsBuiltPrediction | None = None
    patch: PatchPicture | None = None
    reasons: Mapping[str, str] = field(default_factory=dict)
    exact: frozenset[str] = frozenset()
    seconds: tuple[float, ...] = ()

    @property
    def refused(self) -> tuple[str, ...]:
        """Reasons why results are not available, each once."""
        return tuple(dict.fromkeys(self.reasons.values()))

    def updated(self, stage: LensAnalysis, names: tuple[str, ...]) -> LensAnalysis:
        """Return the analysis with the results of a stage.

        A result that the stage has not got stays, with the reason of the stage.

        Parameters
        ----------
        stage
            Results of one stage.
        names
            Names of the results of this stage.
        """
        new = {name: getattr(stage, name) for name in names if name not in stage.reasons}
        kept = {name: why for name, why in self.reasons.items() if name not in names}
        exact = (self.exact - {*names}) | {*(names if stage.settled else ())}
        return replace(
            self,
            lens=stage.lens,
            settled=exact.issuperset(RESULTS),
            exact=exact,
            reasons=kept | dict(stage.reasons),
            seconds=stage.seconds,
            **new,
        )


@dataclass(frozen=True, eq=False)
class AnalysisRequest:
    """Inputs of an analysis.

    Attributes
    ----------
    lens
        The lens.
    what_if
        Its deviations from the design.
    quality
        Tolerances of the prediction; None: no prediction.
    no_quality
        Reason why the chosen tolerances cannot be used; empty if they can, or if none are chosen.
    proceed
        Function that a long stage calls from time to time; it may raise an exception to end the stage.
    patch_fraction
        Field height of the patch, as a fraction of the half field.
    """

    lens: Lens
    what_if: WhatIf
    quality: ManufacturingQuality | None
    patch_fraction: float
    no_quality: str = ""
    proceed: Callable[[], None] = lambda: None


def rays_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute layout and check."""
    started, lens = time.perf_counter(), request.lens
    reasons: dict[str, str] = {}
    layout = _tried("layout", lambda: layout_of(lens), reasons)
    check = _tried("check", lambda: check_design(lens, refined=settled), reasons)
    return LensAnalysis(
        lens,
        settled,
        layout=layout,
        check=check,
        reasons=reasons,
        seconds=(time.perf_counter() - started,),
    )


def waves_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute pupils at three object points."""
    started, lens = time.perf_counter(), request.lens
    reasons: dict[str, str] = {}
    samples = SAMPLES if settled else COARSE
    with one_blas_thread():
        what_if, heights = request.what_if.of(lens), field_heights_mm(lens)
        pupils = _tried("pupils", lambda: analyse_pupils(lens, what_if, heights, samples), reasons)
    return LensAnalysis(
        lens, settled, pupils=pupils or (), reasons=reasons, seconds=(time.perf_counter() - started,)
    )


def built_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute the prediction as built."""
    started, lens, quality = time.perf_counter(), request.lens, request.quality
    reasons: dict[str, str] = {"built": request.no_quality} if request.no_quality else {}
    found = None
    with one_blas_thread():
        if quality is not None:
            predict = partial(built, lens, quality, settled=settled, proceed=request.proceed)
            found = _tried("built", predict, reasons)
    return LensAnalysis(lens, settled, built=found, reasons=reasons, seconds=(time.perf_counter() - started,))


def patch_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute the patch."""
    started, lens = time.perf_counter(), request.lens
    reasons: dict[str, str] = {}
    height, samples = request.patch_fraction * lens.half_field_mm, None if settled else COARSE_PATCH
    with one_blas_thread():
        patch = _tried(
            "patch", lambda: patch_picture(lens, request.what_if.of(lens), height, samples), reasons
        )
    return LensAnalysis(lens, settled, patch=patch, reasons=reasons, seconds=(time.perf_counter() - started,))


STAGES: tuple[tuple[Callable[..., LensAnalysis], tuple[str, ...]], ...] = (
    (rays_of, ("layout", "check")),
    (waves_of, ("pupils",)),
    (patch_of, ("patch",)),
    (built_of, ("built",)),
)
"""Stages of an analysis, and the names of their results; the longest comes last."""


def _tried(name: str, compute: Callable[[], Found], reasons: dict[str, str]) -> Found | None:
    """Return a result; if it fails, return None and add the reason."""
    try:
        return compute()
    except TransferLensError as error:
        reasons[name] = str(error)
        return None
