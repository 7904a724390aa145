"""The return of the carriers: boundary conditions, and the shortest duration against brute force."""

from dataclasses import replace

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_return import (
    ALLOWED,
    CarrierState,
    limit_uses,
    no_force,
    return_polynomial,
    shortest_return,
)
from redundancy_pin.planners.limits import limit_events, motion_quantities
from redundancy_pin.planners.options import Limits
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.trajectory.functions_of_time import carriers_at

ROBOT = zoo.robot_of("2rpr")
LIMITS = Limits().resolved(ROBOT)
TRACK, SPEED, ACCELERATION = 0.2, 2.5, 10.0
"""As declared in models/2rpr."""

AVAILABLE = 2.0


def shortest(state, datum=0.0, limits=LIMITS, force=no_force):
    """Duration of the shortest return, s, or the details of the refusal."""
    try:
        back = shortest_return(limits, force, state, np.zeros_like(state.s) + datum, AVAILABLE, "Slow down.")
    except InfeasiblePlanError as error:
        return dict(error.details)
    return back.end - back.start


POWERS = np.arange(8)


def monomials(u, order):
    """Derivatives of 1, u, u², ... u⁷ by u, (..., 8)."""
    factor = np.array([np.prod(np.arange(p - order + 1, p + 1)) if p >= order else 0.0 for p in POWERS])
    return np.where(order <= POWERS, factor * np.asarray(u)[..., None] ** np.maximum(POWERS - order, 0), 0.0)


def largest_use(state, durations, datum, samples=2001):
    """Largest fraction of a limit, (D,), by brute force: the boundary system solved in monomials of t / duration."""
    durations = np.atleast_1d(durations)
    system = np.array([monomials(end, order) for end in (0.0, 1.0) for order in range(4)])
    nothing = np.zeros((len(durations), len(datum)))
    right = np.stack(
        [np.outer(durations**order, value) for order, value in enumerate((state.s, state.sd, state.sdd))]
        + [nothing, nothing + datum, nothing, nothing, nothing],
        axis=1,
    )
    coefficients = np.linalg.solve(system, right)  # (D, 8, k)
    u = np.linspace(0.0, 1.0, samples)
    uses = [
        np.abs(monomials(u, order) @ coefficients).max(axis=(1, 2)) / durations**order / limit
        for order, limit in ((0, TRACK), (1, SPEED), (2, ACCELERATION))
    ]
    return np.max(uses, axis=0)


def state_of(s, sd, sdd):
    return CarrierState(1.0, *(np.array(part, dtype=float) for part in (s, sd, sdd)))


@pytest.mark.parametrize("wanted", np.geomspace(0.2, 0.2 * 1.0444, 5))
def test_durations_between_two_candidates_are_found(wanted):
    """Limits that hardly any duration keeps: overshoot grows with it, acceleration falls."""
    state, datum = state_of([0.0], [1.0], [0.0]), np.zeros(1)
    there = carriers_at(return_polynomial(state, wanted, datum), state.t + np.linspace(0.0, wanted, 20_001))
    track, acceleration = (1.001 * float(np.abs(part).max()) for part in (there.s, there.sdd))
    only = CarrierLimits(lower=-track, upper=track, speed=np.inf, acceleration=acceleration, force=np.inf)
    robot = replace(ROBOT, carriers=ROBOT.carriers[:1], carrier_limits=(only,))
    limits = Limits().resolved(robot)
    duration = shortest(state, limits=limits)
    assert duration == pytest.approx(wanted, rel=2e-3)
    assert not limit_events(motion_quantities(limits, return_polynomial(state, duration, datum)))[0]


