from .derivatives import Differentials, differentials
from .prediction import WavefrontPrediction, predict

__all__ = ["Differentials", "WavefrontPrediction", "differentials", "predict"]
