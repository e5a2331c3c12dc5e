"""The view of a lens: a page that needs nothing beside itself, and a window that may not be there."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import Command

from lensdesign import Lens
from lensdesign.errors import InputError
from lensdesign.files.design import save_design
from lensdesign.plots import window
from lensdesign.plots.page import write_view
from lensdesign.plots.scene import scene_parts
from lensdesign.plots.window import open_window
from lensdesign.raytrace.bundles import pupil_hexapolar
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS, ray_paths

HOSTILE = "</script><script>window.struck = 1</script>&<b>\"'`${1}\\"


@pytest.fixture(scope="module")
def page(paper_lens: Lens, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of the paper's lens."""
    path = tmp_path_factory.mktemp("view") / "view.html"
    write_view(paper_lens, path)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def cemented() -> Lens:
    """Six elements, in three cemented doublets, and three sensor planes close together."""
    doublet = [
        {"radius_mm": 80.0, "thickness_mm": 5.0, "material": "N-BK7", "semi_diameter_mm": 12.0},
        {"radius_mm": -60.0, "thickness_mm": 2.0, "material": "N-SF6", "semi_diameter_mm": 12.0},
        {"radius_mm": -400.0, "thickness_mm": 1.0, "semi_diameter_mm": 12.0},
    ]
    surfaces = [dict(s) for _ in range(3) for s in doublet]
    surfaces[-1].pop("thickness_mm")
    return Lens.model_validate(
        {
            "wavelengths_um": [0.532, 0.633],
            "object": {"field_diameter_mm": 6.0, "numerical_aperture": 0.2, "working_distance_mm": 40.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [6000, 4000], "plane_distances_mm": [2.0, 2.1, 2.2]},
            "surface": surfaces,
        }
    )


def embedded(page: str) -> list[dict[str, Any]]:
    """The parts that a page holds."""
    found = re.findall(r'<script type="application/json" id="scene">(.*?)</script>', page, re.DOTALL)
    assert len(found) == 1
    parts: list[dict[str, Any]] = json.loads(found[0])["parts"]
    return parts


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_a_page_loads_nothing(page: str) -> None:
    assert "://" not in page
    assert not re.findall(
        r"<(?:link|img|iframe|object|embed)\b|\bsrc=|@import|url\(|\bfetch\(|\bimport\b", page
    )
    assert "default-src 'none'" in page
    assert len(page) < 2_000_000


def test_a_page_holds_the_scene(page: str, paper_lens: Lens) -> None:
    parts = embedded(page)
    kinds = ["glass", "stop", "object", "plane", "plane", "rays", "rays", "rays"]
    assert [p["kind"] for p in parts] == kinds
    assert [p["color"] for p in parts if p["kind"] == "rays"] == list(FIELD_COLORS)
    pupil = pupil_hexapolar(2).points
    for part, share in zip(parts[-3:], FIELD_FRACTIONS, strict=True):
        paths = ray_paths(paper_lens, (0.0, share * paper_lens.half_field_mm), pupil)
        assert part["points"] == paths.shape[1]
        assert floats(part["lines"]) == pytest.approx(paths.ravel(), abs=1e-5)
    width, height = paper_lens.sensor.size_mm
    for part, z in zip(parts[3:5], paper_lens.sensor_z_mm, strict=True):
        corners = floats(part["vertices"]).reshape(-1, 3)
        assert np.ptp(corners, axis=0) == pytest.approx([width, height, 0.0], abs=1e-5)
        assert corners[:, 2] == pytest.approx(z)
    glass = floats(parts[0]["vertices"]).reshape(-1, 3)
    assert glass.min(axis=0) == pytest.approx([-11.25, -11.25, 0.0], abs=0.01)
    faces = np.frombuffer(base64.b64decode(parts[0]["faces"]), "<u4")
    assert faces.max() == len(glass) - 1


def test_the_edges_of_the_glass_are_drawn(paper_lens: Lens) -> None:
    """At the ground diameter of the lens's drawing."""
    glass = scene_parts(paper_lens, 2.0)[0]
    front = 11.25**2 / (42.3 + np.sqrt(42.3**2 - 11.25**2))
    back = 9.7 - 11.25**2 / (12.0 + np.sqrt(12.0**2 - (1.0 - 0.89862) * 11.25**2))
    corners = glass.lines.reshape(-1, 3)
    assert np.hypot(*corners[:, :2].T) == pytest.approx(11.25, abs=0.01)
    assert sorted({round(z, 2) for z in corners[:, 2].tolist()}) == pytest.approx([front, back], abs=0.01)


def test_a_page_says_what_the_lens_is(page: str) -> None:
    for text in ("Spatial information transfer lens, Table 1", "Ø 3 mm", "H1 = 2 mm", "element 1: N-BK7"):
        assert text in page
    assert '<dd class="bad">4.811° (limit 4.768°)</dd>' in page
    assert "9344 × 7000 pixels of 3.2 µm" in page
    assert page.count("data-part=") == len(embedded(page))


def test_many_elements_stay_small(cemented: Lens, tmp_path: Path) -> None:
    made = write_view(cemented, tmp_path / "view.html")
    assert (made.bodies, made.rays) == (6, 57)
    assert made.bytes == (tmp_path / "view.html").stat().st_size < 2_000_000
    parts = embedded((tmp_path / "view.html").read_text(encoding="utf-8"))
    assert sum(p["kind"] == "glass" for p in parts) == 6
    assert sum(p["kind"] == "plane" for p in parts) == 3


