"""When iterations of a reconstruction end, and what is gained after the misfit has come to the noise."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, scaled
from wavesim import SamplingWarning, image, reconstruct_frames
from wavesim.sensor.camera_noise import SaturationWarning
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.measurement import noise_misfit

SCALE, PATCH_MM = 1.0 / 16.0, 0.16
IMAGED_BY = {"engine": "eikonal", "error": 0.01, "full_well_electrons": 10_000.0, "seed": 1}


@dataclass(frozen=True)
class Kind:
    """An object, how it is sought, and what is recorded of it."""

    name: str
    object: str
    kind: str
    planes: int
    exposures: tuple[float, ...]


KINDS = (
    Kind("USAF chart of amplitude", "usaf", "amplitude", 2, (1.0, 30.0, 1000.0)),
    Kind("the same, one exposure", "usaf", "amplitude", 2, (1.0,)),
    Kind("pads of phase", "phase", "complex", 4, (1.0, 30.0, 1000.0)),
    Kind("tissue, amplitude and phase", "tissue", "complex", 4, (1.0, 30.0, 1000.0)),
    Kind("the same, one exposure of two planes", "tissue", "complex", 2, (1.0,)),
)


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    warnings.simplefilter("ignore", SaturationWarning)
    rows = [row for kind in KINDS for row in ends_of(kind)]
    print_table(
        f"Iterations of the paper's lens at 1/{1 / SCALE:g} of its size, patch of {PATCH_MM} mm", rows
    )


def ends_of(kind: Kind) -> list[Row]:
    """Where the misfit first is what noise alone leaves, and where iterations end."""
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    planes_mm = tuple(np.linspace(*lens.sensor.plane_distances_mm, kind.planes))
    imaged = image(
        lens, kind.object, patch_mm=PATCH_MM, planes_mm=planes_mm, exposures=kind.exposures, **IMAGED_BY
    )
    noise = noise_misfit(recorded_planes(imaged.frames))
    assert noise is not None

    def found(**changes: Any) -> Any:
        return reconstruct_frames(
            lens,
            imaged.frames,
            patch_mm=PATCH_MM,
            kind=kind.kind,
            truth=imaged.target.transmission,
            **changes,
        )

    started = time.process_time()
    whole = found()
    seconds = time.process_time() - started
    over = np.array(whole.curve) / noise
    first = int(np.argmax(over <= 1.0)) + 1 if np.any(over <= 1.0) else None
    rows = []
    if first is not None:
        early = found(iterations=first).truth["object_correlation"]
        rows.append(Row(f"{kind.name}: at the noise after {first}", early, "correlation"))
    end = f"{kind.name}: {len(over)}, {whole.of_method['stopped_because']}, {over[-1]:.2f} of the noise"
    return [
        *rows,
        Row(end, whole.truth["object_correlation"], "correlation"),
        Row(f"{kind.name}: processor time", seconds, "s"),
    ]


if __name__ == "__main__":
    main()
