"""The command `wavesim check-engine`, end to end."""

import json

import pytest
from programs import Command

from lensdesign.errors import InputError
from wavesim.scene.settings import SingleEngineDetails


def test_json_holds_error_cost_and_settings(wavesim: Command) -> None:
    code, out, _ = wavesim(
        "check-engine", "--engine", "thin-lens", "--radius-mm", "0.05", "--pitch-um", "0.2", "--json"
    )
    assert code == 0
    data = json.loads(out)
    assert (data["engine"], data["solution"], data["radius_mm"]) == ("thin-lens", "cylinder", 0.05)
    assert data["settings"]["pitch_mm"] == pytest.approx(2e-4)
    assert 0.01 < data["relative_error"] < 1.0
    assert data["seconds"] > 0.0
    assert data["setup_seconds"] >= 0.0
    assert data["peak_mb"] > 0.0
    assert set(data["predicted"]) == {"seconds", "setup_seconds", "peak_mb"}


def test_table_for_people(wavesim: Command) -> None:
    code, out, _ = wavesim("check-engine", "--engine", "no-lens", "--solution", "beam")
    assert code == 0
    for text in ("no-lens on the exact beam", "relative error", "measured", "predicted", "peak memory (MB)"):
        assert text in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--engine", "wmp"), "engine = 'wmp': there is no such engine"),
        (("--engine", "no-lens", "--solution", "cube"), "solution = 'cube': there is no such solution"),
        (("--engine", "no-lens", "--slices", "3"), "engine no-lens: slices = 3: there is no such setting"),
        (("--engine", "no-lens", "--radius-mm", "nan"), "radius_mm = nan"),
        (
            ("--engine", "no-lens", "--radius-mm", "1e-3"),
            "radius_mm = 0.001: must be at least 15 wavelengths",
        ),
        (("--engine", "no-lens", "--solution", "plane", "--radius-mm", "1"), "there is no such argument"),
        (("--engine", "no-lens", "--solution", "plane", "--incidence-deg", "88"), "incidence_deg = 88"),
        (
            ("--engine", "no-lens", "--solution", "stigmatic", "--semi-diameter-mm", "0"),
            "semi_diameter_mm = 0",
        ),
        (("--engine", "thin-lens", "--pitch-um", "-1"), "--pitch-um = -1: must be finite and greater than 0"),
    ],
)
def test_bad_input_is_one_message_and_status_two(
    wavesim: Command, arguments: tuple[str, ...], message: str
) -> None:
    code, out, err = wavesim("check-engine", *arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in err


def test_settings_are_those_given_in_the_engines_words() -> None:
    given = SingleEngineDetails(slices=30, compensation="oblique", step_um=0.5, pitch_um=0.25)
    assert given.details() == {"slices": 30, "compensation": "oblique", "step_um": 0.5, "pitch_mm": 2.5e-4}
    with pytest.raises(InputError, match=r"tile_width_mm: .*finite"):
        SingleEngineDetails().replaced(tile_width_mm=float("nan"))
