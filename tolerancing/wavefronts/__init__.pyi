from .arrivals import ArrivalDifferentials, arrival_differentials
from .derivatives import Differentials, differentials
from .prediction import WavefrontPrediction, predict
from .rays import RayPrediction, predict_rays
from .study_prediction import LimitPrediction, StudyPrediction, predict_study

__all__ = [
    "ArrivalDifferentials",
    "Differentials",
    "LimitPrediction",
    "RayPrediction",
    "StudyPrediction",
    "WavefrontPrediction",
    "arrival_differentials",
    "differentials",
    "predict",
    "predict_rays",
    "predict_study",
]
