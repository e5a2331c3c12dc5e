from .batch import PerturbationBatch, batch_of
from .dependence import Correlation, Dependence
from .distributions import DISTRIBUTIONS, Distribution
from .draws import DRAWS, probabilities, replicates
from .grades import GRADES, starting_study
from .parameters import PARAMETERS, Perturbation, PerturbedParameter, perturbation_from_table

__all__ = [
    "DISTRIBUTIONS",
    "DRAWS",
    "GRADES",
    "PARAMETERS",
    "Correlation",
    "Dependence",
    "Distribution",
    "Perturbation",
    "PerturbationBatch",
    "PerturbedParameter",
    "batch_of",
    "perturbation_from_table",
    "probabilities",
    "replicates",
    "starting_study",
]
