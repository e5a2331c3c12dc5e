"""Single values."""

import numpy as np
import pytest
from pydantic import ValidationError

from lensdesign.errors import DesignError
from tolerancing.perturbations.distributions.discrete import Discrete
from tolerancing.perturbations.parameters import perturbation_from_table


def test_each_value_is_as_likely_as_the_others():
    shape = Discrete(values=(10.0, 30.0, 50.0), mean=1.0)
    drawn = shape.quantile((np.arange(300) + 0.5) / 300)
    assert np.unique(drawn, return_counts=True)[1].tolist() == [100, 100, 100]
    assert set(drawn) == {11.0, 31.0, 51.0}
    assert shape.quantile(np.array([0.0, 1.0])).tolist() == [11.0, 51.0]


@pytest.mark.parametrize("values", [(1.0,), (2.0, 1.0), (1.0, 1.0)])
def test_values_increase(values):
    with pytest.raises(ValidationError, match="values"):
        Discrete(values=values)


def slices(**keys):
    return perturbation_from_table({"target": "reconstruction", "parameter": "slices"} | keys, "here")


def test_slices_are_whole_numbers():
    assert slices(distribution="discrete", values=[10, 30]).column == "reconstruction_slices"
    with pytest.raises(DesignError, match=r"reconstruction_slices = 10\.5.*whole number"):
        slices(distribution="discrete", values=[10.5, 30])
    with pytest.raises(DesignError, match=r"distribution = 'normal'.*discrete"):
        slices(distribution="normal", sigma=3.0)
