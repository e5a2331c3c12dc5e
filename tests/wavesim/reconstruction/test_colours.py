"""Objects at several wavelengths from frames, in turn, at once and behind a mosaic; and heights."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from lensdesign.lens.surface_roughness import SurfaceRoughness
from wavesim.fields.field import Field
from wavesim.reconstruction import resumable
from wavesim.reconstruction.colours import FilmProjection, FoundColours, reconstruct_colours
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.reconstruction.heights import wave_numbers
from wavesim.runtime.checkpoint import drop_series
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import Imaged, image
from wavesim.targets.colours import film
from wavesim.targets.patch import make_target, object_patch

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
PAIR, PATCH_MM = (0.532, 0.635), 0.02
TAKEN: dict[str, Any] = {
    "engine": "eikonal",
    "error": 0.02,
    "exposures": (1.0, 30.0, 1000.0),
    "field_stop_mm": PATCH_MM,
    "planes_mm": (0.03, 0.13, 0.23),
}
FOUND: dict[str, Any] = {"engine": "eikonal", "error": 0.05, "patch_mm": PATCH_MM}
PATCH = object_patch(LENS, PATCH_MM, wavelength_um=min(PAIR))


def objects() -> list[Field]:
    """Tissue, another one at each wavelength."""
    made = [make_target(PATCH, "tissue", numerical_aperture=0.5, seed=n).transmission for n in (1, 2)]
    return [
        Field(PATCH.grid, np.abs(one.values).astype(np.complex64), wavelength)
        for one, wavelength in zip(made, PAIR, strict=True)
    ]


@cache
def taken_at_once(filters: str) -> Imaged:
    return image(LENS, objects(), wavelengths_um=PAIR, colour_filters=filters, **TAKEN)


def correlations(found: FoundColours) -> list[float]:
    return [one["object_correlation"] or 0.0 for one in found.truth]


@pytest.mark.parametrize("filters", ["monochrome", "bayer"])
def test_two_objects_are_told_apart_by_their_wavelengths(filters: str) -> None:
    taken = taken_at_once(filters)
    assert taken.frames[0].settings.wavelengths_um == PAIR
    found = reconstruct_colours(
        LENS, taken.frames, kind="amplitude", iterations=60, truth=taken.coloured, **FOUND
    )
    assert min(correlations(found)) > 0.95
    assert found.oversampling.ratio > 1.0
    assert found.planes[0].wavelengths_um == PAIR
    assert found.planes[0].is_mosaic == (filters == "bayer")
    one, other = (np.abs(field.values) for field in found.transmissions)
    inside = found.patch.inside
    exchanged = np.corrcoef(one[inside], np.abs(taken.coloured[1].values)[inside])[0, 1]
    assert abs(exchanged) < 0.4
    summary = found.as_dict()
    assert summary["explained"]
    assert found.over_noise < 1.3
    assert 0.7 < found.held_out_over_noise < 1.5
    assert len(summary["planes"]) == 3
    assert "correlation at 0.635" in repr(found)
    unknown = replace(found, truth=({"object_correlation": None},) * 2)
    assert "correlation at 0.635 µm none" in repr(unknown)
    assert "<table>" in found._repr_html_()
    assert np.isfinite(other).all()


def test_held_out_pixels_contradict_a_wrong_object_that_noise_explains() -> None:
    """With few photons in fine detail, the fitted pixels alone would not show the errors of the object."""
    patch: dict[str, Any] = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    light: dict[str, Any] = {"wavelengths_um": (0.45, 0.635), "colour_filters": "bayer"}
    taken = image(LENS, "star", planes_mm=(0.03, 0.2), exposures=(1.0, 30.0), **light, **patch)
    wrong, right = (
        reconstruct_colours(LENS, taken.frames, kind="amplitude", scale=scale, truth=taken.coloured, **patch)
        for scale in (None, 1.0)
    )
    assert min(correlations(wrong)) < 0.85 < 0.94 < min(correlations(right))
    assert wrong.over_noise < 1.05
    assert wrong.explained
    assert not wrong.predicts_held_out
    assert right.predicts_held_out


def test_wavelengths_in_turn_are_found_as_each_alone() -> None:
    frames = list[Frame]()
    for index, one in enumerate(objects()):
        frames += image(LENS, one, seed=index, pixels=104, **TAKEN).frames
    found = reconstruct_colours(
        LENS, frames, kind="amplitude", iterations=30, scale=1.0, truth=objects(), **FOUND
    )
    assert min(correlations(found)) > 0.97
    assert [plane.wavelengths_um for plane in found.planes] == [(0.532,)] * 3 + [(0.635,)] * 3
    pitch_um = 1e3 * PATCH.grid.pitch_mm
    alone = reconstruct_frames(
        LENS,
        [frame for frame in frames if frame.settings.wavelength_um == PAIR[1]],
        kind="amplitude",
        iterations=30,
        scale=1.0,
        object_pitch_um=pitch_um,
        **FOUND,
    )
    inside = found.patch.inside
    pair = [np.abs(one.values)[inside] for one in (found.transmissions[1], alone.transmission)]
    assert np.corrcoef(*pair)[0, 1] > 0.99


def step_frames(height_um: float) -> list[Frame]:
    """Frames of a film with one step, at one wavelength after the other."""
    x, y = PATCH.grid.x_mm[None, :], PATCH.grid.y_mm[:, None]
    shape = Field(PATCH.grid, ((abs(x - 0.002) < 0.003) & (abs(y) < 0.004)).astype(float), PAIR[0])
    frames = list[Frame]()
    for index, wavelength in enumerate(PAIR):
        object_ = film(shape, height_um, 1.5, wavelength)
        frames += image(LENS, object_, seed=index, pixels=104, **TAKEN).frames
    return frames


@pytest.mark.parametrize(("kind", "height_um"), [("complex", 0.3), ("thickness", 2.3)])
def test_a_step_is_measured_with_its_deviation(kind: str, height_um: float) -> None:
    """One step of a part of a wave, and one of more than two waves."""
    found = reconstruct_colours(
        LENS,
        step_frames(height_um),
        kind=kind,
        film_index=1.5,
        heights_um=(-1.0, 3.0),
        repeats=4,
        iterations=60,
        **FOUND,
    )
    assert found.heights is not None
    step = found.height_between((0.002, 0.0, 0.004, 0.006), (-0.005, 0.0, 0.004, 0.006))
    assert step.height_um == pytest.approx(height_um, abs=0.005)
    assert 1e-5 < step.deviation_um < 0.01
    assert abs(step.height_um - height_um) < 4.0 * step.deviation_um
    assert not step.ambiguous
    summary = found.as_dict()["heights"]
    assert summary["ambiguous_fraction"] < 0.1
    assert summary["repeats"] == 4
    with pytest.raises(InputError, match="contains no samples"):
        found.height_between((1.0, 0.0, 0.001, 0.001), (0.0, 0.0, 0.001, 0.001))


def test_a_film_is_projected_on_itself() -> None:
    rng = np.random.default_rng(0)
    height, amplitude = rng.uniform(0.0, 2.0, (6, 6)), rng.uniform(0.5, 1.0, (6, 6))
    numbers = wave_numbers(PAIR, 1.5)
    values = amplitude * np.exp(1j * numbers[:, None, None] * height)
    project = FilmProjection(numbers, height + rng.uniform(-0.1, 0.1, (6, 6)))
    assert project(values) == pytest.approx(values)
    assert project.height_um == pytest.approx(height)


def test_wrong_frames_and_settings_are_named() -> None:
    frames = taken_at_once("monochrome").frames[:1]
    (frame,) = frames
    one_colour = Frame(frame.counts, frame.settings.replaced(colours=None))
    smaller = Frame(frame.counts[:-2], frame.settings)
    for chosen, changes, message in (
        ([], {}, "needs at least one frame"),
        ([one_colour], {}, "two or more wavelengths"),
        ([frame, smaller], {}, "the same size"),
        (frames, {"kind": "thickness"}, "kind thickness: requires film_index"),
        (frames, {"kind": "amplitude", "film_index": 1.5}, "cannot be used with kind amplitude"),
        (frames, {"ground_mm": (0.0, 0.0, 1.0, 1.0)}, "ground_mm: requires film_index"),
        (frames, {"heights_um": (0.0, 1.0)}, "heights_um: requires film_index"),
        (frames, {"film_index": 1.5, "heights_um": (1.0, 0.0)}, "two increasing numbers"),
        (frames, {"tv_weight": -1.0}, "not negative"),
    ):
        with pytest.raises(InputError, match=message):
            reconstruct_colours(LENS, chosen, **FOUND, **changes)
    with pytest.raises(InputError, match=r"0\.532, 0\.635 µm were recorded at once"):
        reconstruct_frames(LENS, frames, **FOUND)
    truth = [replace(one, wavelength_um=0.5) for one in objects()]
    with pytest.raises(InputError, match=r"needs the object at 0\.532 um"):
        reconstruct_colours(LENS, chosen, kind="amplitude", truth=truth, progress=no_search, **FOUND)


def no_search(stage: str, _completed: int, _total: int) -> None:
    """Fail as soon as a search makes progress."""
    pytest.fail(f"the search began: {stage}")


def test_inputs_are_checked_before_the_search() -> None:
    (frame,) = taken_at_once("monochrome").frames[:1]
    assert frame.settings.colours is not None
    nearly = frame.settings.colours.replaced(wavelengths_um=(0.532, 0.53201))
    similar = frame.settings.colours.replaced(wavelengths_um=(0.532, 0.5322))
    rough = LENS.with_surface(1, roughness=SurfaceRoughness(rms_nm=2.0, correlation_length_um=2.0))
    for lens, colours, changes, message in (
        (LENS, nearly, {}, "0.532 and 0.53201 um: wavelengths must be equal, or differ"),
        (LENS, similar, {"film_index": 1.5}, "contain .* orders .* wavelengths that differ more"),
        (LENS, None, {"film_index": 1.5, "heights_um": (0.0, 5000.0)}, "at most 2000 are allowed"),
        (LENS, None, {"film_index": 1.5, "ground_mm": (1.0, 0.0, 0.1, 0.1)}, "ground_mm .* no samples"),
        (LENS, None, {"truth": Path("missing")}, "has no object at 0.532 um"),
        (rough, None, {}, "surface 2 is rough"),
    ):
        settings = frame.settings if colours is None else frame.settings.replaced(colours=colours)
        with pytest.raises(InputError, match=message):
            reconstruct_colours(lens, [Frame(frame.counts, settings)], progress=no_search, **FOUND, **changes)


@cache
def uninterrupted_run(kind: str) -> tuple[FoundColours, int]:
    """What a run without an interrupt finds, and how often it reports progress."""
    reports = list[str]()
    found = reconstruct_colours(
        LENS, taken_at_once("bayer").frames, progress=lambda stage, *_: reports.append(stage), **of_kind(kind)
    )
    return found, len(reports)


def of_kind(kind: str) -> dict[str, Any]:
    film_of = {"film_index": 1.5, "repeats": 2, "heights_um": (0.0, 1.0)} if kind == "thickness" else {}
    return {"kind": kind, "iterations": 6, **film_of, **FOUND}


@given(kind=st.sampled_from(["amplitude", "complex", "thickness"]), place=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=8)
def test_a_run_that_continues_after_an_interrupt_finds_the_same_bits(kind: str, place: float) -> None:
    whole, reports = uninterrupted_run(kind)
    left = 1 + round(place * (reports - 2))

    def interrupt(*_: object) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            raise KeyboardInterrupt

    with TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patched:
        patched.setattr(resumable, "SAVE_INTERVAL_S", 0.0)
        given: dict[str, Any] = {"folder": Path(name), **of_kind(kind)}
        frames, repeated = taken_at_once("bayer").frames, list[str]()
        with pytest.raises(KeyboardInterrupt):
            reconstruct_colours(LENS, frames, progress=interrupt, **given)
        found = reconstruct_colours(LENS, frames, progress=lambda stage, *_: repeated.append(stage), **given)
        assert len(repeated) <= reports - max(0, round(place * (reports - 2)) - 1)
        drop_series(Path(name))
        assert not list(Path(name).iterdir())
    for one, other in zip(found.transmissions, whole.transmissions, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
    assert (found.misfit, found.scale) == (whole.misfit, whole.scale)
    for one, other in zip(found.residual_maps, whole.residual_maps, strict=True):
        np.testing.assert_array_equal(one, other)
    if whole.heights is not None and found.heights is not None:
        np.testing.assert_array_equal(found.heights.height_um, whole.heights.height_um)
        np.testing.assert_array_equal(found.heights.deviation_um, whole.heights.deviation_um)
