"""Deviations of a mounted lens: their files, and how they add up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign import InputError, Lens, Pose
from lensdesign.lens.poses import SurfacePerturbation
from studio.model.whatif import WhatIf, read_what_if
from wavesim import SystemState, read_state, write_state
from wavesim.scene.state_files import state_table

AMOUNTS = st.floats(-0.1, 0.1, allow_subnormal=False)
KEYS = st.sampled_from(
    [
        "lens.decenter_y_mm",
        "lens.tilt_x_deg",
        "lens.despace_mm",
        "surface 2.radius_percent",
        "surface 1.tilt_x_deg",
        "environment.temperature_c",
        "sensor.distance_mm",
    ]
)


def _flat(table: Any, name: str = "") -> dict[str, float]:
    """Return the numbers of a table that are not 0, by their positions."""
    if isinstance(table, dict | list):
        pairs = table.items() if isinstance(table, dict) else enumerate(table)
        return {k: v for key, one in pairs for k, v in _flat(one, f"{name}.{key}").items()}
    return {name: table} if abs(table) > 1e-14 else {}


@settings(max_examples=25, deadline=None)
@given(values=st.dictionaries(KEYS, AMOUNTS.filter(bool), max_size=5))
def test_a_file_brings_the_same_system_back(
    paper_lens: Lens, tmp_path_factory: pytest.TempPathFactory, values: dict[str, float]
) -> None:
    path = tmp_path_factory.mktemp("state") / "state.json"
    what_if = WhatIf(values)
    what_if.write(paper_lens, path)
    again = read_what_if(path, paper_lens)
    written, read = (state_table(one) for one in (read_state(path, paper_lens), again.state(paper_lens)))
    read.pop("wavelength_um", None)  # that of the design
    assert _flat(read) == pytest.approx(_flat(written), rel=1e-9, abs=1e-15)
    assert again.is_active is bool(values)
    if values.keys() <= {"lens.decenter_y_mm", "lens.tilt_x_deg", "lens.despace_mm"}:
        assert again.mounted == SystemState()
    for key in ("lens.decenter_y_mm", "lens.tilt_x_deg", "surface 2.radius_percent"):
        if key in values and "environment.temperature_c" not in values:
            assert again.values[key] == pytest.approx(values[key], rel=1e-12)


def test_sliders_add_to_a_mounted_lens(paper_lens: Lens, tmp_path: Path) -> None:
    mounted = SystemState(
        Pose(decenter_y_mm=0.02, pivot_z_mm=4.0),
        {1: SurfacePerturbation(tilt_x_deg=0.01, radius_mm=0.012)},
        sensor_tilt_deg=(0.2, 0.0),
        plane_distance_errors_mm=(0.01, 0.02),
        vibration_um=0.3,
    )
    write_state(mounted, tmp_path / "state.json")
    loaded = read_what_if(tmp_path / "state.json", paper_lens)
    assert loaded.values == {"surface 2.radius_percent": pytest.approx(-0.1)}
    assert loaded.file == "state.json"
    assert loaded.described(paper_lens)[-1].startswith("state.json (pose, ")
    state = loaded.with_value("lens.decenter_y_mm", 0.01).state(paper_lens)
    assert (state.pose.decenter_y_mm, state.pose.pivot_z_mm) == (pytest.approx(0.03), 4.0)
    assert state.surface_perturbations[1].radius_mm == pytest.approx(0.012)
    assert state.surface_perturbations[1].tilt_x_deg == 0.01
    assert state.sensor_tilt_deg == (0.2, 0.0)
    assert state.plane_distance_errors_mm == pytest.approx((0.01, 0.02))
    assert state.vibration_um == 0.3


def test_only_what_the_lens_has_is_kept(paper_lens: Lens, tmp_path: Path) -> None:
    own = WhatIf({}, SystemState(surface_perturbations={5: SurfacePerturbation(index=1e-3)}))
    assert not own.of(paper_lens).is_active
    path = tmp_path / "state.json"
    write_state(own.mounted, path)
    with pytest.raises(InputError, match="2 surfaces"):
        read_what_if(path, paper_lens)
