from .budgets import BudgetInterrupted, StudyBudget, budget, budget_of_study, scaled_study
from .control_variates import choose_trials, combined_mean, combined_yield
from .correlation import rank_correlation
from .limits import InverseLimit, StudyLimits, inverse, inverse_limits
from .parabolas import Sensitivity, compare_with_trials, root_sum_square
from .response import Response, fit_response
from .scorer import StudyScorer, scatter_of
from .sensitivities import StudySensitivity, sensitivity
from .summary import MeritSummary, Summary, summarize
from .tolerance_search import Budget, loosest_tolerances
from .trial import SingleTrial, single_trial
from .yields import Yield, yield_of

__all__ = [
    "Budget",
    "BudgetInterrupted",
    "InverseLimit",
    "MeritSummary",
    "Response",
    "Sensitivity",
    "SingleTrial",
    "StudyBudget",
    "StudyLimits",
    "StudyScorer",
    "StudySensitivity",
    "Summary",
    "Yield",
    "budget",
    "budget_of_study",
    "choose_trials",
    "combined_mean",
    "combined_yield",
    "compare_with_trials",
    "fit_response",
    "inverse",
    "inverse_limits",
    "loosest_tolerances",
    "rank_correlation",
    "root_sum_square",
    "scaled_study",
    "scatter_of",
    "sensitivity",
    "single_trial",
    "summarize",
    "yield_of",
]
