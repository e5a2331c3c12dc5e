"""The page that zooms: what its tiles hold, that it loads nothing, and what a browser makes of it."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from lensdesign.errors import InputError
from wavesim import Frame, FrameSettings, write_zoom_page
from wavesim.plots import field_layers, frame_layer
from wavesim.plots.page import STEPS
from wavesim.plots.pyramid import TILE, halved
from wavesim.targets.region import cut_out

HOSTILE = "</script><script>window.struck = 1</script>&<b>\"'`${1}\\<!-- tiles -->"


def ramp(rows: int, columns: int) -> Any:
    """Amplitudes from 0.1 to 1, which tell where they stand."""
    y, x = np.ogrid[:rows, :columns]
    return (0.1 + 0.6 * x / (columns - 1) + 0.3 * y / (rows - 1)).astype(np.float32)


def frame_of(counts: Any) -> Frame:
    settings = FrameSettings(
        pixel_pitch_um=3.2,
        plane_distance_mm=2.0,
        wavelength_um=0.532,
        exposure=1e4,
        bits=12,
        offset_counts=64.0,
        gain_electrons_per_count=2.0,
        read_noise_electrons=2.0,
    )
    return Frame(counts.astype(np.uint16), settings)


def embedded(path: Path) -> list[dict[str, Any]]:
    """Layers of a page, with the pixels of each level by its halvings, the first row on top."""
    page = path.read_text(encoding="utf-8")
    (content,) = re.findall(r'<script type="application/json" id="page">(.*?)</script>', page, re.DOTALL)
    (text,) = re.findall(r'<script type="text/plain" id="tiles">(.*?)</script>', page, re.DOTALL)
    data, tiles = json.loads(content), text.split("\n")
    assert (data["tile"], data["steps"]) == (TILE, STEPS)
    for layer in data["layers"]:
        layer["pixels"] = {}
        for level in layer["levels"]:
            columns, rows = level["size"]
            across, down = math.ceil(columns / TILE), math.ceil(rows / TILE)
            part = tiles[level["first"] : level["first"] + across * down]
            layer["pixels"][level["halvings"]] = np.block(
                [[picture(part[r * across + c]) for c in range(across)] for r in range(down)]
            )
            assert layer["pixels"][level["halvings"]].shape == (rows, columns)
    return list(data["layers"])


def picture(text: str) -> Any:
    return np.array(Image.open(io.BytesIO(base64.b64decode(text)), formats=["PNG"]))


def values_of(layer: dict[str, Any], pixels: Any) -> Any:
    """What levels of 8 bits say."""
    low, high, share = layer["low"], layer["high"], (pixels.astype(float) - 1.0) / STEPS
    values = low * (high / low) ** share if layer["logarithmic"] else low + share * (high - low)
    return np.where(pixels > 0, values, np.nan)


def test_a_page_loads_nothing(tmp_path: Path) -> None:
    write_zoom_page(field_layers(ramp(40, 50), 0.4), tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text(encoding="utf-8")
    assert "://" not in page
    assert not re.findall(
        r"<(?:link|img|iframe|object|embed)\b|\bsrc=|@import|url\(|\bfetch\(|\bimport\b", page
    )
    assert "default-src 'none'" in page


@settings(max_examples=10)
@given(rows=st.integers(2, 1030), columns=st.integers(2, 300))
def test_tiles_hold_the_field(tmp_path_factory: pytest.TempPathFactory, rows: int, columns: int) -> None:
    path = tmp_path_factory.mktemp("page") / "view.html"
    values = ramp(rows, columns) * np.exp(2j * ramp(rows, columns)).astype(np.complex64)
    made = write_zoom_page(field_layers(values, 0.4, (7.0, -3.0)), path)
    assert (made.layers, made.halvings, made.region_mm) == (("amplitude", "phase"), (0, 0), None)
    assert made.bytes == path.stat().st_size
    amplitude, phase = embedded(path)
    for layer, expected in ((amplitude, np.abs(values)), (phase, np.angle(values))):
        assert (layer["left"], layer["top"]) == pytest.approx((7.0 - 0.2 * columns, -3.0 + 0.2 * rows))
        half_step = 0.5001 * (layer["high"] - layer["low"]) / STEPS
        found = values_of(layer, layer["pixels"][0])[::-1]
        seen = np.isfinite(found) & (layer["pixels"][0][::-1] <= STEPS)
        assert abs(found - expected)[seen] == pytest.approx(0.0, abs=half_step)
        assert max(layer["pixels"][max(layer["pixels"])].shape) <= TILE
    assert np.array_equal(phase["pixels"][0][::-1] == 0, np.abs(values) <= 0.1 * amplitude["high"])


def test_halvings_are_means_of_amplitudes_and_of_complex_values(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    values = np.exp(0.4j * rng.standard_normal((600, 700))).astype(np.complex64)
    values *= rng.uniform(0.5, 1.0, values.shape).astype(np.float32)
    write_zoom_page(field_layers(values, 0.4), tmp_path / "view.html")
    amplitude, phase = embedded(tmp_path / "view.html")
    for layer, expected in (
        (amplitude, halved(values, np.abs)),
        (phase, np.clip(np.angle(halved(values)), phase["low"], phase["high"])),
    ):
        half_step = 0.5001 * (layer["high"] - layer["low"]) / STEPS
        assert values_of(layer, layer["pixels"][1])[::-1] == pytest.approx(expected, abs=half_step)


def test_frames_are_shown_in_electrons_on_a_logarithmic_scale(tmp_path: Path) -> None:
    counts = np.round(np.geomspace(1.0, 4000.0, 530 * 600)).reshape(530, 600) + 63
    write_zoom_page([frame_layer(frame_of(counts), "frame_1.tif")], tmp_path / "view.html")
    (layer,) = embedded(tmp_path / "view.html")
    electrons = 2.0 * (counts - 64.0)
    noise = math.hypot(2.0, 2.0 / math.sqrt(12.0))
    assert (layer["unit"], layer["plane"], layer["beyond"]) == ("electrons", "sensor", [True, False])
    assert (layer["low"], layer["high"]) == pytest.approx((noise, electrons.max()))
    half_step = (layer["high"] / layer["low"]) ** (0.5001 / STEPS) - 1.0
    for halvings, expected in ((0, electrons), (1, halved(electrons))):
        found = values_of(layer, layer["pixels"][halvings])[::-1]
        assert found / np.maximum(expected, noise) == pytest.approx(1.0, abs=half_step + 1e-5)


def test_amplitude_objects_have_no_phase() -> None:
    assert [layer.name for layer in field_layers(ramp(5, 5), 0.4, name="true")] == ["true amplitude"]
    assert [layer.name for layer in field_layers(ramp(5, 5) + 0j, 0.4)] == ["amplitude"]


def test_dark_fields_are_shown(tmp_path: Path) -> None:
    write_zoom_page(field_layers(np.zeros((5, 5), complex), 0.4), tmp_path / "view.html")
    (layer,) = embedded(tmp_path / "view.html")
    assert np.all(layer["pixels"][0] == 1)


def test_what_has_no_room_is_left_out_and_the_region_that_has_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    noise = (rng.standard_normal((1100, 1100)) + 1j * rng.standard_normal((1100, 1100))).astype(np.complex64)
    path, most_bytes = tmp_path / "view.html", 1_500_000
    made = write_zoom_page(field_layers(noise, 0.4), path, most_bytes=most_bytes)
    assert made.halvings == (1, 1)
    assert made.bytes < most_bytes + 60_000
    assert [sorted(layer["pixels"]) for layer in embedded(path)] == [[1, 2], [1, 2]]
    assert made.region_mm is not None
    assert 0.15 < made.region_mm < 0.44
    part, centre_um = cut_out(noise, 0.4, (0.0, 0.0, made.region_mm, made.region_mm))
    again = write_zoom_page(field_layers(part, 0.4, centre_um), path, most_bytes=most_bytes)
    assert (again.halvings, again.region_mm) == ((0, 0), None)
    # However little room there is, every layer is shown.
    least = write_zoom_page(field_layers(noise, 0.4), path, most_bytes=1)
    assert least.halvings == (2, 2)


def test_markup_in_names_is_inert(tmp_path: Path) -> None:
    path = tmp_path / "view.html"
    layers = field_layers(ramp(4, 4), 0.4, name=HOSTILE)
    write_zoom_page(layers, path, HOSTILE, [(HOSTILE, HOSTILE)])
    page = path.read_text(encoding="utf-8")
    assert page.count("<script") == page.count("</script>") == 3
    assert "struck = 1</" not in page
    assert embedded(path)[0]["name"] == f"{HOSTILE} amplitude"
    assert html.escape(HOSTILE, quote=False).split('"')[0] in page


def test_the_same_layers_give_the_same_page(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        write_zoom_page(field_layers(ramp(30, 40), 0.4), tmp_path / name, "title")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_nothing_is_written_where_no_page_can_be(tmp_path: Path) -> None:
    layers, kept = field_layers(ramp(4, 4), 0.4), tmp_path / "view.html"
    kept.write_text("before")
    for chosen, path, words in (
        (layers, tmp_path / "view.png", r"view\.png: .*\.html"),
        ([], kept, "at least one layer"),
        (layers, kept / "view.html", "file where a folder is needed"),
    ):
        with pytest.raises(InputError, match=words):
            write_zoom_page(chosen, path)
    assert [p.name for p in tmp_path.iterdir()] == ["view.html"]
    assert kept.read_text() == "before"


# A browser, where there is one. The probe goes to places, and notes what the page says and draws there. The
# browser's time is a virtual one, by which frames of the screen would be late.
FRAMES = "<script>window.requestAnimationFrame = (draw) => setTimeout(draw, 10);</script></head>"
PROBE = """<script>
(async () => {
  const byId = (id) => document.getElementById(id), canvas = byId("canvas");
  const notes = [], box = canvas.getBoundingClientRect();
  const wait = (ms) => new Promise((done) => setTimeout(done, ms));
  const note = async () => {
    await wait(100);
    for (let i = 0; i < 300 && canvas.getAttribute("aria-busy") === "true"; i++) {
      for (let j = 0, sum = 0; j < 1e6; j++) sum += Math.sqrt(j);  // tiles are decoded in real time
      await wait(20);
    }
    const pixel = canvas.getContext("2d").getImageData(canvas.width >> 1, canvas.height >> 1, 1, 1);
    notes.push([byId("readout").textContent, [...pixel.data]]);
  };
  const at = (x, y, more) => ({ clientX: box.left + x, clientY: box.top + y, pointerId: 1, ...more });
  canvas.setPointerCapture = () => {};
  const send = (kind, ...place) => canvas.dispatchEvent(new PointerEvent("pointer" + kind, at(...place)));
  await note();
  for (const hash of PLACES) { location.hash = hash; await note(); }
  const moves = [
    () => send("move", 100, 50),
    () => canvas.dispatchEvent(new WheelEvent("wheel", at(100, 50, { deltaY: 2400 }))),
    () => { send("down", 100, 50); send("move", 130, 90); send("up", 130, 90); },
    () => {
      const second = { pointerId: 2 };
      send("down", 100, 50);
      send("down", 200, 50, second);
      send("move", 300, 50, second);
      send("up", 300, 50, second);
      send("up", 100, 50);
      send("move", 100, 50);
    },
    () => {
      send("leave", 0, 0);
      byId("from").value = 127;
      byId("from").dispatchEvent(new Event("input"));
    },
    () => {
      const keys = ["0", "+", "ArrowRight", "l"];
      for (const key of keys) canvas.dispatchEvent(new KeyboardEvent("keydown", { key }));
    },
  ];
  for (const move of moves) { move(); await note(); }
  const out = document.createElement("pre");
  out.id = "notes";
  const size = [canvas.clientWidth, canvas.clientHeight];
  out.textContent = JSON.stringify({ notes, struck: typeof window.struck, size });
  document.body.append(out);
})();
</script></body>"""
READOUT = re.compile(r"(?:middle: )?x (\S+) µm, y (\S+) µm: (.*)")


def browse(path: Path, places: list[str]) -> dict[str, Any]:
    """What a browser noted of a page."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no Chromium here")
    page = path.read_text(encoding="utf-8").replace("</head>", FRAMES)
    page = page.replace("</body>", PROBE.replace("PLACES", json.dumps(places)))
    path.write_text(page, encoding="utf-8")
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1000,800"]
    flags += [f"--user-data-dir={path.parent / 'profile'}", "--virtual-time-budget=60000", "--dump-dom"]
    done = subprocess.run(
        [program, *flags, path.as_uri()], capture_output=True, text=True, timeout=600, check=True
    )
    found = re.search(r'<pre id="notes">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found is not None
    return dict(json.loads(html.unescape(found[1])))


def place_of(said: str) -> tuple[float, float, str]:
    """Coordinates and value of a readout."""
    found = READOUT.fullmatch(said.replace("−", "-"))
    assert found is not None, said
    return float(found[1]), float(found[2]), found[3]


def test_a_browser_shows_the_right_samples(tmp_path: Path) -> None:
    rows, columns, pitch = 1300, 2100, 0.4
    values, path = ramp(rows, columns), tmp_path / "view.html"
    layers = field_layers(values * np.exp(2j * values), pitch, (10.0, -20.0), name="true")
    write_zoom_page(layers, path, HOSTILE)
    left, low = 10.0 - 0.5 * columns * pitch, -20.0 - 0.5 * rows * pitch
    places = [(10.13, -20.13, 20.0), (-300.3, 100.7, 5.0), (420.1, -250.1, 1.9), (-200.3, -250.7, 0.9),
              (200.9, 33.3, 0.45), (10.5, 90.5, 30.0)]  # fmt: skip
    hashes = [f"#layer=true+amplitude&x={x}&y={y}&scale={scale}" for x, y, scale in places]
    noted = browse(path, hashes)
    assert noted["struck"] == "undefined"
    (first, *there), moved = noted["notes"][: len(places) + 1], noted["notes"][len(places) + 1 :]
    assert place_of(first[0])[:2] == (10.0, -20.0)
    high = layers[0].high
    for (x, y, scale), (said, colour) in zip(places, there, strict=True):
        found_x, found_y, value = place_of(said)
        assert (found_x, found_y) == pytest.approx((x, y), abs=0.51)
        halvings = max(0, math.floor(math.log2(1.0 / (scale * pitch))))
        many = 2**halvings
        # Levels begin on top.
        column, top = int((x - left) / pitch) // many, int((low + rows * pitch - y) / pitch) // many
        block = values[::-1][top * many : (top + 1) * many, column * many : (column + 1) * many]
        under = float(block.mean())
        assert f"(mean of {many} × {many} samples)" in value or many == 1
        assert float(value.split()[2]) == pytest.approx(under, abs=0.51 * high / STEPS + 0.0051 * under)
        assert colour[0] == pytest.approx(255.0 * under / high, abs=3.0)
        assert colour[0] == colour[1] == colour[2]
    # What lies under the pointer stays there: turning the wheel, dragging by (30, 40), pinching.
    hover, wheel, drag, pinch, stretched, keys = [place_of(said) for said, _ in moved]
    wide = places[-1][2] * math.exp(-3.6)
    assert wheel[:2] == pytest.approx(hover[:2], abs=0.51)
    assert "mean of" in wheel[2]
    assert "mean of" not in hover[2]
    assert drag[:2] == pytest.approx(wheel[:2], abs=0.51)
    # Two fingers from 100 to 200 pixels apart.
    assert pinch[:2] == pytest.approx((drag[0] - 30.0 / wide, drag[1] + 40.0 / wide), abs=0.51)
    # Colours from the middle of the range on.
    share = float(stretched[2].split()[2]) / high
    assert 0.55 < share < 1.0
    assert moved[4][1][0] == pytest.approx(255.0 * (2.0 * share - 1.0), abs=6.0)
    width, height = noted["size"]
    scale = 1.5 * min((width - 16.0) / (columns * pitch), (height - 16.0) / (rows * pitch))
    assert keys[:2] == pytest.approx((10.0 + 60.0 / scale, -20.0), abs=0.6)
    assert " rad" in keys[2]
