from .registry import AnalyticCase, analytic_case

__all__ = [
    "AnalyticCase",
    "analytic_case",
]
