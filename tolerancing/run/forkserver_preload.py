"""Preload of everything that a worker process needs: importing this module imports it all.

Only the fork server of a command imports this module (:func:`lensdesign.common.processes.start_ahead`). The
workers are copies of that server, so they start without imports and with the compiled ray trace loaded.
"""

from __future__ import annotations

import ctypes
import gc
import signal
from importlib import import_module

MODULES = (
    "tolerancing.run.workers",
    "tolerancing.study.evaluate",
    "tolerancing.merits.sensor_rays",
    "lensdesign.analysis.extreme_rays",
    "lensdesign.analysis.exit_beam",
    "tolerancing.perturbations.irregularity",
    "wavesim.pupil.characteristic",
    "wavesim.pupil.focus",
    "wavesim.pupil.line_pairs",
    "wavesim.pupil.ray_aiming",
    "scipy.special",
)
"""Modules that trials by rays and pupils import only when they need them."""

PLATE = {
    "wavelengths_um": [0.5],
    "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 10.0},
    "sensor": {"pixel_pitch_um": 1.0, "pixels": [1, 1], "plane_distances_mm": [1.0]},
    "surface": [
        {"radius_mm": 50.0, "thickness_mm": 1.0, "material": 1.5, "semi_diameter_mm": 5.0, "stop": True},
        {"radius_mm": -50.0, "semi_diameter_mm": 5.0},
    ],
}
"""Smallest lens through which a ray can be traced, which loads the compiled ray trace."""


def preload() -> None:
    """Import the modules and trace one ray, then exclude all existing objects from garbage collection."""
    from lensdesign.lens.lens import Lens
    from lensdesign.raytrace.rays import trace

    gc.disable()
    for name in MODULES:
        import_module(name)
    trace(Lens.model_validate(PLATE), [[0.0, 0.0, -10.0]], [[0.0, 0.0, 1.0]], 2.0)
    gc.freeze()
    gc.enable()


def end_with_parent() -> None:
    """Let the kernel end this process with the command, which may be stopped during these imports."""
    set_parent_death_signal = 1  # PR_SET_PDEATHSIG in Linux's <sys/prctl.h>
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


end_with_parent()
preload()
