"""The score test of the bench: silent on a bench as stated, sure of a displacement that noise hides."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from plain_searches import search_plainly

from lensdesign import load_design, scaled
from lensdesign.errors import SamplingError
from wavesim.fields.field import Field
from wavesim.reconstruction import assessment
from wavesim.reconstruction.found_object import FoundObject
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import PatchSettings
from wavesim.sensor.imaging import image
from wavesim.targets.patch import lit_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)
SETTINGS = {"patch_mm": 0.05, "engine": "eikonal", "error": 0.1}


@pytest.fixture(scope="module", autouse=True)
def first_objects() -> Iterator[None]:
    """Objects are the solver's first ones: the score test begins at them."""
    with pytest.MonkeyPatch.context() as patch:
        search_plainly(patch)
        yield


@cache
def found(**errors: Any) -> FoundObject:
    """One exposure, of which the second plane is mostly noise: residuals hide what differs."""
    frames = image(LENS, "star", exposures=(1.0,), seed=3, **SETTINGS, **errors).frames
    return reconstruct_frames(LENS, frames, kind="amplitude", iterations=40, **SETTINGS)


def test_a_bench_as_stated_is_explained_with_what_cannot_be_excluded() -> None:
    verdict = found().verdict
    assert verdict.explained, verdict.words
    assert [one.parameter for one in verdict.undetected] == [
        "decenter_x_mm",
        "decenter_y_mm",
        "tilt_x_deg",
        "tilt_y_deg",
        "working_distance_mm",
        "source_deg",
        "bandwidth_nm",
    ]
    assert all(0.0 < one.size < 0.01 for one in verdict.undetected if one.parameter.endswith("_mm"))
    assert all(0.9 < one.correlation <= 1.0 for one in verdict.undetected)
    assert "Not excluded" in verdict.words


@pytest.mark.parametrize(
    ("parameter", "cause"),
    [("decenter_x_mm", "mounting"), ("decenter_y_mm", "mounting"), ("source_deg", "source")],
)
def test_an_error_is_reported_from_the_size_on_that_is_not_excluded(parameter: str, cause: str) -> None:
    size = next(one.size for one in found().verdict.undetected if one.parameter == parameter)
    assert found(**{parameter: 0.7 * size}).verdict.explained
    larger = found(**{parameter: 1.5 * size}).verdict
    assert (larger.explained, larger.cause) == (False, cause), larger.words


def test_noise_on_samples_at_a_bound_is_no_other_bench() -> None:
    """Half of the samples are at each bound, and noise that would lift them beyond it adds up."""
    patch, _ = lit_patch(LENS, PatchSettings(patch_mm=0.05), LENS.wavelengths_um[0])
    y, x = patch.grid.y_mm[:, None], patch.grid.x_mm
    checks = (np.floor(y / 0.00417) + np.floor(x / 0.00417)) % 2
    thing = Field(patch.grid, checks.astype(np.complex64), patch.wavelength_um)
    frames = image(LENS, thing, field_stop_mm=patch.field_stop_mm, seed=0).frames
    settings = SETTINGS | {"patch_mm": 0.05, "kind": "amplitude", "scale": 1.0}
    result = reconstruct_frames(LENS, frames, truth=thing, **settings)
    assert result.truth["object_correlation"] > 0.99
    assert result.verdict.explained, result.verdict.words


def test_a_bench_that_differs_is_not_trusted_although_the_noise_hides_it() -> None:
    verdict = found(decenter_x_mm=0.001, tilt_x_deg=0.3).verdict
    assert verdict.within, verdict.words
    assert (verdict.explained, verdict.cause) == (False, "mounting"), verdict.words
    assert "tilt x +0." in verdict.evidence


def test_a_bench_without_a_control_stays_suspected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where rays or samples do not allow the preferred bench, the score test alone decides."""

    def refuse(*_: Any, **__: Any) -> float:
        raise SamplingError("no ray passes the lens")

    monkeypatch.setattr(assessment, "measured_part", refuse)
    verdict = found.__wrapped__(decenter_x_mm=0.001, tilt_x_deg=0.3).verdict
    assert (verdict.explained, verdict.cause) == (False, "mounting"), verdict.words


@pytest.mark.parametrize("errors", [{"bandwidth_nm": 60.0}, {"source_deg": 0.3}])
def test_light_that_is_broader_or_wider_than_stated_is_not_trusted(errors: dict[str, float]) -> None:
    """Such light blurs the pictures, and a blurred object explains them nearly within the noise.

    After so short an exposure, it is hardly known which of both blurs them.
    """
    verdict = found(**errors).verdict
    assert verdict.within, verdict.words
    assert not verdict.explained, verdict.words
    assert verdict.cause in ("source", "bandwidth")
    assert "--source-deg find" in verdict.words
    assert "--bandwidth-nm find" in verdict.words
