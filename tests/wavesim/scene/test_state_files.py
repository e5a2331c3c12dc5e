"""JSON form of a system state: every state is read as it was written, and what is not a state is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import load_design
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface_figure import surface_figure_from_zernike
from wavesim import read_state, write_state
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.source import Source
from wavesim.scene.state_files import state_from_table, state_table
from wavesim.scene.system_state import AS_DESIGNED, SystemState

LENS = load_design("designs/paper_singlet.toml")

lengths = st.floats(-1.0, 1.0)
pairs = st.tuples(lengths, lengths)
triples = st.tuples(lengths, lengths, lengths)
modes = st.dictionaries(st.sampled_from([(1, 0), (0, 2), (3, 1)]), st.floats(-0.2, 0.2))
fractions = st.lists(st.floats(0.0, 0.9), max_size=3).map(tuple)
surfaces = st.dictionaries(
    st.sampled_from([0, 1]),
    st.builds(
        SurfacePerturbation,
        tilt_x_deg=lengths,
        radius_mm=lengths,
        index=lengths,
        coating_thickness_percent=lengths,
        roughness_rms_nm=lengths,
        shape=st.dictionaries(st.just("radius_x_mm"), lengths),
    ),
)
states = st.builds(
    SystemState,
    pose=st.builds(Pose, lengths, lengths, lengths, lengths, lengths, lengths),
    surface_perturbations=surfaces,
    object_shift_mm=triples,
    sensor_shift_mm=triples,
    plane_distance_errors_mm=st.lists(lengths, max_size=3).map(tuple),
    sensor_tilt_deg=pairs,
    wavelength_um=st.none() | st.floats(0.4, 0.7),
    light=st.builds(LightErrors, pairs, modes, modes),
    plane_shifts_um=st.lists(pairs, max_size=3).map(tuple),
    plane_backgrounds=fractions,
    plane_background_slopes=st.lists(pairs, max_size=3).map(tuple),
    plane_exposure_errors=st.lists(st.floats(-0.5, 0.5), max_size=3).map(tuple),
    nonlinearity=st.floats(-0.4, 0.4),
    vibration_um=st.floats(0.0, 5.0),
    source=st.builds(Source, st.floats(0.0, 5.0), st.floats(0.0, 50.0)),
)


@given(states)
def test_a_state_is_read_as_it_was_written(state: SystemState) -> None:
    table = json.loads(json.dumps(state_table(state)))
    assert state_from_table(table, "state.json", LENS) == state


def test_files_of_earlier_versions_keep_their_distances() -> None:
    """There, the error of a plane replaced the z component of the sensor's shift."""
    table = {"sensor_shift_mm": [0.0, 0.0, 0.02], "plane_distance_errors_mm": [0.01]}
    state = state_from_table(table, "state.json", LENS)
    found = [state.sensor_pose(plane).distance_mm for plane in range(2)]
    assert found == pytest.approx([0.01, 0.02], abs=1e-15)
    again = state_from_table(json.loads(json.dumps(state_table(state))), "state.json", LENS)
    assert again == state


def test_a_figure_is_read_as_it_was_written(tmp_path: Path) -> None:
    figure = surface_figure_from_zernike({5: 0.03, 8: -0.02}, 5.0)
    state = SystemState(surface_perturbations={1: SurfacePerturbation(conic=0.1, figure=figure)})
    read = read_state(write_state(state, tmp_path / "state.json"), LENS).surface_perturbations[1]
    assert read.conic == 0.1
    assert read.figure is not None
    assert (read.figure.semi_diameter_mm, read.figure.spacing_mm) == (5.0, figure.spacing_mm)
    np.testing.assert_array_equal(read.figure.coefficients, figure.coefficients)


def test_a_system_as_designed_is_an_empty_table() -> None:
    assert state_table(AS_DESIGNED) == {}
    assert state_from_table({}, "state.json", LENS) == AS_DESIGNED


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ({"pose": {"decenter_x": 0.1}}, "decenter_x"),
        ({"surfaces": {"3": {"radius_mm": 0.1}}}, "2 surfaces"),
        ({"surfaces": {"0": {"radius_mm": 0.1}}}, "surfaces"),
        ({"sensor_shift_mm": [0.0, 1.0]}, "sensor_shift_mm"),
        ({"plane_backgrounds": [1.5]}, "plane_backgrounds"),
        ({"light": {"amplitude": {"1": 0.1}}}, "amplitude"),
        ({"light": {"amplitude": {"00": 0.1}}}, "amplitude"),
        ({"source": {"width_deg": -1.0}}, "width_deg"),
        ({"wavelength_um": 0.0}, "wavelength_um"),
        ({"surfaces": {"1": {"figure": {"semi_diameter_mm": 1.0, "spacing_mm": 0.1}}}}, "coefficients_mm"),
    ],
)
def test_what_is_not_a_state_is_refused_by_name(table: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named) as caught:
        state_from_table(table, "bench.json", LENS)
    assert "bench.json" in str(caught.value)


def test_a_file_without_a_state_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.json"
    for text, named in (("{}", "no state"), ("[1]", "object"), ("{", "JSON")):
        path.write_text(text)
        with pytest.raises(InputError, match=named):
            read_state(path, LENS)


def test_trials_have_no_single_state() -> None:
    many = np.array([0.1, 0.2])
    for state in (
        SystemState(Pose(decenter_x_mm=many)),
        SystemState(surface_perturbations={0: SurfacePerturbation(radius_mm=many)}),
    ):
        with pytest.raises(InputError, match="trials"):
            state_table(state)
