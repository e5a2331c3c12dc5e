"""Interrupted searches for a bench: they continue at any step, and find the same bits."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from lensdesign import Lens, load_design, scaled
from wavesim import Calibrated, calibrate_frames, image
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.sensor.frames import Frame

PATCH: dict[str, Any] = {"patch_mm": 0.03, "error": 0.3}
KINDS = ("amplitude", "complex", "phase", "wide source", "empty")
"""Searches with an unknown object of each kind, in light of several modes, and of the light without one."""


@cache
def lens() -> Lens:
    return scaled(load_design("designs/paper_singlet.toml"), 1 / 64)


@cache
def frames(thing: str, source_deg: float) -> tuple[Frame, ...]:
    light: dict[str, Any] = {"source_deg": source_deg} if source_deg else {}
    bench = {"decenter_x_mm": 2e-3, "tilt_y_deg": 0.3}
    made = image(lens(), thing, exposures=(1.0, 30.0), engine="eikonal", **bench, **light, **PATCH)
    return made.frames


def calibrated(kind: str, folder: Path | None) -> Calibrated:
    of_source = {"source_deg": 0.4} if kind == "wide source" else {}
    thing = {"empty": "empty", "phase": "phase", "complex": "tissue"}.get(kind, "star")
    empty = {"empty": frames("empty", 0.0)} if kind == "empty" else {}
    return calibrate_frames(
        lens(),
        frames("star" if kind == "empty" else thing, of_source.get("source_deg", 0.0)),
        parameters="rigid" if kind == "empty" else "mounting,camera",
        kind=kind if kind in ("complex", "phase") else "amplitude",
        most_mountings=9,
        verdict="none",
        folder=folder,
        **empty,
        **of_source,
        **PATCH,
    )


@cache
def uninterrupted(kind: str) -> tuple[Calibrated, int]:
    """What a search without an interrupt finds, and how many states it saves."""
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patched:
        saves, keep = list[Path](), Checkpoint.keep

        def counted(self: Checkpoint, **data: Any) -> None:
            saves.append(self.path)
            keep(self, **data)

        patched.setattr(Checkpoint, "keep", counted)
        return calibrated(kind, Path(folder)), len(saves)


@given(kind=st.sampled_from(KINDS), place=st.floats(0.0, 1.0))
@example(kind="amplitude", place=1.0)
@hypothesis_settings(deadline=None, max_examples=8, phases=[Phase.explicit, Phase.generate])
@pytest.mark.filterwarnings("ignore")
def test_a_search_that_continues_at_any_state_finds_the_same_bits(kind: str, place: float) -> None:
    whole, saves = uninterrupted(kind)
    assert saves > 2
    left, keep = 1 + round(place * (saves - 1)), Checkpoint.keep

    def interrupted(self: Checkpoint, **data: Any) -> None:
        nonlocal left
        keep(self, **data)
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    with TemporaryDirectory() as folder:
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(Checkpoint, "keep", interrupted)
            with pytest.raises(KeyboardInterrupt):
                calibrated(kind, Path(folder))
        found = calibrated(kind, Path(folder))
    assert found.trail == whole.trail
    assert (found.values, found.deviations, found.misfit) == (whole.values, whole.deviations, whole.misfit)
    assert (found.nominal, found.stopped_because) == (whole.nominal, whole.stopped_because)
    assert found.state == whole.state
    if whole.covariance is not None:
        np.testing.assert_array_equal(found.covariance, whole.covariance)
