"""Whole fields with the engine `hierarchical`: iterations, engine passes, processor time and correlation.

Objects on a twin of the paper's lens are imaged and reconstructed with `engine="hierarchical"`, up to the end
of the search. A pass is one use of the engine forward or back, counted by the number of object samples: a
pass on half of the samples along each side counts as 1/4. With --frames the frames stay in a folder. This
file also runs as a script against another version of the toolkit, from the same folder of frames::

    PYTHONPATH=OTHER python benchmarks/whole_field.py --frames FOLDER

The run of the full-size lens is that of docs/reconstruction.md, "The whole field".
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np

DESIGN = Path(__file__).resolve().parents[1] / "designs" / "paper_singlet.toml"

PITCH_UM, ITERATIONS = 0.3875, 15
"""Pitch of the object's samples, and largest number of iterations on all samples."""

OBJECTS = {
    "usaf": ("usaf", "amplitude", "bright"),
    "usaf dark": ("usaf", "amplitude", "dark"),
    "camera": ("camera", "amplitude", "bright"),
    "tissue": ("tissue", "complex", "bright"),
    "pads": ("phase", "phase", "bright"),
}
"""Built-in object or photograph of scikit-image, the kind that is sought, and the ground."""


class SearchEnded(Exception):
    """Ends a reconstruction before the tests of its verdict."""


def photograph(patch: Any) -> Any:
    """Return the grey photograph "camera" as an amplitude on a patch."""
    from skimage import data
    from skimage.transform import resize

    from wavesim import Field

    values = resize(data.camera() / 255.0, patch.grid.shape, anti_aliasing=True)[::-1]
    return Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)


def recorded(path: Path, name: str, scale: float) -> Any:
    """Return frames, true object and field stop of an object, from a file if they have been recorded."""
    from lensdesign import load_design, scaled
    from wavesim import image
    from wavesim.scene.settings import PatchSettings
    from wavesim.targets.patch import lit_patch

    if path.exists():
        return pickle.loads(path.read_bytes())
    lens = scaled(load_design(DESIGN), scale)
    patch, _ = lit_patch(lens, PatchSettings(object_pitch_um=PITCH_UM), lens.wavelengths_um[0])
    what, _, ground = OBJECTS[name]
    is_photograph = what == "camera"
    imaged = image(
        lens,
        photograph(patch) if is_photograph else what,
        engine="hierarchical",
        exposures=(1.0, 30.0, 1000.0),
        ground=ground,
        seed=1,
        field_stop_mm=patch.field_stop_mm,
        object_pitch_um=None if is_photograph else PITCH_UM,
    )
    result = imaged.frames, imaged.target.transmission, patch.field_stop_mm
    path.write_bytes(pickle.dumps(result))
    return result


def counted_passes(passes: list[int]) -> Callable[[], None]:
    """Append the number of object samples of each pass through an engine; return a function that ends it."""
    from wavesim.engines.eikonal.engine import HierarchicalTiles

    originals = {name: getattr(HierarchicalTiles, name) for name in ("forward", "adjoint")}

    def counted(original: Any) -> Any:
        def use(self: Any, field: Any) -> Any:
            passes.append(self.scene.object_grid.size)
            return original(self, field)

        return use

    for name, original in originals.items():
        setattr(HierarchicalTiles, name, counted(original))

    def end() -> None:
        for name, original in originals.items():
            setattr(HierarchicalTiles, name, original)

    return end


def result(path: Path, name: str, scale: float) -> str:
    """Reconstruct an object, and return the figures as a row of a table."""
    from lensdesign import load_design, scaled
    from wavesim import reconstruct_frames

    frames, true, stop_mm = recorded(path, name, scale)
    results: list[tuple[Any, float]] = []
    passes: list[int] = []

    def on_found(found: Any) -> None:
        results.append((found, process_time() - begun))
        raise SearchEnded

    end, begun = counted_passes(passes), process_time()
    try:
        reconstruct_frames(
            scaled(load_design(DESIGN), scale),
            frames,
            kind=OBJECTS[name][1],
            engine="hierarchical",
            iterations=ITERATIONS,
            object_pitch_um=PITCH_UM,
            field_stop_mm=stop_mm,
            truth=true,
            on_found=on_found,
        )
    except SearchEnded:
        pass
    finally:
        end()
    (found, seconds), units = results[0], sum(passes) / true.values.size
    figures = [str(len(found.curve)), found.of_method["stopped_because"], f"{units:.1f}", f"{seconds:.1f}"]
    figures += [f"{found.of_method['misfit']:.5f}", f"{found.truth['object_correlation']:.5f}"]
    return f"| {name} | {' | '.join(figures)} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Reconstruct all objects and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"objects, of {', '.join(OBJECTS)}; default: all")
    parser.add_argument("--twin", type=int, default=16, help="size of the paper's lens over the twin's")
    parser.add_argument("--frames", type=Path, help="folder that keeps recorded frames for the next run")
    given = parser.parse_args(arguments)
    heads = ("object", "iterations", "end", "passes", "processor time (s)", "misfit", "correlation")
    print(f"| {' | '.join(heads)} |\n| {' | '.join('---' for _ in heads)} |", flush=True)
    with TemporaryDirectory() as temporary:
        folder = given.frames or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name in given.names or OBJECTS:
            path = folder / f"{name.replace(' ', '_')}_{given.twin}.pickle"
            print(result(path, name, 1.0 / given.twin), flush=True)


if __name__ == "__main__":
    main()
