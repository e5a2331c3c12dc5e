from .data import ReportData
from .figures.one_trial import trial_figure, write_trial_figure
from .report import ReportFiles, report_data, report_of, write_report

__all__ = [
    "ReportData",
    "ReportFiles",
    "report_data",
    "report_of",
    "trial_figure",
    "write_report",
    "write_trial_figure",
]
