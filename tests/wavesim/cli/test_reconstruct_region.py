"""`wavesim reconstruct` of which a region of the object is judged and written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import Command
from wavesim_command import ENDED, written

from lensdesign.errors import InputError
from wavesim.cli.view import _field
from wavesim.fields.files import read_centre_um

REGION = "0.0083,0.0085,0.012,0.016"
"""Holds the two elements of the chart."""


def part_like(whole: dict[str, Any], part: dict[str, Any]) -> Any:
    """The samples of a whole patch where those of a region are."""
    pitch_mm, found = 1e-3 * float(whole["pitch_um"]), []
    for size, count, centre in zip(
        whole["values"].shape, part["values"].shape, (part["centre_y_mm"], part["centre_x_mm"]), strict=True
    ):
        first = float(centre) / pitch_mm + 0.5 * (size - count)
        assert first == pytest.approx(round(first), abs=1e-3)
        found.append(slice(round(first), round(first) + count))
    return whole["values"][tuple(found)]


@pytest.mark.usefixtures("quick_verdicts")
def test_of_a_region_of_the_object_alone_is_told_and_written(
    run: Command, tmp_path: Path, data: Path
) -> None:
    usual = ("--engine", "eikonal", "--kind", "amplitude", "--iterations", 12, "--truth", data)
    usual = (*usual, "--usaf", "bright")
    assert run(*usual, "-o", tmp_path / "whole")[0] in ENDED
    code, out, err = run(*usual, "--region-mm", REGION, "-o", tmp_path / "part")
    assert code in ENDED, err
    (_, whole), (result, part) = written(tmp_path / "whole"), written(tmp_path / "part")
    np.testing.assert_array_equal(part["values"], part_like(whole, part))
    assert min(part["values"].shape) < 45
    assert result["region_mm"][:2] == pytest.approx([0.0083, 0.0085], abs=4e-4)
    assert result["truth"]["object_correlation"] > 0.97
    assert result["usaf"]["smallest_resolved"]["element"] == 2
    assert "region of the object: 0.01" in out
    # A view tells true coordinates, of a part of the region too.
    layer = _field(tmp_path / "part" / "reconstruction.npz", "", None)[0]
    assert layer.centre_um == pytest.approx((8.3, 8.5), abs=0.4)
    smaller = _field(tmp_path / "part" / "reconstruction.npz", "", [0.0083, 0.0085, 0.005, 0.005])[0]
    assert smaller.centre_um == pytest.approx((8.3, 8.5), abs=0.4)
    beside = ("--iterations", 1, "--usaf", "bright", "--region-mm=-0.01,0,0.008,0.01")
    code, out, _ = run(*usual[:4], *beside, "-o", tmp_path / "beside")
    assert code in ENDED
    assert "no element of the chart lies within the region" in out


def test_where_a_field_lies_must_be_told_in_numbers_and_truth_be_about_the_axis(
    run: Command, tmp_path: Path
) -> None:
    path, values = tmp_path / "field.npz", np.ones((200, 200), np.complex64)
    for centre, message in (([1.0, 2.0], "must be one number"), (np.nan, "and finite")):
        np.savez(path, values=values, pitch_um=0.4256, centre_x_mm=centre)
        with pytest.raises(InputError, match=message):
            read_centre_um(path)
    np.savez(path, values=values, pitch_um=0.4256, centre_x_mm=0.5, centre_y_mm=-0.25)
    assert read_centre_um(path) == (500.0, -250.0)
    code, _, err = run("--engine", "eikonal", "--truth", path, "-o", tmp_path / "out")
    assert code == 2
    assert "is centred at 0.5, -0.25 mm" in err


def test_the_paper_s_way_carries_back_to_a_region_alone(run: Command, tmp_path: Path, data: Path) -> None:
    usual = ("--engine", "eikonal", "--method", "paper", "--iterations", 40, "--refocus-mm=-0.002,0.002")
    assert run(*usual, "-o", tmp_path / "whole")[0] in ENDED
    code, _, err = run(*usual, "--region-mm", REGION, "--truth", data, "-o", tmp_path / "part")
    assert code in ENDED, err
    (_, whole), (result, part) = written(tmp_path / "whole"), written(tmp_path / "part")
    one, other = part["values"].ravel(), part_like(whole, part).ravel()
    assert abs(np.vdot(one, other)) > 0.97 * np.linalg.norm(one) * np.linalg.norm(other)
    assert result["truth"]["object_correlation"] > 0.4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--region-mm", "0,0,1"), "--region-mm = '0,0,1': must be 4 numbers"),
        (("--region-mm", "0,0,0.01,-0.01"), "--region-mm = 0,0,0.01,-0.01: must be finite, and the sides"),
        (("--region-mm", "0.02,0,0.02,0.01"), "--region-mm = 0.02,0,0.02,0.01: reaches beyond the samples"),
        (("--region-mm", "0,0,0.001,0.01"), "at least 16 x 16"),
        (("--region-mm", "0.01945,0.01945,0.007,0.007"), "lies outside the field stop"),
    ],
)
def test_bad_options_are_one_message_status_two_and_nothing_written(
    run: Command, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    code, out, err = run("--engine", "eikonal", *options, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()
