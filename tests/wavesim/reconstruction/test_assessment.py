"""Assessment of a result: residuals of an engine decrease with its error, those of a wrong bench do not."""

import pytest

from wavesim.reconstruction.assessment import follows_engine_error


@pytest.mark.parametrize(
    ("misfit", "follows"), [(0.010, True), (0.0119, True), (0.015, False), (0.02, False)]
)
def test_only_residuals_that_decrease_with_the_engines_error_are_its_own(
    misfit: float, follows: bool
) -> None:
    before, after = (0.04, 0.02), (0.015, misfit)
    assert follows_engine_error(before, after) is follows
    assert follows_engine_error(before, before)
