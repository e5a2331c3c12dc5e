"""The 3D view: where it renders, what it shows; where it does not, how it says so."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lensdesign import Lens
from lensdesign.errors import InputError
from lensdesign.plots import scene3d
from lensdesign.plots.scene3d import RenderingError, render_lens, rendering_available

CRASH = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
HANG = "import time; time.sleep(30)"


@pytest.fixture
def fresh_probe() -> Iterator[None]:
    """Forget what was found out before and after a test."""
    rendering_available.cache_clear()
    yield
    rendering_available.cache_clear()


@pytest.fixture
def rendering() -> None:
    if not rendering_available():
        pytest.skip("no off-screen rendering here")


@pytest.mark.usefixtures("fresh_probe")
@pytest.mark.parametrize("probe", [CRASH, HANG, "raise SystemExit(1)", "import no_such_library"])
def test_a_child_that_dies_or_hangs_means_no_rendering(monkeypatch: pytest.MonkeyPatch, probe: str) -> None:
    monkeypatch.setattr(scene3d, "PROBE", probe)
    monkeypatch.setattr(scene3d, "PROBE_SECONDS", 1.0)
    assert rendering_available() is False


@pytest.mark.usefixtures("fresh_probe")
def test_the_probe_runs_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene3d, "PROBE", "pass")
    assert rendering_available() is True
    monkeypatch.setattr(scene3d, "PROBE", CRASH)
    assert rendering_available() is True


def test_without_rendering_nothing_is_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, paper_lens: Lens
) -> None:
    monkeypatch.setattr(scene3d, "rendering_available", lambda: False)
    with pytest.raises(RenderingError, match="off-screen rendering"):
        render_lens(paper_lens, tmp_path / "view.png")
    assert not list(tmp_path.iterdir())


def test_a_lens_that_does_not_close_is_refused(tmp_path: Path, paper_lens: Lens) -> None:
    with pytest.raises(InputError, match="edge thickness"):
        render_lens(paper_lens.with_surface(0, thickness_mm=4.5), tmp_path / "view.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("rendering")
def test_the_view_shows_glass_rays_and_planes(tmp_path: Path, paper_lens: Lens) -> None:
    from matplotlib.image import imread

    render_lens(paper_lens, tmp_path / "view.png", window_size_px=(600, 400))
    image = imread(tmp_path / "view.png")
    assert image.shape[:2] == (400, 600)
    assert np.all(image[0, :, :3] == 1.0)
    red, green, blue = np.moveaxis(image[..., :3], -1, 0)
    shares = {
        "empty": np.mean((red == 1.0) & (green == 1.0) & (blue == 1.0)),
        "glass": np.mean((blue - red > 0.04) & (blue > 0.6)),
        "red rays": np.mean((red - blue > 0.3) & (red - green > 0.15)),
        "object": np.mean((red > 0.8) & (green > 0.6) & (blue < 0.2)),
        "sensor": np.mean((abs(red - blue) < 0.01) & (red > 0.8) & (red < 0.95)),
    }
    assert 0.2 < shares["empty"] < 0.8
    assert shares["glass"] > 0.03
    assert shares["red rays"] > 0.002
    assert shares["object"] > 0.001
    assert shares["sensor"] > 0.05


@pytest.mark.usefixtures("rendering")
def test_rendering_says_nothing_on_standard_error(tmp_path: Path, paper_design: Path) -> None:
    code = (
        "import sys, lensdesign; from lensdesign.plots.scene3d import render_lens;"
        "render_lens(lensdesign.load_design(sys.argv[1]), sys.argv[2], window_size_px=(90, 60))"
    )
    child = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning", "-c", code, str(paper_design), "view.png"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (child.returncode, child.stderr) == (0, "")
    assert (tmp_path / "view.png").exists()
