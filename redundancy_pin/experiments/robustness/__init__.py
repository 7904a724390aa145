"""Robustness: machines that are not quite as planned, driven through singularities, many times."""

from redundancy_pin.experiments.robustness.draws import Imperfections
from redundancy_pin.experiments.robustness.study import DRAWS, Study, robustness_study
from redundancy_pin.experiments.robustness.tables import study_csv, study_table

__all__ = ["DRAWS", "Imperfections", "Study", "robustness_study", "study_csv", "study_table"]
