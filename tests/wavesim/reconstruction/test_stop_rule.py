"""Rule by which the iterations of the object solver end."""

from __future__ import annotations

import numpy as np
import pytest

from wavesim.reconstruction.stop_rule import SPAN, SPAN_AFTER_RISE, TOLERANCE, stop_reason


def test_a_misfit_that_falls_ends_where_it_hardly_changes() -> None:
    misfits = tuple(1.0 + 0.5 ** np.arange(30.0))
    reasons = [stop_reason(misfits[:count], None, until_noise=False) for count in range(1, 31)]
    first = reasons.index("converged")
    assert misfits[first - SPAN] / misfits[first] - 1.0 < TOLERANCE
    assert misfits[first - 1 - SPAN] / misfits[first - 1] - 1.0 > TOLERANCE
    assert reasons[first:] == ["converged"] * (30 - first)


@pytest.mark.parametrize("height", [2.0 * TOLERANCE, 0.5 * TOLERANCE], ids=["high", "flat"])
def test_a_maximum_is_no_convergence_unless_it_is_flat(height: float) -> None:
    """With the total variation, the misfit rises at first. Around a maximum it is equal on both sides."""
    around = np.linspace(-1.0, 1.0, SPAN_AFTER_RISE + 1)
    misfits = [0.9, *(1.0 + height * (1.0 - around**2))]
    expected = None if height > TOLERANCE else "converged"
    assert stop_reason(misfits, None, until_noise=False) == expected


def test_a_plateau_after_a_rise_is_no_convergence() -> None:
    """Dense strokes: the total variation began, and the object still changed by 2 % in each iteration."""
    misfits = [1.1664, 1.1662, 1.1850, 1.2202, 1.2624, 1.3842, 1.4472, 1.4652, 1.4610, 1.4522, 1.4456]
    misfits += [1.44260, 1.44143, 1.44106, 1.44133, 1.44162, 1.44159, 1.44106]
    assert stop_reason(misfits, 1.0, until_noise=False) is None
    near_noise = 1.4
    assert stop_reason(misfits, near_noise, until_noise=False) == "converged"
