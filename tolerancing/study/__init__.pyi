from .evaluate import (
    context_of,
    decide_levels,
    nominal_scores,
    sample_perturbations,
    score_high_fidelity,
    score_step,
    score_trials,
)
from .files import LoadedStudy, load_from_files, load_study, save_study, start_study
from .priors import Priors, calibration_priors
from .results import HighFidelityResults, Picture, StepResults, TrialResults
from .scoring import score_batch
from .series import Series
from .slice_counts import SliceCounts
from .study import Fidelity, Study
from .sweep import STEPS, OneAtATime, ParameterGrid, Sweep

__all__ = [
    "STEPS",
    "Fidelity",
    "HighFidelityResults",
    "LoadedStudy",
    "OneAtATime",
    "ParameterGrid",
    "Picture",
    "Priors",
    "Series",
    "SliceCounts",
    "StepResults",
    "Study",
    "Sweep",
    "TrialResults",
    "calibration_priors",
    "context_of",
    "decide_levels",
    "load_from_files",
    "load_study",
    "nominal_scores",
    "sample_perturbations",
    "save_study",
    "score_batch",
    "score_high_fidelity",
    "score_step",
    "score_trials",
    "start_study",
]
