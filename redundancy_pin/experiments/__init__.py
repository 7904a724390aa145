"""The experiments of the thesis as frozen configurations, how to run them, and the main job that writes the results."""

from redundancy_pin.experiments.backends import BACKENDS
from redundancy_pin.experiments.experiment import Experiment
from redundancy_pin.experiments.job import Reproduction, reproduce
from redundancy_pin.experiments.result import Result
from redundancy_pin.experiments.run import run
from redundancy_pin.experiments.thesis import EXPERIMENTS

__all__ = ["BACKENDS", "EXPERIMENTS", "Experiment", "Reproduction", "Result", "reproduce", "run"]
