from .arrivals import ArrivalDifferentials, arrival_differentials
from .derivatives import Differentials, differentials
from .prediction import WavefrontPrediction, predict
from .rays import RayPrediction, predict_rays

__all__ = [
    "ArrivalDifferentials",
    "Differentials",
    "RayPrediction",
    "WavefrontPrediction",
    "arrival_differentials",
    "differentials",
    "predict",
    "predict_rays",
]
