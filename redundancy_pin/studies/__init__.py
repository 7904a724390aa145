"""Studies on shipped robots: the reproduction of the thesis; one kind of case, one memo of plans, one table."""

from redundancy_pin.studies.case import BACKENDS, Case, Plans
from redundancy_pin.studies.cases import FULL, MOTIONS, QUICK, Extent
from redundancy_pin.studies.reproduce import Reproduction, reproduce

__all__ = ["BACKENDS", "FULL", "MOTIONS", "QUICK", "Case", "Extent", "Plans", "Reproduction", "reproduce"]
