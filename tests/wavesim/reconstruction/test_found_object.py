"""What is found behind frames, and its figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lensdesign import load_design, scaled
from wavesim.cli.reconstruct import _summary_lines
from wavesim.fields.field import Field
from wavesim.reconstruction.frame_reconstruction import reconstruct_frames
from wavesim.sensor.imaging import image
from wavesim.targets.patch import object_patch, usaf_elements_of
from wavesim.targets.usaf import usaf_chart

LENS = scaled(load_design("designs/paper_singlet.toml"), 1 / 32)


@pytest.mark.parametrize("samples", [(0.0, 0.0), (2.0, -1.0)])
@pytest.mark.usefixtures("quick_verdicts")
def test_a_chart_beside_its_place_is_resolved_as_well(samples) -> None:
    patch = object_patch(LENS, 0.07)
    elements = usaf_elements_of(patch)
    dx, dy = (one * patch.grid.pitch_mm for one in samples)
    there = [replace(one, centre_mm=(one.centre_mm[0] + dx, one.centre_mm[1] + dy)) for one in elements]

    def chart(placed) -> Field:
        values = usaf_chart(patch.grid, placed, "bright").astype(np.complex64)
        return Field(patch.grid, values, patch.wavelength_um)

    taken = image(LENS, chart(there), exposures=(1.0, 30.0), seed=2)
    found = reconstruct_frames(
        LENS, taken.frames, patch_mm=0.07, kind="amplitude", truth=chart(elements), usaf="bright"
    )
    figures = found.as_dict()
    chart_figures = figures["usaf"]
    assert chart_figures["smallest_resolved"]["line_width_um"] == pytest.approx(0.87, abs=0.01)
    assert chart_figures["limited_by"] == ["sampling"]
    assert chart_figures["displacement"]["x_samples"] == pytest.approx(samples[0], abs=0.06)
    assert chart_figures["displacement"]["y_samples"] == pytest.approx(samples[1], abs=0.06)
    pitch_um = 1e3 * patch.grid.pitch_mm
    truth = figures["truth"]
    assert truth["displacement_x_um"] / pitch_um == pytest.approx(samples[0], abs=0.06)
    assert truth["correlation_registered"] > 0.97
    lines = _summary_lines(figures)
    assert "resolved down to group 9, element 2: lines of 0.87 µm" in lines
    assert any("limit: samples of 0.426 µm" in line for line in lines)
    said = [line for line in lines if "displaced by" in line]
    assert len(said) == (2 if any(samples) else 0)
    if any(samples):
        assert truth["object_correlation"] < 0.7
