"""Tilt of the lens and slices of the reconstruction together, about several pivots.

Lines on a meridional line are carried through the tilted lens by the eikonal engine, and brought back through
the nominal one by several engines. What comes back is registered sideways, and refocused or left where it is.

    python -m benchmarks.tilt_and_slices
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import scipy.fft

from lensdesign import Pose, load_design
from wavesim import SamplingWarning, engine_for
from wavesim.metrics.resolving import bars_field, contrasts_of, meridional_scene, register

WIDTHS_UM, BARS, TILTS_DEG = (0.775, 1.55), 5, (0.0, 0.3, 0.5)
PIVOTS_MM = {
    "front vertex": 0.0,
    "middle": 4.85,
    "exit vertex": 9.7,
    "first plane": 11.7,
    "second plane": 31.7,
    "object": -13.5,
}
ENGINES = {
    "eikonal": {},
    "10 oblique slices": {"slices": 10, "compensation": "oblique"},
    "200 vertical slices": {"slices": 200, "compensation": "vertical"},
    "500 vertical slices": {"slices": 500, "compensation": "vertical"},
}
MARGIN_MM = 0.36
"""About the lines, which a tilt about a distant pivot displaces by some tenths of a millimetre."""


def left_in_place(seen: np.ndarray, target: np.ndarray) -> np.ndarray:
    """A field on a line, shifted to where its intensity is most like the target's."""
    count = 2 * len(seen)
    spectra = [scipy.fft.rfft(np.abs(one) ** 2, count) for one in (seen, target)]
    lag = int(np.argmax(scipy.fft.irfft(spectra[0] * spectra[1].conj(), count)))
    return np.roll(seen, count - lag if lag > count // 2 else -lag)


def main() -> None:
    """Print a line for each tilt, pivot, line width and engine."""
    lens = load_design("designs/paper_singlet.toml")
    scene = meridional_scene(lens, max(WIDTHS_UM), 0.0, BARS, margin_mm=MARGIN_MM)
    grid, wavelength = scene.object_grid, scene.wavelength_um
    truth = engine_for(scene, "eikonal")
    engines = {
        name: engine_for(scene, "slices" if settings else "eikonal", **settings)
        for name, settings in ENGINES.items()
    }
    print("tilt deg, pivot, lines µm, engine: contrast refocused, left in place; focus µm, shift µm")
    for tilt, (pivot, z_mm), width in product(TILTS_DEG, PIVOTS_MM.items(), WIDTHS_UM):
        if tilt == 0.0 and z_mm != 0.0:
            continue
        lines = bars_field(grid, wavelength, width, BARS)
        target = np.asarray(truth.adjoint(truth.forward(lines)).values)
        lens_as_it_is = engine_for(replace(scene, pose=Pose(tilt_x_deg=tilt, pivot_z_mm=z_mm)), "eikonal")
        light, contrast = lens_as_it_is.forward(lines), contrasts_of(grid, width, BARS)
        for name, engine in engines.items():
            seen = np.asarray(engine.adjoint(light).values)
            focus_mm, shift_mm, moved = register(seen, target, grid, wavelength)
            found = contrast(moved)[0], contrast(left_in_place(seen, target))[0]
            print(
                f"{tilt:g}, {pivot}, {width:g}, {name}: {found[0]:.2f}, {found[1]:.2f}; "
                f"{1e3 * focus_mm:.2f}, {1e3 * shift_mm:.1f}",
                flush=True,
            )


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        main()
