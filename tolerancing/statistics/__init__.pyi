from .control_variates import choose_trials, combined_mean, combined_yield
from .correlation import rank_correlation
from .indices import IndicesError, VarianceIndices, variance_indices
from .limits import InverseLimit, StudyLimits, inverse, inverse_limits
from .rare_failures import RareYield, rare_yield
from .response import Response, fit_response
from .scorer import StudyScorer, scatter_of
from .sensitivities import (
    Sensitivity,
    StudySensitivity,
    compare_with_trials,
    root_sum_square,
    sensitivity,
)
from .summary import MeritSummary, Summary, summarize
from .trial import SingleTrial, single_trial
from .yields import Yield, yield_of

__all__ = [
    "IndicesError",
    "InverseLimit",
    "MeritSummary",
    "RareYield",
    "Response",
    "Sensitivity",
    "SingleTrial",
    "StudyLimits",
    "StudyScorer",
    "StudySensitivity",
    "Summary",
    "VarianceIndices",
    "Yield",
    "choose_trials",
    "combined_mean",
    "combined_yield",
    "compare_with_trials",
    "fit_response",
    "inverse",
    "inverse_limits",
    "rank_correlation",
    "rare_yield",
    "root_sum_square",
    "scatter_of",
    "sensitivity",
    "single_trial",
    "summarize",
    "variance_indices",
    "yield_of",
]
