"""Finite numbers with which nothing can be computed, and numbers that set the size of arrays."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from places import DESIGNS
from tests_studies import DECENTER, DESIGN, HEAD, RADIUS, SPREAD, STREHL

from lensdesign import DesignError, InputError, load_design, save_design, scaled
from lensdesign.cli.commands import main as lensdesign_main
from lensdesign.common import memory
from lensdesign.common.console import print_json
from lensdesign.common.text import known_text
from lensdesign.manufacture.mesh.mesh import lens_mesh
from tolerancing.cli.commands import main as tolerancing_main
from tolerancing.run.run import _process_count
from tolerancing.statistics.indices import variance_indices
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.files import load_study
from wavesim.cli.commands import main as wavesim_main
from wavesim.scene.patches import patch_scene
from wavesim.scene.settings import FrameSetSettings, ImageSettings
from wavesim.sensor.frames import FrameSettings
from wavesim.targets.patch import object_patch

Run = tuple[pytest.MonkeyPatch, pytest.CaptureFixture[str]]
MAINS = {"lensdesign": lensdesign_main, "wavesim": wavesim_main, "tolerancing": tolerancing_main}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    return monkeypatch, capsys


def called(run: Run, command: str) -> tuple[int, str, str]:
    monkeypatch, capsys = run
    program, *rest = command.split()
    monkeypatch.setattr("sys.argv", [program, *rest])
    try:
        MAINS[program]()
        status = 0
    except SystemExit as ended:
        status = int(ended.code or 0)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "design.toml").write_text(DESIGN)
    return tmp_path / "study.toml"


@pytest.mark.parametrize("size", ["6e-303", "1e-308", "5e-324", "1e-61"])
def test_tolerances_too_small_to_compute_with_are_refused(study: Path, run: Run, size: str) -> None:
    study.write_text(HEAD + DECENTER.replace("0.02", size) + SPREAD + STREHL)
    status, out, err = called(run, f"tolerancing predict {study}")
    assert (status, out) == (2, "")
    assert "sigma: must be at least 1e-60" in err


@pytest.mark.parametrize("size", ["100.0", "1e6", "1e9"])
def test_tolerances_too_large_to_predict_from_are_refused_in_one_sentence(
    study: Path, run: Run, size: str, recwarn: pytest.WarningsRecorder
) -> None:
    study.write_text(HEAD + DECENTER.replace("0.02", size) + SPREAD + STREHL)
    status, out, err = called(run, f"tolerancing predict {study}")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]


UNBOUNDED = {
    "pivot_z_mm": ("trials = 40", "trials = 40\npivot_z_mm = {}"),
    "mean": ("sigma = 0.02", "sigma = 0.02\nmean = {}"),
}


@pytest.mark.parametrize("name", UNBOUNDED)
@pytest.mark.parametrize("size", ["1e300", "-1e300", "1e10"])
def test_signed_numbers_of_a_study_are_bounded_too(study: Path, name: str, size: str) -> None:
    old, new = UNBOUNDED[name]
    text = HEAD + DECENTER + SPREAD
    assert old in text
    study.write_text(text.replace(old, new.format(size)))
    with pytest.raises(
        DesignError, match=rf"{name} = .*: must be (less|greater) than or equal to -?1000000000"
    ):
        load_study(study)


def test_indices_are_held_against_memory(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study.write_text(HEAD + DECENTER + RADIUS + SPREAD)
    loaded = load_study(study)
    monkeypatch.setattr(memory, "available_bytes", lambda: 1e6)
    with pytest.raises(InputError, match=r"base = 1048576.*GB"):
        variance_indices(loaded, 1048576)


@pytest.mark.parametrize("size", ["1e-60", "1e-30", "1e-12", "1e-6"])
def test_small_tolerances_predict_lenses_that_are_all_good(study: Path, run: Run, size: str) -> None:
    radius = RADIUS.replace("0.01", size).replace("0.02", size)
    study.write_text(HEAD + DECENTER.replace("0.02", size) + radius + SPREAD + STREHL)
    status, out, _ = called(run, f"tolerancing predict {study}")
    assert status == 0
    assert "nan" not in out
    assert "100.0" in next(line for line in out.splitlines() if "all limits at once" in line)


def test_a_plane_has_no_sphere(tmp_path: Path, run: Run) -> None:
    text = (DESIGNS / "paper_singlet.toml").read_text().replace("radius_mm = 42.3\n", "")
    (tmp_path / "flat.toml").write_text(text)
    command = f"lensdesign sag {tmp_path / 'flat.toml'} --surface 1 -o {tmp_path / 'sag.csv'}"
    status, out, _ = called(run, command)
    assert status == 0
    assert "from a plane, which fits best" in out
    assert "inf" not in out.replace(str(tmp_path), "")
    status, out, _ = called(run, f"{command} --json")
    assert json.loads(out)["best_fit_radius_mm"] is None
    assert (tmp_path / "sag.csv").read_text().splitlines()[1].endswith(",")


EXTREMES = [
    "--exposures 1e-300",
    "--exposures 1,1e300",
    "--full-well-electrons 1e-300",
    "--bits 1000000",
    "--bits 0",
    "--brightest-share 1e-300",
    "--waist-mm 1e300 --illumination gaussian",
    "--stage-error-mm 1e300",
    "--object-pitch-um 1e-300",
    "--object-pitch-um 0.0001",
    "--wavelength-um 1e-300",
    "--pivot-z-mm 1e300",
    "--read-noise-electrons 1e-300",
    "--decenter-x-mm 1e300",
    "--shift-um 1e300,0",
]


@pytest.mark.parametrize("options", EXTREMES)
def test_extreme_options_are_refused_in_a_sentence(tmp_path: Path, run: Run, options: str) -> None:
    save_design(scaled(load_design(DESIGNS / "paper_singlet.toml"), 0.05), tmp_path / "twin.toml")
    command = f"wavesim image {tmp_path / 'twin.toml'} --object star --patch-mm 0.05 -o {tmp_path / 'out'}"
    status, out, err = called(run, f"{command} {options}")
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_settings_state_what_is_allowed() -> None:
    with pytest.raises(ValueError, match=r"from 1e-12 to 1e\+12"):
        FrameSetSettings(exposure=(1e-300,))
    with pytest.raises(ValueError, match="exposure"):
        FrameSettings(
            pixel_pitch_um=1.0, plane_distance_mm=1.0, wavelength_um=0.5, exposure=1e-300, bits=12,
            offset_counts=0.0, gain_electrons_per_count=1.0,
        )  # fmt: skip
    assert ImageSettings(tilt_x_deg=0.0, shift_um=(0.0, 0.0)).tilt_x_deg == 0.0


def test_results_that_are_no_number_are_not_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"points\.1\.rms"):
        print_json({"points": [{"rms": 1.0}, {"rms": float("nan")}]})
    assert capsys.readouterr().out == ""
    assert [known_text(cell) for cell in ("nan", "nan %", "1.0", "nanometre")] == [
        "not known", "not known", "1.0", "nanometre"
    ]  # fmt: skip


def test_sizes_of_arrays_are_held_against_memory(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lens = load_design(DESIGNS / "paper_singlet.toml")
    study.write_text(HEAD + DECENTER + SPREAD)
    loaded = load_study(study).study
    monkeypatch.setattr(memory, "available_bytes", lambda: 1e6)
    with pytest.raises(InputError, match=r"object_pitch_um = 0\.1.*500 x 500"):
        object_patch(lens, 0.05, object_pitch_um=0.1)
    with pytest.raises(InputError, match=r"chord_error_um = 0\.1.*triangles"):
        lens_mesh(lens, chord_error_um=0.1)
    with pytest.raises(InputError, match=r"trials = 1000000 needs"):
        sample_perturbations(loaded, range(1_000_000))


def test_a_scene_has_no_more_samples_than_can_be_counted() -> None:
    with pytest.raises(InputError, match="at most 10000000"):
        patch_scene(load_design(DESIGNS / "paper_singlet.toml"), 0.05, object_pitch_um=1e-300)


def test_a_run_has_no_more_processes_than_trials_and_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    assert _process_count(1_000_000, 2) == 2
    assert _process_count(1_000_000, 500) == 8
    assert _process_count(None, 500) == 2
    assert _process_count(1, 500) == 1


def test_faults_of_thousands_of_tables_are_a_short_message(study: Path) -> None:
    table = DECENTER.replace("sigma", "sigmas").replace("normal", "nor" + "m" * 2000)
    study.write_text(HEAD + table * 400 + SPREAD)
    with pytest.raises(DesignError, match=r"\d+ more") as refused:
        load_study(study)
    assert len(str(refused.value)) < 60_000
    study.write_text(HEAD + DECENTER.replace("sigma", "sigmas") * 3000 + SPREAD)
    with pytest.raises(DesignError, match=r"\d+ more") as refused:
        load_study(study)
    assert len(str(refused.value)) < 20_000


def test_the_command_prints_no_more_than_can_be_read(study: Path, run: Run) -> None:
    shutil.copy(study.parent / "design.toml", study.parent / "other.toml")
    study.write_text(HEAD + "".join(f'[[merit]]\nkind = "x{k}"\n' for k in range(3000)))
    status, _, err = called(run, f"tolerancing predict {study}")
    assert status == 2
    assert len(err) < 30_000
