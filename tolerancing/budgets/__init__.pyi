from .study_budget import BudgetInterrupted, StudyBudget, budget, budget_of_study, scaled_study
from .tolerance_search import Budget, loosest_tolerances

__all__ = [
    "Budget",
    "BudgetInterrupted",
    "StudyBudget",
    "budget",
    "budget_of_study",
    "loosest_tolerances",
    "scaled_study",
]
