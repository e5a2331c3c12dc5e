from .allocation import Budget, allocate_tolerances
from .study_budget import BudgetInterrupted, StudyBudget, budget, budget_of_study, scaled_study

__all__ = [
    "Budget",
    "BudgetInterrupted",
    "StudyBudget",
    "allocate_tolerances",
    "budget",
    "budget_of_study",
    "scaled_study",
]
