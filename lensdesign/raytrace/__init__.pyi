from .bundles import PupilSamples, launch, launch_compiled, pupil_fan, pupil_hexapolar, pupil_rings
from .compiled import CompiledSystem, compile_system
from .ghosts import ghost_system
from .gradients import GradientTrace, gradient_trace
from .paths import ray_paths, sized_lens
from .rays import RayTrace, trace, trace_compiled
from .status import Status

__all__ = [
    "CompiledSystem",
    "GradientTrace",
    "PupilSamples",
    "RayTrace",
    "Status",
    "compile_system",
    "ghost_system",
    "gradient_trace",
    "launch",
    "launch_compiled",
    "pupil_fan",
    "pupil_hexapolar",
    "pupil_rings",
    "ray_paths",
    "sized_lens",
    "trace",
    "trace_compiled",
]
