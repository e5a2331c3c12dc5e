from .bundles import PupilSamples, launch, launch_compiled, pupil_fan, pupil_hexapolar, pupil_rings
from .compiled import CompiledSystem, compile_system
from .ghosts import ghost_system
from .gradients import GradientTrace, at_wavelengths, gradient_traces
from .paths import ray_paths, sized_lens
from .plane_plate import PlanePlate, cover_plate
from .polarization import (
    PolarizedRays,
    jones_matrices,
    polarization_matrices,
    trace_polarized,
    transverse_basis,
)
from .rays import RayTrace, trace, trace_compiled
from .status import Status

__all__ = [
    "CompiledSystem",
    "GradientTrace",
    "PlanePlate",
    "PolarizedRays",
    "PupilSamples",
    "RayTrace",
    "Status",
    "at_wavelengths",
    "compile_system",
    "cover_plate",
    "ghost_system",
    "gradient_traces",
    "jones_matrices",
    "launch",
    "launch_compiled",
    "polarization_matrices",
    "pupil_fan",
    "pupil_hexapolar",
    "pupil_rings",
    "ray_paths",
    "sized_lens",
    "trace",
    "trace_compiled",
    "trace_polarized",
    "transverse_basis",
]
