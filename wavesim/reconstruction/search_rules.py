"""When a search ends, and how strong its automatic total variation is, by the kind of object and frames.

Amplitude and phase objects improve until their misfit has converged. A complex object has so many unknowns
that iterations beyond the noise would fit it, and on a whole field an iteration takes too long: both end at
the noise.

Converged objects of few photons need more total variation than the noise of a step alone demands. Longer
exposures measure faint light more precisely than the weights of its pixels tell, so that more total
variation would hide detail there, and may lead to a local minimum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wavesim.reconstruction.object_solver import USUAL_STEPS, StepRule
from wavesim.scene.engine import Engine, Tiled
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, full_weight_sigma

SINGLE_EXPOSURE_FACTOR = 1.4
"""Factor of the automatic total variation where no pixel has less than half of the standard deviation of the
brightest ones, as with single exposures.
"""

COARSE_STEPS = StepRule(relaxation=1.3, planes_in_turn=True)
"""Steps of the first iterations of an amplitude object of a whole field, on half of the samples.

Two inner iterations whose planes are processed in turn gain as much as four with all planes at once. They
fulfil the frames on the exit grid, but the object can follow only about half of the change there. A longer
step makes up for a part of that. With such steps on all samples, objects on a dark ground would end in a
local minimum.
"""


def coarse_step_rule(kind: Kind) -> StepRule:
    """Return the rule of the steps on half of the samples for a kind of object."""
    return COARSE_STEPS if kind == "amplitude" else USUAL_STEPS


def ends_at_noise(kind: Kind, engine: Engine) -> bool:
    """Return whether iterations end at the noise, and not where the misfit has converged."""
    return kind == "complex" or isinstance(engine, Tiled)


def tv_factor(kind: Kind, engine: Engine, recorded: Sequence[Measurement]) -> float:
    """Return the factor of the automatic total variation: from 1 to `SINGLE_EXPOSURE_FACTOR`."""
    if ends_at_noise(kind, engine):
        return 1.0
    # The factor is 1 where this fraction of the pixels has less than half of the standard deviation.
    enough = 0.5
    full, precise, known = full_weight_sigma(recorded), 0, 0
    for plane in recorded:
        if plane.sigma is not None:
            precise += int(np.count_nonzero(plane.sigma < 0.5 * full))
            known += int(np.count_nonzero(np.isfinite(plane.sigma)))
    fraction = min(precise / max(enough * known, 1.0), 1.0)
    return SINGLE_EXPOSURE_FACTOR + fraction * (1.0 - SINGLE_EXPOSURE_FACTOR)
