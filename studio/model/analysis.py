"""Analysis of a lens in three stages: rays, pupils, patch."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
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


@dataclass(frozen=True, eq=False)
class LensAnalysis:
    """Results of the analysis of one lens.

    Attributes
    ----------
    lens
        The lens.
    settled
        Whether results have the accuracy of the commands; while a value changes, they are coarser.
    layout, check, pupils, built, patch
        Results of the stages; None (or empty) if they are not available.
    refused
        Reasons why results are not available, one sentence each.
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
    refused: tuple[str, ...] = ()
    seconds: tuple[float, ...] = ()


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
    patch_fraction
        Field height of the patch, as a fraction of the half field.
    """

    lens: Lens
    what_if: WhatIf
    quality: ManufacturingQuality | None
    patch_fraction: float


def rays_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute layout and check."""
    started, lens = time.perf_counter(), request.lens
    refused: list[str] = []
    layout = _tried(lambda: layout_of(lens), refused)
    check = _tried(lambda: check_design(lens, refined=settled), refused)
    return LensAnalysis(
        lens,
        settled,
        layout=layout,
        check=check,
        refused=tuple(refused),
        seconds=(time.perf_counter() - started,),
    )


def waves_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute pupils at three object points, and the prediction as built."""
    started, lens, quality = time.perf_counter(), request.lens, request.quality
    refused: list[str] = []
    samples = SAMPLES if settled else COARSE
    with one_blas_thread():
        what_if, heights = request.what_if.of(lens), field_heights_mm(lens)
        pupils = _tried(lambda: analyse_pupils(lens, what_if, heights, samples), refused)
        as_built = None if quality is None else _tried(lambda: built(lens, quality, settled=settled), refused)
    return LensAnalysis(
        lens,
        settled,
        pupils=pupils or (),
        built=as_built,
        refused=tuple(refused),
        seconds=(time.perf_counter() - started,),
    )


def patch_of(request: AnalysisRequest, *, settled: bool) -> LensAnalysis:
    """Compute the patch."""
    started, lens = time.perf_counter(), request.lens
    refused: list[str] = []
    height, samples = request.patch_fraction * lens.half_field_mm, None if settled else COARSE_PATCH
    with one_blas_thread():
        patch = _tried(lambda: patch_picture(lens, request.what_if.of(lens), height, samples), refused)
    return LensAnalysis(
        lens, settled, patch=patch, refused=tuple(refused), seconds=(time.perf_counter() - started,)
    )


def _tried(compute: Callable[[], Found], refused: list[str]) -> Found | None:
    """Return a result; if it fails, return None and add the reason to `refused`."""
    try:
        return compute()
    except TransferLensError as error:
        refused.append(str(error))
        return None
