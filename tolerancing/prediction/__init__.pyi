from .derivatives import Differentials, differentials
from .ray_prediction import RayPrediction, predict_rays
from .sensor_ray_derivatives import ArrivalDifferentials, arrival_differentials
from .study_prediction import LimitPrediction, StudyPrediction, predict_study
from .wavefront_prediction import WavefrontPrediction, predict

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