@examples(5)
@given(
    s=st.tuples(*[st.floats(-0.19, 0.19)] * 2),
    sd=st.tuples(*[st.floats(-1.5, 1.5)] * 2),
    sdd=st.tuples(*[st.floats(-9.5, 9.5)] * 2),
    datum=st.floats(-0.1, 0.1),
)
def test_shortest_against_brute_force(s, sd, sdd, datum):
    state, place = state_of(s, sd, sdd), np.full(2, datum)
    duration = shortest(state, datum)
    durations = np.geomspace(2e-3, AVAILABLE, 150)
    uses = largest_use(state, durations, place, 201)
    if isinstance(duration, dict):
        use = (
            1.0
            + duration["amount"]
            / {"track": TRACK, "speed": SPEED, "acceleration": ACCELERATION}[duration["constraint"]]
        )
        assert use > 1.0
        assert uses.min() > 1.0 - 1e-3  # 201 samples miss an extreme by less than this
        assert use <= uses.min() * (1.0 + 2e-2)  # and the best duration was looked for between the candidates
        return
    use = largest_use(state, duration, place, 20_001)[0]
    assert use <= 1.0 + 1e-6
    shorter = durations < duration * (1.0 - 1e-6)
    assert (uses[shorter] > 1.0 - 1e-3).all()
    if duration > 3e-3:  # not the shortest candidate: it lies on a limit
        assert use == pytest.approx(1.0, abs=1e-6)


def test_carrier_at_rest_at_its_datum_returns_at_once():
    assert shortest(state_of([0, 0], [0, 0], [0, 0])) == pytest.approx(1e-3 * AVAILABLE)


@pytest.mark.parametrize(("order", "quantity"), [(0, "track"), (1, "speed"), (2, "acceleration")])
def test_a_limit_that_a_return_exceeds_only_at_its_extreme_is_found(order, quantity):
    state = state_of([-0.1, 0.05], [-0.4, 0.3], [-1.0, 2.0])
    path = return_polynomial(state, 0.3, np.zeros(2))
    peak = float(np.abs(path.derivative(order)(np.linspace(path.start, path.end, 200_001))).max())
    most = peak * (1.0 - 1e-6)
    wide = {"track": (-9.0, 9.0), "speed": 1e3, "acceleration": 1e6}
    limits = Limits(**{**wide, quantity: (-most, most) if order == 0 else most}).resolved(ROBOT)
    (event,), _ = limit_events(motion_quantities(limits, path))
    assert event.quantity == quantity
    assert event.amount == pytest.approx(peak - most, rel=1e-2)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-6])
def test_the_shortest_return_keeps_its_limits_whatever_the_unit_of_time(scale):
    """Not above them by a rounding either: what a plan within its limits claims."""
    own = {"speed": SPEED / scale, "acceleration": ACCELERATION / scale**2}
    limits = Limits(**own).resolved(ROBOT)
    state = CarrierState(0.0, np.array([0.15, -0.1]), np.array([0.3, 0.2]) / scale, np.zeros(2))
    back = shortest_return(limits, no_force, state, np.zeros(2), AVAILABLE * scale, "Slow down.")
    s, sd, sdd = (np.asarray(getattr(carriers_at(back, back_times(back)), part)) for part in ("s", "sd", "sdd"))
    used = limit_uses(limits, s, sd, sdd, np.zeros_like(s)).max()
    assert 1.0 - 1e-9 < used <= ALLOWED
    same = shortest(CarrierState(0.0, state.s, state.sd * scale, state.sdd))
    assert back.end / scale == pytest.approx(same, rel=1e-9)


def back_times(path):
    """Ends and extremes of a path and of its rates, s."""
    return np.unique(np.concatenate([path.edges, *(path.derivative(order).extremes() for order in range(3))]))


def test_forces_count():
    state = state_of([-0.08, -0.03], [-0.3, -0.25], [-0.5, -2.0])

    def force(t, s, sd, sdd):
        return 150.0 * sdd  # reaches the declared 1000 N before s̈ reaches 10 m/s²

    limited = shortest(state, force=force)
    assert limited > shortest(state)
    path = return_polynomial(state, limited, np.zeros(2))
    dense = carriers_at(path, np.linspace(*path.edges, 20_001))
    assert 150.0 * np.abs(dense.sdd).max() == pytest.approx(1000.0, rel=1e-6)


def test_state_off_the_track_has_no_return():
    refused = shortest(state_of([-0.25, 0], [0, 0], [0, 0]))
    assert (refused["constraint"], refused["joint"], refused["time"]) == ("track", "carrier_1", 1.0)
    assert refused["amount"] == pytest.approx(0.05, abs=1e-9)
