"""The journal of a study: one line for every finished trial."""

from __future__ import annotations

from redundancy_pin.experiments.journal import JournalKind
from redundancy_pin.experiments.robustness.trial import Trial, trial_from

TRIALS: JournalKind[Trial] = JournalKind(
    "redundancy_pin robustness journal", 2, "a robustness study", "study", "trial", trial_from
)
"""Version 1 had another header, and did not say what the controllers were."""
