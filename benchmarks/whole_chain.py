"""The whole chain on a meridional line of the paper's lens: decenter and tilt against the reconstruction.

python -m benchmarks.whole_chain
"""

from __future__ import annotations

from lensdesign import Pose, load_design
from tolerancing.merits.reconstruction.line_chain import LineChain, ReconstructionEngine
from wavesim.scene.placement import NOMINAL, Placement

DECENTERS_MM, TILTS_DEG = (0.0, 0.00125, 0.005, 0.01, 0.02, 0.05), (0.02, 0.1, 0.2, 0.3, 0.5)
WIDTHS_UM, REGION_MM, ITERATIONS = (0.775, 1.55), 0.05, 40


def main() -> None:
    """Print a line for each pose: what the nominal and the true model find."""
    lens = load_design("designs/paper_singlet.toml")
    planes, wavelength = lens.sensor.plane_distances_mm, lens.wavelengths_um[0]
    chain = LineChain(lens, 0.0, REGION_MM, planes, "lines", WIDTHS_UM, wavelength, margin_mm=0.0)
    engine = ReconstructionEngine("eikonal")
    print("decenter mm, tilt deg: correlation, contrast of 0.775 um lines; correlation by the true model")
    poses = [Pose(decenter_y_mm=d) for d in DECENTERS_MM] + [Pose(tilt_x_deg=t) for t in TILTS_DEG]
    for pose in poses:
        system = Placement(pose)
        planes_seen = chain.recorded(system, None, 12, None)
        nominal, true = (
            chain.reconstructed(planes_seen, engine, model=model, iterations=ITERATIONS)
            for model in (NOMINAL, system)
        )
        print(
            f"{pose.decenter_y_mm:g}, {pose.tilt_x_deg:g}: {nominal.correlation:.3f}, "
            f"{nominal.contrasts[0]:.3f}; {true.correlation:.4f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
