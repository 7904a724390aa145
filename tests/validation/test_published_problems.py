"""Published problems against published values and independent equations of motion; ``make bench`` makes the table."""

from __future__ import annotations

import numpy as np
import published
import pytest
from published import models, references

import redundancy_pin as rp
from redundancy_pin.simulation import closed_state
from redundancy_pin.status import ResultStatus

PUBLISHED = 1e-9
"""Of 15.8 rad; the published values lie 7e-11 of it from the equations as printed, integrated at 1e-13."""

CASES = {problem.name: problem for problem in published.PROBLEMS}
SHORT = {"Bricard's six hinges (A04)": 0.3}


def test_andrews_mechanism_ends_where_it_is_published_to() -> None:
    run = published.ANDREWS.run(rtol=1e-10, atol=1e-11)
    assert run.status is ResultStatus.OK
    assert published.ANDREWS.error(run) < PUBLISHED
    # from the published start, which closes; and with the published accelerations
    names = list(models.andrews().model.names)[1:]
    order = [names.index(name) for name in published.ANDREWS_ORDER]
    np.testing.assert_allclose(run.q[0][order], models.ANDREWS_START, atol=1e-15)
    np.testing.assert_allclose(run.a[0][order][:2], [14222.4439199541, -10666.8329399656], rtol=1e-12)
    speeds = np.array(references.ANDREWS_END["v"])
    assert np.abs(run.v[-1][order] - speeds).max() < PUBLISHED * np.abs(speeds).max()


@pytest.mark.long_for(*sorted(set(CASES) - set(SHORT)))
@pytest.mark.parametrize("name", CASES)
def test_problems_follow_their_equations(name: str) -> None:
    problem = CASES[name]
    stiff = problem.settings.get("integrator") == "Radau"  # for as long as it takes its Jacobians to go wrong
    run = problem.run(duration=SHORT.get(name, problem.duration if stiff else min(problem.duration, 1.0)))
    assert run.status is ResultStatus.OK, run.reason
    assert problem.error(run) < (1e-7 if "rtol" in problem.settings else 1e-9)


START = (0.0, 0.5, -np.pi / 3, np.pi / 3), (2 * np.pi, 0.0, 0.0, 0.0)
LOOSE = {"rtol": 1e-6, "atol": 1e-8, "integrator": "Radau"}


def test_radau_takes_steps_that_dampers_do_not_bind() -> None:
    """The dampers' rate by hand: explicit methods of this order are stable up to about six times its inverse."""
    rate = 2.0 * 4e4 * (0.5**2 / 3.0 + (np.sqrt(3.0) / 4.0) ** 2 / (2.0 * (5.0 + 0.3 / 4.0 + 0.025 * 1.0001)))
    robot = models.governor()
    run = rp.simulate(robot, start=closed_state(robot, *START), duration=0.25, dt=0.025, **LOOSE)
    want = references.governor(run.t, 2 * np.pi)
    assert np.abs(want - want[0]).max() > 1e-3
    assert np.abs(run.q[:, 1] - want).max() < 1e-7
    assert run.t[-1] / run.statistics.steps * rate > 15.0


@pytest.mark.long
def test_radau_is_the_same_where_other_integrators_are_compiled() -> None:
    robot = models.governor()
    given = {"start": closed_state(robot, *START), "duration": 0.05, "dt": 0.01, **LOOSE}
    plain, fast = (rp.simulate(robot, dynamics=made, **given) for made in (None, rp.CompiledDynamics(robot)))
    assert np.abs(plain.q - fast.q).max() < 1e-9
