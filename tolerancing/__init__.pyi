from .budgets.study_budget import StudyBudget, budget, scaled_study
from .merits.base import Merit
from .perturbations.batch import PerturbationBatch
from .perturbations.distributions import Distribution
from .perturbations.parameters import Perturbation
from .report.figures.one_trial import write_trial_figure
from .report.report import write_report
from .run.executors import RunError
from .run.run import RunOutcome, run_study
from .statistics.limits import StudyLimits, inverse
from .statistics.sensitivities import StudySensitivity, sensitivity
from .statistics.summary import Summary, summarize
from .statistics.trial import SingleTrial, single_trial
from .statistics.yields import Yield
from .store.export import write_steps, write_trials
from .store.store import Store, open_store
from .study.evaluate import sample_perturbations
from .study.files import LoadedStudy, load_study, save_study, start_study
from .study.study import Study

__all__ = [
    "Distribution",
    "LoadedStudy",
    "Merit",
    "Perturbation",
    "PerturbationBatch",
    "RunError",
    "RunOutcome",
    "SingleTrial",
    "Store",
    "Study",
    "StudyBudget",
    "StudyLimits",
    "StudySensitivity",
    "Summary",
    "Yield",
    "budget",
    "inverse",
    "load_study",
    "open_store",
    "run_study",
    "sample_perturbations",
    "save_study",
    "scaled_study",
    "sensitivity",
    "single_trial",
    "start_study",
    "summarize",
    "write_report",
    "write_steps",
    "write_trial_figure",
    "write_trials",
]
