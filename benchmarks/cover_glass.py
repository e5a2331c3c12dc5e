"""Frames behind a cover glass of the sensor, reconstructed with designs with and without it."""

from __future__ import annotations

import warnings

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import CoverGlass, Lens, load_design, scaled
from wavesim import SamplingWarning, image, reconstruct_frames
from wavesim.sensor.camera_noise import SaturationWarning

SCALE, PATCH_MM, PLANES_MM = 0.125, 0.3, (1.5, 3.5)
GLASS = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)


def main() -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", SamplingWarning)
    warnings.simplefilter("ignore", SaturationWarning)
    lens = scaled(load_design(DESIGNS / "paper_singlet.toml"), SCALE)
    bare = lens.replaced(sensor=lens.sensor.replaced(plane_distances_mm=PLANES_MM))
    covered = bare.replaced(sensor=bare.sensor.replaced(cover_glass=GLASS))
    rows = [
        *rows_of("with the glass, design with it", covered, covered),
        *rows_of("without glass, design without it", bare, bare),
        *rows_of("with the glass, design without it", covered, bare),
    ]
    print_table(
        f"{GLASS.thickness_mm:g} mm of {GLASS.material} in front of the sensor; the paper's lens at "
        f"1/{1 / SCALE:g} of its size, planes at {PLANES_MM[0]:g} and {PLANES_MM[1]:g} mm",
        rows,
    )


def rows_of(name: str, recorded: Lens, assumed: Lens) -> list[Row]:
    """Reconstruct frames of one design with another one."""
    imaged = image(recorded, "usaf", patch_mm=PATCH_MM, exposures=(1.0, 30.0), seed=0)
    found = reconstruct_frames(
        assumed,
        imaged.frames,
        patch_mm=PATCH_MM,
        kind="amplitude",
        truth=imaged.target.transmission,
    )
    correlation = found.truth["object_correlation"]
    assert correlation is not None  # the true object is given
    return [
        Row(name, correlation, "correlation"),
        Row(f"{name}: misfit at the end", found.curve[-1]),
    ]


if __name__ == "__main__":
    main()
