"""What a bench tells beside an object: frames without one, and tolerances of the lens, by the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from places import DESIGNS
from programs import Command
from wavesim_command import ENDED

from lensdesign import InputError, load_design, save_design, scaled
from wavesim import image
from wavesim.calibration.joint.search import FitResult, JointSearch, SearchState
from wavesim.cli.bench_files import read_priors
from wavesim.fields.files import write_field
from wavesim.scene.light_errors import LightErrors
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import write_frame

LIGHT = SystemState(light=LightErrors((0.5, -0.3), {(1, 0): -0.06}, {(2, 0): 0.05}))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of a star and of nothing through a small twin, in a light that is tilted, uneven and bent."""
    folder = tmp_path_factory.mktemp("bench")
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    save_design(lens, folder / "twin.toml")
    for thing in ("star", "empty"):
        little_noise = {"full_well_electrons": 1e6, "bits": 16}
        made = image(lens, thing, state=LIGHT, patch_mm=0.04, engine="eikonal", error=0.3, **little_noise)
        (folder / thing).mkdir()
        for number, frame in enumerate(made.frames, start=1):
            write_frame(frame, folder / thing / f"frame_{number}.tif")
            other = replace(frame, settings=frame.settings.replaced(wavelength_um=0.6))
            write_frame(other, folder / thing / f"other_{number}.tif")
        write_field(made.target.transmission, folder / thing / "object.npz")
    return folder


@pytest.fixture
def run(wavesim: Command, bench: Path) -> Command:
    """A command on the frames of the star."""
    frames = bench / "star" / "frame_1.tif", bench / "star" / "frame_2.tif"
    design = "--design", bench / "twin.toml", "--patch-mm", 0.04, "--error", 0.3
    return lambda name, *arguments: wavesim(name, *frames, *design, *arguments)


@pytest.mark.usefixtures("quick_verdicts")
def test_the_light_of_empty_frames_makes_a_reconstruction(run: Command, bench: Path, tmp_path: Path) -> None:
    quick = (
        "--kind",
        "amplitude",
        "--engine",
        "eikonal",
        "--iterations",
        12,
        "--truth",
        bench / "star",
        "--json",
    )
    out = tmp_path / "out"
    code, text, err = run("reconstruct", *quick, "--empty", bench / "empty", "-o", out)
    assert code in ENDED, err
    found = json.loads(text)["truth"]["object_correlation"]
    assert found > 0.9
    light = json.loads((out / "calibration" / "calibration.json").read_text())
    assert light["object"] == "empty"
    assert light["values"]["light_tilt_x_deg"] == pytest.approx(0.5, rel=0.05)
    mounted = {"mounting": {}, "values": {"surface_1_index": 1e-6, "light_tilt_x_deg": 9.0}}
    (tmp_path / "lens.json").write_text(json.dumps(mounted))
    both = "--empty", bench / "empty", "--calibration", tmp_path / "lens.json", "-o", tmp_path / "both"
    code, text, err = run("reconstruct", *quick, *both)
    assert code in ENDED, err
    assert json.loads(text)["truth"]["object_correlation"] == pytest.approx(found, abs=1e-3)
    again = "--calibration", out / "calibration" / "calibration.json", "-o", tmp_path / "again"
    code, text, err = run("reconstruct", *quick, *again)
    assert code in ENDED, err
    assert json.loads(text)["truth"]["object_correlation"] == pytest.approx(found, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--empty", "empty/other_1.tif"),
            "--empty: wavelength_um = 0.6; that of the object's frames is 0.532",
        ),
        (("--empty", "empty/frame_1.tif"), "--empty: planes at 0.0416667 mm; the object's frames have"),
        (("--empty", "twin.toml"), "twin.toml"),
        (("--empty", "."), "contains no frame_*.tif"),
        (("--calibrate", "--priors", DESIGNS / "paper_tolerances.toml"), "is a study of another design"),
        (("--priors", DESIGNS / "paper_tolerances.toml"), "--priors: requires --calibrate"),
    ],
)
def test_what_cannot_serve_is_refused_and_nothing_written(
    run: Command, bench: Path, tmp_path: Path, options: tuple[object, ...], message: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "reconstruction.json").write_text("kept")
    given = [
        bench / name if flag == "--empty" else name
        for flag, name in zip(("", *options), options, strict=False)
    ]
    code, _, err = run("reconstruct", *given, "-o", out)
    assert code == 2
    assert message in " ".join(err.split())
    assert [path.read_text() for path in out.iterdir()] == ["kept"]


def test_an_interrupted_search_of_the_light_goes_on(
    run: Command, bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, began = JointSearch.run, []

    def cut_off(search: JointSearch, state: SearchState) -> FitResult:
        began.append(len(state.trail))
        if len(began) > 1:
            raise KeyboardInterrupt
        keep = search.keep

        def kept(state: SearchState) -> None:
            keep(state)  # type: ignore[misc]
            raise KeyboardInterrupt

        return whole(replace(search, keep=kept), state)

    monkeypatch.setattr(JointSearch, "run", cut_off)
    command = "calibrate", "--empty", bench / "empty", "--parameters", "light", "-o", tmp_path
    for _ in range(2):
        code, _, err = run(*command)
        assert code == 130
        assert "run the same command again" in " ".join(err.split())
    assert began[0] == 0 < began[1]
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint_empty.npz"]


def test_frames_that_saw_an_object_are_refused(run: Command, bench: Path, tmp_path: Path) -> None:
    (tmp_path / "calibration.json").write_text("kept")
    quick = "--parameters", "light", "--max-mountings", 6
    code, _, err = run("calibrate", "--empty", bench / "star", *quick, "-o", tmp_path)
    assert code == 2
    assert "--empty: " in err
    assert "must be frames without an object" in " ".join(err.split())
    assert [path.read_text() for path in tmp_path.iterdir()] == ["kept"]


def test_more_than_memory_holds_is_refused(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wavesim.calibration.calibration_problem.memory_limit", lambda _: 2e6)
    light = "--parameters", "light"
    code, _, err = run("calibrate", *light, "-o", tmp_path / "out")
    assert code == 2
    assert "use --kind amplitude" in err
    code, _, err = run("calibrate", *light, "--kind", "amplitude", "-o", tmp_path / "out")
    assert code == 2
    assert "10 parameters in 39200 pixels needs 0.0109 GB, and 0.002 GB are" in " ".join(err.split())
    assert not (tmp_path / "out").exists()


def test_priors_need_a_package_that_reads_studies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wavesim.cli.bench_files.PRIORS", "nobody.gives.this")
    with pytest.raises(InputError, match=r"priors: .*entry point nobody\.gives\.this"):
        read_priors(Path("study.toml"), load_design("designs/paper_singlet.toml"))
