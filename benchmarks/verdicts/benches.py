"""Benches, and the frames that are recorded on them and kept in a folder."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import DESIGNS
from benchmarks.verdicts.objects import make_object, with_stop
from lensdesign import load_design, scaled
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Field
from wavesim.fields.files import write_field
from wavesim.scene.settings import Kind, PatchSettings
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame, read_frame, write_frame
from wavesim.sensor.imaging import image
from wavesim.targets.patch import OBJECT_FILE, lit_patch

Settings = tuple[tuple[str, Any], ...]
"""Names and values of settings."""

MANY_EXPOSURES = (1.0, 30.0, 900.0)
"""With which intensities are recorded without noise."""


@dataclass(frozen=True)
class Bench:
    """A bench as it should be, and how its frames are reconstructed.

    Attributes
    ----------
    scale
        Size of the lens over that of the paper's.
    thing
        The object's name.
    kind
        What the object is taken for.
    patch_mm
        Side of the patch, and diameter of the field stop.
    exposures
        Of each plane.
    planes
        Their number: the design's two, or more, evenly spaced between these.
    wavelength_um
        The design's if None.
    seed
        Of object and noise.
    pixels
        Of a side of the frames; what holds the light if None.
    imaged, reconstructed
        Further settings of `wavesim image` and of `wavesim reconstruct`.
    """

    scale: float = 1 / 32
    thing: str = "text"
    kind: Kind = "amplitude"
    patch_mm: float = 0.05
    exposures: tuple[float, ...] = (1.0, 30.0)
    planes: int = 2
    wavelength_um: float | None = None
    seed: int = 0
    pixels: int | None = None
    imaged: Settings = ()
    reconstructed: Settings = ()

    def __str__(self) -> str:
        times = ",".join(f"{one:g}" for one in self.exposures)
        parts = [f"1/{1.0 / self.scale:.0f}", self.thing, self.kind, f"{self.patch_mm:g} mm"]
        parts += [f"{self.planes} planes", f"exposures {times}"]
        if self.wavelength_um is not None:
            parts.append(f"{self.wavelength_um:g} µm")
        return ", ".join(parts + [f"{name} {value}" for name, value in self.imaged])


class BenchFrames:
    """Frames of a bench and of benches that differ from it, recorded once and then read from a folder."""

    def __init__(self, bench: Bench, folder: Path) -> None:
        self.bench = bench
        self._folder = folder
        self.lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), bench.scale)
        self.wavelength_um = bench.wavelength_um or self.lens.wavelengths_um[0]
        self.patch, _ = lit_patch(self.lens, PatchSettings(patch_mm=bench.patch_mm), self.wavelength_um)
        first, last = self.lens.sensor.plane_distances_mm
        self.planes_mm = tuple(np.linspace(first, last, bench.planes).round(6).tolist())

    def object_field(
        self, thing: str | None = None, stop_um: tuple[float, float, float] | None = None
    ) -> Field:
        """Return the bench's object or another one; `stop_um` is x, y and diameter of a smaller stop."""
        aperture = self.lens.object.numerical_aperture
        made = make_object(thing or self.bench.thing, self.patch, aperture, self.bench.seed)
        return made if stop_um is None else with_stop(made, *stop_um)

    def truth(self, stop_um: tuple[float, float, float] | None = None) -> Path:
        """Return the folder that holds the true object."""
        folder = self._folder / f"object_{_digest(str((asdict(self.bench), stop_um)))}"
        if not (folder / OBJECT_FILE).exists():
            folder.mkdir(parents=True, exist_ok=True)
            stop_mm = self.patch.field_stop_mm
            write_field(self.object_field(stop_um=stop_um), folder / OBJECT_FILE, field_stop_mm=stop_mm)
        return folder

    def frames(
        self,
        lens: Lens | None = None,
        thing: str | None = None,
        stop_um: tuple[float, float, float] | None = None,
        **changes: Any,
    ) -> tuple[Frame, ...]:
        """Return frames of the bench, or of one with another lens, object, or other settings of `image`.

        All state the pixel pitch and the wavelength of the bench as it should be.
        """
        lens, changes = lens or self.lens, dict(changes)
        settings = {
            "exposures": self.bench.exposures,
            "planes_mm": self.planes_mm,
            "pixels": self.bench.pixels,
            "seed": self.bench.seed,
            **dict(self.bench.imaged),
            **changes,
        }
        wavelength_um = settings.pop("wavelength_um", self.wavelength_um)
        key = _digest(
            str((asdict(self.bench), lens.model_dump_json(), thing, stop_um, wavelength_um, settings))
        )
        folder = self._folder / f"frames_{key}"
        if not (folder / "complete.json").exists():
            transmission = replace(self.object_field(thing, stop_um), wavelength_um=wavelength_um)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                imaged = image(lens, transmission, field_stop_mm=self.patch.field_stop_mm, **settings)
            write_frames(imaged.frames, folder)
            about = {"bench": str(self.bench), "settings": settings, "files": len(imaged.frames)}
            (folder / "complete.json").write_text(json.dumps(about, default=str))
        count = json.loads((folder / "complete.json").read_text())["files"]
        stated = {
            "pixel_pitch_um": self.lens.sensor.pixel_pitch_um,
            "wavelength_um": self.wavelength_um,
        }
        frames = [read_frame(path) for path in frame_paths(folder, count)]
        return tuple(Frame(one.counts, one.settings.replaced(**stated)) for one in frames)

    def intensities(self, **changes: Any) -> list[NDArray[np.floating[Any]]]:
        """Return the mean intensity on each plane, without noise."""
        exact: dict[str, Any] = {"noise": False, "bits": 16, "exposures": MANY_EXPOSURES}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return [
                plane.amplitude.astype(float) ** 2
                for plane in recorded_planes(self.frames(**exact, **changes))
            ]


def write_frames(frames: Sequence[Frame], folder: Path) -> list[Path]:
    """Write frames into a folder and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = frame_paths(folder, len(frames))
    for frame, path in zip(frames, paths, strict=True):
        write_frame(frame, path)
    return paths


def frame_paths(folder: Path, count: int) -> list[Path]:
    """Return the paths of so many frames."""
    return [folder / f"frame_{number + 1}.tif" for number in range(count)]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]