def test_markup_in_names_is_inert(paper_lens: Lens, tmp_path: Path) -> None:
    name = "</script><script>alert(2)</script>"
    catalogue = tmp_path / "odd.agf"
    catalogue.write_text(f"CC test\nNM {name} 2 0 1.5 60\nCD 1.25 0.01 0 0 0 0\nLD 0.3 2.0\n")
    odd = paper_lens.replaced(title=HOSTILE, glass_catalogs=(catalogue,)).with_surface(0, material=name)
    write_view(odd, tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert page.count("<script") == page.count("</script>") == 2
    assert "struck = 1</" not in page
    assert "alert(2)</" not in page
    assert embedded(page)[0]["label"] == f"element 1: {name}"


def test_the_same_lens_gives_the_same_page(page: str, paper_lens: Lens, tmp_path: Path) -> None:
    write_view(paper_lens, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == page


def test_nothing_is_written_where_no_page_can_be(paper_lens: Lens, tmp_path: Path) -> None:
    kept = tmp_path / "view.html"
    kept.write_text("before")
    with pytest.raises(InputError, match=r"must end in \.html"):
        write_view(paper_lens, tmp_path / "view.png")
    with pytest.raises(InputError, match="edge thickness"):
        write_view(paper_lens.with_surface(0, thickness_mm=4.5), kept)
    with pytest.raises(InputError, match="file where a folder is needed"):
        write_view(paper_lens, kept / "view.html")
    assert [p.name for p in tmp_path.iterdir()] == ["view.html"]
    assert kept.read_text() == "before"


def test_the_command_writes_a_page(command: Command, paper_design: Path, tmp_path: Path) -> None:
    path = tmp_path / "new" / "view.html"
    code, out, err = command("view", paper_design, "-o", path, "--json")
    assert (code, err) == (0, "")
    made = json.loads(out)
    assert made["file"] == str(path)
    assert (made["bodies"], made["rays"], made["bytes"]) == (1, 57, path.stat().st_size)
    code, out, err = command("view", paper_design, "-o", path)
    assert code == 0
    assert err.startswith("outline: element 1 (surfaces 1 and 2): ground diameter 22.5 mm, chosen")
    assert re.fullmatch(rf"wrote {re.escape(str(path))}: 1 body, 57 rays, 0\.\d+ MB\n", out)


def test_the_command_refuses_what_it_cannot_show(
    command: Command, paper_design: Path, paper_lens: Lens, tmp_path: Path
) -> None:
    for arguments in [
        (tmp_path / "none.toml",),
        (paper_design, "-o", tmp_path / "view.stl"),
        (paper_design, "-o", tmp_path),
    ]:
        code, out, err = command("view", *arguments)
        assert (code, out) == (2, "")
        assert len(err.splitlines()) == 1
    itself = tmp_path / "lens.html"
    save_design(paper_lens, itself)
    code, _, err = command("view", itself, "-o", itself)
    assert code == 2
    assert "the design itself" in err


def test_without_a_display_the_page_is_named(
    command: Command, paper_design: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("a display is always there")
    for display, reason in ((None, "there is no display"), (":9999", "the display does not answer")):
        if display is None:
            monkeypatch.delenv("DISPLAY", raising=False)
        else:
            monkeypatch.setenv("DISPLAY", display)
        code, out, err = command("view", paper_design)
        assert (code, out) == (2, "")
        assert err == f"error: {reason}; write a page for a browser instead with -o view.html\n"


@pytest.mark.parametrize(
    ("child", "reason"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "it crashed"),
        ("raise RuntimeError('no OpenGL')", "RuntimeError: no OpenGL"),
    ],
)
def test_a_window_that_dies_is_reported(
    monkeypatch: pytest.MonkeyPatch, paper_design: Path, child: str, reason: str
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "CHILD", child)
    with pytest.raises(InputError, match=re.escape(reason)):
        open_window(paper_design)


def test_a_window_shows_the_design(
    command: Command, monkeypatch: pytest.MonkeyPatch, paper_design: Path, tmp_path: Path
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(
        window, "CHILD", f"import sys; open({str(tmp_path / 'shown')!r}, 'w').write(sys.argv[1])"
    )
    assert command("view", paper_design) == (0, "", "")
    assert (tmp_path / "shown").read_text() == str(paper_design.resolve())
    code, out, _ = command("view", paper_design, "--json")
    assert (code, json.loads(out)) == (0, {"file": None})


def chromium(page: Path, *options: str) -> str:
    """The page's document after its script has run."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium here")
    flags = ["--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle"]
    flags += ["--use-angle=swiftshader", f"--user-data-dir={page.parent / 'profile'}", *options]
    run = [program, *flags, "--virtual-time-budget=3000", "--dump-dom", page.as_uri()]
    return subprocess.run(run, capture_output=True, text=True, timeout=600, check=True).stdout


def test_a_browser_runs_the_page(paper_lens: Lens, tmp_path: Path) -> None:
    path = tmp_path / "view.html"
    write_view(paper_lens.replaced(title=HOSTILE), path)
    # Asked after the page's own script, whose errors would have ended it before the scale bar was written.
    probe = (
        "<script>document.title = [typeof window.struck, document.querySelector('#bar span').textContent, "
        "[...document.querySelectorAll('#labels span')].filter((s) => s.style.transform).length, "
        "document.querySelector('#missing').hidden].join('|');</script>"
    )
    late = f"<script>setTimeout(() => {{ {probe[8:-9]} }}, 1500);</script></body>"
    path.write_text(path.read_text(encoding="utf-8").replace("</body>", late), encoding="utf-8")
    found = re.search(r"<title>(.*?)</title>", chromium(path))
    assert found is not None
    struck, bar, names, no_message = found[1].split("|")
    if no_message == "false":
        pytest.skip("Chromium without WebGL 2")
    assert struck == "undefined"
    assert re.fullmatch(r"\d+ mm", bar)
    assert int(names) == 5
