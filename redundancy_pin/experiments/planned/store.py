"""Plans that were made once: the same case serves figures, statements and sweeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.backends import VIRTUAL_WORK
from redundancy_pin.experiments.planned.cases import Case, StepwiseCase, SwitchOffCase, parked_crossing
from redundancy_pin.planners.plan import Plan


@dataclass
class PlanStore:
    """Makes plans on demand and keeps them; the one thing in this study that changes while it runs."""

    _plans: dict[str, Plan | InfeasiblePlanError] = field(default_factory=dict)
    _at_rest: dict[str, Plan] = field(default_factory=dict)

    def plan(self, case: Case, backend: str = VIRTUAL_WORK) -> Plan:
        """Return the plan of a case.

        Raises:
            InfeasiblePlanError: there is none.
        """
        key = f"plan {backend} {case!r}"
        if key not in self._plans:
            try:
                self._plans[key] = case.plan(backend)
            except InfeasiblePlanError as error:
                self._plans[key] = error
        found = self._plans[key]
        if isinstance(found, InfeasiblePlanError):
            raise found
        return found

    def try_plan(self, case: Case, backend: str = VIRTUAL_WORK) -> Plan | None:
        """Return the plan of a case, or None where there is none."""
        try:
            return self.plan(case, backend)
        except InfeasiblePlanError:
            return None

    def baseline(self, case: StepwiseCase) -> Plan:
        """Return the motion of a case without carriers."""
        return self._kept(f"baseline {_motion_key(case)}", lambda: case.baseline(VIRTUAL_WORK))

    def parked(self, case: Case) -> Plan:
        """Return the motion of a case with the carriers parked."""
        if isinstance(case, SwitchOffCase):
            return self._kept(f"parked {_motion_key(case)}", lambda: parked_crossing(case, VIRTUAL_WORK))
        return self._kept(f"parked {_motion_key(case)}", lambda: case.parked(VIRTUAL_WORK))

    def _kept(self, key: str, make: Callable[[], Plan]) -> Plan:
        if key not in self._at_rest:
            self._at_rest[key] = make()
        return self._at_rest[key]


def _motion_key(case: Case) -> str:
    mode = case.mode if isinstance(case, StepwiseCase) else case.end_effector_mass
    return f"{case.path} {case.path_options} {mode} {case.dt}"
