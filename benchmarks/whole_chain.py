"""The whole chain on a meridional line of the paper's lens: decenter and tilt against the reconstruction.

With `--twin`, contrast of bars on a 1/48 twin, beside that of the chain in the plane.

python -m benchmarks.whole_chain [--twin]
"""

from __future__ import annotations

import argparse

import numpy as np

from lensdesign import Pose, load_design, scaled
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.reconstructed_contrast import ReconstructedContrast
from tolerancing.merits.reconstruction.line_imaging_chain import LineImagingChain, ReconstructionEngine
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter
from wavesim.scene.system_state import AS_DESIGNED, SystemState

DECENTERS_MM, TILTS_DEG = (0.0, 0.00125, 0.005, 0.01, 0.02, 0.05), (0.02, 0.1, 0.2, 0.3, 0.5)
WIDTHS_UM, REGION_MM, ITERATIONS = (0.775, 1.55), 0.05, 40


def twin() -> None:
    """Print a line for each perturbation of a twin: contrast on the line, and in the plane."""
    lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 48)
    planes, wavelength = lens.sensor.plane_distances_mm, lens.wavelengths_um[0]
    chain = LineImagingChain(lens, 0.0, REGION_MM, planes, "lines", (1.2,), wavelength, margin_mm=0.0)
    settings = {"line_width_um": 1.2, "patch_mm": REGION_MM, "orientation": "y", "refocus": False}
    plane = ReconstructedContrast(kind="reconstructed_contrast", at_least=0.5, iterations=20, **settings)
    print("parameter, value: contrast of 1.2 µm bars on the line, in the plane")
    for name, values in (("decenter_y_mm", (0.0, 0.00125, 0.0025, 0.008)), ("tilt_x_deg", (0.1, 0.2, 0.4))):
        parameter = PerturbedParameter(target="lens", parameter=name)
        batch = PerturbationBatch((parameter,), np.array(values)[:, None])
        in_plane = plane.scores(Context(lens, Sampling()), batch)
        for value, other in zip(values, in_plane, strict=True):
            seen = chain.record(SystemState(Pose(**{name: value})), None, 12, None)
            found = chain.reconstruct(seen, ReconstructionEngine("eikonal"), iterations=ITERATIONS)
            print(f"{name}, {value:g}: {found.contrasts[0]:.3f}, {other:.3f}", flush=True)


def main() -> None:
    """Print a line for each pose: what the nominal and the true model find."""
    lens = load_design("designs/paper_singlet.toml")
    planes, wavelength = lens.sensor.plane_distances_mm, lens.wavelengths_um[0]
    chain = LineImagingChain(lens, 0.0, REGION_MM, planes, "lines", WIDTHS_UM, wavelength, margin_mm=0.0)
    engine = ReconstructionEngine("eikonal")
    print("decenter mm, tilt deg: correlation, contrast of 0.775 µm lines; correlation by the true model")
    poses = [Pose(decenter_y_mm=d) for d in DECENTERS_MM] + [Pose(tilt_x_deg=t) for t in TILTS_DEG]
    for pose in poses:
        system = SystemState(pose)
        planes_seen = chain.record(system, None, 12, None)
        nominal, true = (
            chain.reconstruct(planes_seen, engine, model=model, iterations=ITERATIONS)
            for model in (AS_DESIGNED, system)
        )
        print(
            f"{pose.decenter_y_mm:g}, {pose.tilt_x_deg:g}: {nominal.correlation:.3f}, "
            f"{nominal.contrasts[0]:.3f}; {true.correlation:.4f}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--twin", action="store_true", help="the twin, on a line and in the plane")
    twin() if parser.parse_args().twin else main()
