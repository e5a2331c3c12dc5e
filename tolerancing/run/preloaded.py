"""What is ready in every worker of a command: importing this imports it, and loads the compiled trace.

Only the server imports it whose copies those workers are (:func:`tolerancing.run.processes.start_ahead`).
"""

from __future__ import annotations

import ctypes
import gc
import signal
from importlib import import_module

MODULES = (
    "tolerancing.run.workers",
    "tolerancing.study.evaluate",
    "tolerancing.merits.arrival",
    "lensdesign.analysis.extreme_rays",
    "lensdesign.analysis.spread",
    "tolerancing.perturbations.irregularity",
    "wavesim.pupil.characteristic",
    "wavesim.pupil.focus",
    "wavesim.pupil.line_pairs",
    "wavesim.pupil.ray_aiming",
    "scipy.special",
)
"""What trials by rays and pupils import, here and there, when they need it."""

PR_SET_PDEATHSIG = 1
"""As Linux has it."""

PLATE = {
    "wavelengths_um": [0.5],
    "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 10.0},
    "sensor": {"pixel_pitch_um": 1.0, "pixels": [1, 1], "plane_distances_mm": [1.0]},
    "surface": [
        {"radius_mm": 50.0, "thickness_mm": 1.0, "material": 1.5, "semi_diameter_mm": 5.0, "stop": True},
        {"radius_mm": -50.0, "semi_diameter_mm": 5.0},
    ],
}


def preload() -> None:
    """Import, trace one ray, and keep the collector of garbage away from what is there for good."""
    from lensdesign.lens.lens import Lens
    from lensdesign.raytrace.rays import trace

    gc.disable()
    for name in MODULES:
        import_module(name)
    trace(Lens.model_validate(PLATE), [[0.0, 0.0, -10.0]], [[0.0, 0.0, 1.0]], 2.0)
    gc.freeze()
    gc.enable()


def end_with_parent() -> None:
    """Have the system end this process with the command, which may be stopped while all this is imported."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


end_with_parent()
preload()
