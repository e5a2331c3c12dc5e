"""From a design to the object in two calls, without a command or a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lensdesign import load_design, scaled
from lensdesign.errors import InputError
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.scene.settings import Kind
from wavesim.sensor.imaging import Imaged, image

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)


@pytest.fixture(scope="module")
def imaged() -> Imaged:
    return image(LENS, patch_mm=0.05, engine="eikonal", error=0.3, seed=1)


def test_frames_are_reconstructed_as_they_come(imaged: Imaged) -> None:
    calls: list[tuple[str, int, int]] = []
    found = reconstruct_frames(
        LENS,
        imaged.frames,
        patch_mm=0.05,
        kind="amplitude",
        engine="eikonal",
        error=0.3,
        iterations=8,
        truth=imaged.target.transmission,
        progress=lambda *what: calls.append(what),
    )
    correlation = found.truth["object_correlation"]
    assert correlation is not None
    assert correlation > 0.85
    assert found.as_dict()["iterations"] == len(found.curve) == 8
    assert calls[0] == ("object: engine eikonal", 0, 8)
    assert "comparison with the true object" in [what for what, *_ in calls]
    assert "method object, engine eikonal" in repr(found)
    assert "data:image/png;base64," in found._repr_html_()
    assert "engine eikonal" in repr(imaged)
    assert "<table>" in imaged._repr_html_()


def test_an_object_of_one_s_own_is_imaged_as_a_named_one(imaged: Imaged) -> None:
    again = image(LENS, imaged.target.transmission, engine="eikonal", error=0.3, seed=1, field_stop_mm=0.05)
    for one, other in zip(again.frames, imaged.frames, strict=True):
        assert np.array_equal(one.counts, other.counts)
    with pytest.raises(InputError, match="patch_mm, object_pitch_um"):
        image(LENS, imaged.target.transmission, patch_mm=0.05)


def test_settings_that_do_not_go_are_refused_by_name(imaged: Imaged, tmp_path: Path) -> None:
    for changes, message in (
        ({"patch": 0.05}, "patch: Extra inputs"),
        ({"kind": "volume"}, "kind: must be"),
        ({"kind": "phase", "start": "amplitude"}, "start amplitude: cannot be used with kind phase"),
        ({"speckle_na": 0.3}, "speckle_na: requires illumination speckle"),
        ({"speckle_na": 0.0}, "speckle_na: requires illumination speckle"),
        ({"speckle_seed": 1}, "speckle_seed: requires illumination speckle"),
        ({"source_distance_mm": 0.0}, "source_distance_mm: requires illumination point"),
        ({"light_tilt_deg": (0.0, 1.0)}, "light_tilt_deg: requires illumination tilted"),
        ({"waist_mm": 0.0}, "waist_mm: requires illumination gaussian"),
        ({"illumination": "point"}, "illumination point: requires source_distance_mm"),
        ({"start": "model"}, "start: allowed for object: even, amplitude"),
        ({"chart_at_mm": [(0.01, 0.0)]}, "chart_at_mm: requires usaf"),
        ({"waist_mm": 0.01}, "waist_mm: requires illumination gaussian"),
        ({"region_mm": (0.0, 0.0, 0.01, -0.01)}, "region_mm = 0,0,0.01,-0.01: must be finite"),
        ({"method": "paper"}, "method paper: needs frames of at least two planes"),
        ({"method": "paper", "source_deg": 0.1}, "source_deg: cannot be used with method paper"),
        ({"source_deg": 90.0}, "source_deg: must be from 0 to below 90"),
        ({"method": "paper", "bandwidth_nm": 4.0}, "bandwidth_nm: cannot be used with method paper"),
        ({"method": "paper", "hold_out_plane": 1}, "hold_out_plane: cannot be used with method paper"),
        ({"bandwidth_nm": -1.0}, "bandwidth_nm: must be finite and not negative"),
    ):
        with pytest.raises(InputError, match=message):
            reconstruct_frames(LENS, imaged.frames[:1], folder=tmp_path, **{"patch_mm": 0.05} | changes)
    with pytest.raises(InputError, match=r"frames: .*one"):
        reconstruct_frames(LENS, [])
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("quick_verdicts")
def test_one_frame_gives_a_phase_object_and_not_a_complex_one() -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    common: dict[str, Any] = {"patch_mm": 0.06, "engine": "eikonal"}
    taken = image(
        lens, "phase", planes_mm=(0.042,), error=0.02, full_well_electrons=1e5, bits=14, seed=3, **common
    )
    truth = taken.target.transmission
    reached = {
        kind: reconstruct_frames(lens, taken.frames, kind=kind, truth=truth, error=0.05, **common)
        for kind in ("phase", "complex")
    }
    phase, complex_ = (reached[kind].truth["object_correlation"] or 0.0 for kind in ("phase", "complex"))
    assert phase > 0.96
    assert complex_ < phase - 0.03
    found = reached["phase"].transmission.values
    np.testing.assert_allclose(np.abs(found[taken.patch.inside]), 1.0, atol=1e-5)


@pytest.mark.usefixtures("quick_verdicts")
@pytest.mark.parametrize(
    ("object_", "kind", "light", "plain", "enough"),
    [
        ("usaf", "amplitude", {"illumination": "point", "source_distance_mm": 0.15}, 0.97, 0.985),
        ("tissue", "complex", {"illumination": "speckle", "speckle_na": 0.3}, 0.85, 0.95),
    ],
)
def test_one_exposure_suffices_with_light_that_spreads_over_the_sensor(
    object_: str, kind: Kind, light: dict[str, Any], plain: float, enough: float
) -> None:
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    reached = []
    for of_light in ({}, light):
        common: dict[str, Any] = {"patch_mm": 0.06, "engine": "eikonal", **of_light}
        taken = image(lens, object_, planes_mm=(0.042,), error=0.02, full_well_electrons=12_500.0, **common)
        truth = taken.target.transmission
        found = reconstruct_frames(lens, taken.frames, kind=kind, truth=truth, error=0.05, **common)
        reached.append(found.truth["object_correlation"] or 0.0)
    assert reached[0] < plain
    assert reached[1] > enough
