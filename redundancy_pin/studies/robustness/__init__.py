"""Robustness: machines that are not quite as planned, driven through singularities, many times."""

from redundancy_pin.studies.robustness.study import (
    DRAWS,
    Study,
    robustness_study,
    study_caption,
    study_csv,
    study_table,
)
from redundancy_pin.studies.robustness.trial import Imperfections, Scenario

__all__ = [
    "DRAWS",
    "Imperfections",
    "Scenario",
    "Study",
    "robustness_study",
    "study_caption",
    "study_csv",
    "study_table",
]
