"""Options that settings models make."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from lensdesign.errors import InputError
from wavesim.cli.options import numbers, with_settings
from wavesim.scene.settings import CameraSettings
from wavesim.sensor import Electronics


@pytest.mark.parametrize("option", ["--fill-factor", "--active-width"])
def test_former_names_of_options_are_accepted(option: str) -> None:
    found: list[CameraSettings] = []

    def command(camera: CameraSettings) -> None:
        found.append(camera)

    app = typer.Typer()
    app.command()(with_settings(command))
    result = CliRunner().invoke(app, [option, "0.5"])
    assert result.exit_code == 0, result.output
    assert found[0].fill_factor == 0.5


def test_former_names_of_settings_are_accepted() -> None:
    assert CameraSettings(**{"active_width": 0.5, "brightest_share": 0.4}).peak_fill == 0.4
    assert Electronics(**{"active_width": 0.5}).fill_factor == 0.5


@pytest.mark.parametrize("text", ["nan", "inf", "", "1,2", "seek"])
def test_a_number_or_a_word_is_named(text: str) -> None:
    with pytest.raises(InputError, match=r"--bandwidth-nm = .*: must be a finite number or find"):
        numbers(text, "--bandwidth-nm", 1, ("find",))
