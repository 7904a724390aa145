"""Plans that were made once: tables, figures and comparisons share them, and those of the thesis's chapters."""

from __future__ import annotations

from dataclasses import dataclass, field

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.cases import Case
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.plan import Plan


@dataclass
class BeyondStore:
    """Makes plans on demand and keeps them; the one thing in this chapter that changes while it runs.

    Attributes:
        thesis: the plans of the thesis's own chapters.
    """

    thesis: PlanStore
    _plans: dict[tuple[Case, str], Plan | InfeasiblePlanError] = field(default_factory=dict)

    def plan(self, case: Case, backend: str) -> Plan:
        """Return the plan of a case.

        Raises:
            InfeasiblePlanError: there is none.
        """
        found = self.outcome(case, backend)
        if isinstance(found, InfeasiblePlanError):
            raise found
        return found

    def outcome(self, case: Case, backend: str) -> Plan | InfeasiblePlanError:
        """Return the plan of a case, or why there is none."""
        key = (case, backend)
        if key not in self._plans:
            try:
                self._plans[key] = case.plan(backend)
            except InfeasiblePlanError as error:
                self._plans[key] = error
        return self._plans[key]
