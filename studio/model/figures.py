"""All figures of a lens, in stages: what rays tell, what pupils tell, the patch."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from lensdesign.analysis.check import check_design
from lensdesign.analysis.report import CheckReport
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from studio.model.built import AsBuiltFigures, ManufacturingQuality, built
from studio.model.picture import Layout, heights_of, layout_of
from studio.model.pupils import (
    COARSE,
    COARSE_PATCH,
    SAMPLES,
    PatchPicture,
    PupilFigures,
    patch_picture,
    pupil_figures,
)
from studio.model.whatif import WhatIf
from wavesim.runtime.threads import one_blas_thread

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of one lens.

    Attributes
    ----------
    lens
        The lens.
    settled
        Whether they are those of the commands; while a value moves, coarser ones stand for them.
    layout, check, pupils, built, patch
        None where they are not had yet, or cannot be.
    refused
        Why not, a sentence each.
    seconds
        That each stage took.
    """

    lens: Lens
    settled: bool = False
    layout: Layout | None = None
    check: CheckReport | None = None
    pupils: tuple[PupilFigures, ...] = ()
    built: AsBuiltFigures | None = None
    patch: PatchPicture | None = None
    refused: tuple[str, ...] = ()
    seconds: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class FigureRequest:
    """What figures are asked for.

    Attributes
    ----------
    lens
        The lens.
    what_if
        How far it is off.
    made
        By what tolerances; None for no prediction.
    patch_share
        Height of the patch's object point, as a share of the half field.
    """

    lens: Lens
    what_if: WhatIf
    made: ManufacturingQuality | None
    patch_share: float


def rays_of(asked: FigureRequest, *, settled: bool) -> Figures:
    """Layout, and what the check tells."""
    began, lens = time.perf_counter(), asked.lens
    refused: list[str] = []
    layout = _tried(lambda: layout_of(lens), refused)
    check = _tried(lambda: check_design(lens, refined=settled), refused)
    return Figures(
        lens,
        settled,
        layout=layout,
        check=check,
        refused=tuple(refused),
        seconds=(time.perf_counter() - began,),
    )


def waves_of(asked: FigureRequest, *, settled: bool) -> Figures:
    """Pupils at three object points, and what is predicted as built."""
    began, lens, made = time.perf_counter(), asked.lens, asked.made
    refused: list[str] = []
    samples = SAMPLES if settled else COARSE
    with one_blas_thread():
        what_if, heights = asked.what_if.of(lens), heights_of(lens)
        pupils = _tried(lambda: pupil_figures(lens, what_if, heights, samples), refused)
        as_built = None if made is None else _tried(lambda: built(lens, made, settled=settled), refused)
    return Figures(
        lens,
        settled,
        pupils=pupils or (),
        built=as_built,
        refused=tuple(refused),
        seconds=(time.perf_counter() - began,),
    )


def patch_of(asked: FigureRequest, *, settled: bool) -> Figures:
    """The patch."""
    began, lens = time.perf_counter(), asked.lens
    refused: list[str] = []
    height, samples = asked.patch_share * lens.half_field_mm, None if settled else COARSE_PATCH
    with one_blas_thread():
        patch = _tried(lambda: patch_picture(lens, asked.what_if.of(lens), height, samples), refused)
    return Figures(lens, settled, patch=patch, refused=tuple(refused), seconds=(time.perf_counter() - began,))


def _tried(figure: Callable[[], Found], refused: list[str]) -> Found | None:
    """A figure, or None and a sentence why not."""
    try:
        return figure()
    except TransferLensError as error:
        refused.append(str(error))
        return None
