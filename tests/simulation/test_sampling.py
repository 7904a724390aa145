"""Digital control: when the state is read, when the efforts act, what happens at jumps."""

from __future__ import annotations

from dataclasses import dataclass, field

import moving
import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.simulation.controllers.base import Constant, Sampling
from redundancy_pin.simulation.state import State, closed_state

SAME = 1e-10
"""The same efforts over the same intervals, integrated to 1e-11."""


@dataclass
class Logged:
    """Efforts that tell which reading they come from; remembers when it was asked and what it saw."""

    times: list[float] = field(default_factory=list)
    seen: list[Array] = field(default_factory=list)

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        self.times.append(t)
        self.seen.append(np.array(state.q))
        return np.array([0.1 * len(self.times), -0.1]), np.zeros(2)


@dataclass
class Steps:
    """Efforts that jump at given times."""

    breaks: Array
    levels: Array

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        level = self.levels[int(np.searchsorted(self.breaks, t, side="right"))]
        return np.array([level, -0.5 * level]), np.zeros(2)


def test_the_state_is_read_once_a_period_and_held() -> None:
    robot = moving.massive("five_bar")
    logged = Logged()
    run = rp.simulate(robot, logged, duration=0.05, dt=0.0025, sampling=Sampling(0.01))
    np.testing.assert_allclose(logged.times, np.arange(5) * 0.01, atol=1e-12)
    expected = 0.1 * (1 + np.minimum(np.arange(21) // 4, 4))
    np.testing.assert_allclose(run.tau[:, 0], expected)
    # what it saw is where the machine was
    np.testing.assert_allclose(logged.seen[2], run.q[8], atol=1e-12)


@pytest.mark.parametrize("delay", [0.004, 0.01, 0.013, 0.025])
def test_efforts_act_one_delay_after_the_reading(delay: float) -> None:
    robot = moving.massive("five_bar")
    logged = Logged()
    run = rp.simulate(robot, logged, duration=0.06, dt=0.0005, sampling=Sampling(0.01, delay))
    assert len(logged.times) == 6
    reading = np.floor((run.t[:-1] - delay) / 0.01 + 1e-6)
    np.testing.assert_allclose(run.tau[:-1, 0], 0.1 * (1 + np.maximum(reading, 0)))


def test_a_sampled_controller_is_a_sequence_of_constant_efforts() -> None:
    robot = moving.massive("five_bar")
    sampled = rp.simulate(robot, Logged(), duration=0.05, dt=0.01, sampling=Sampling(0.01, 0.004))
    breaks = 0.01 * np.arange(1, 5) + 0.004
    levels = 0.1 * np.arange(1, 6)

    class Same(Steps):
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            (level, _), force = super().effort(t, state)
            return np.array([level, -0.1]), force

    np.testing.assert_allclose(
        rp.simulate(robot, Same(breaks, levels), duration=0.05, dt=0.01).q[-1], sampled.q[-1], atol=SAME
    )


@examples(10)
@given(st.floats(5e-3, 0.05), st.floats(0.0, 0.1), st.floats(0.03, 0.1))
def test_readings_and_changes_come_in_order_for_any_period_and_delay(period: float, delay: float, end: float) -> None:
    robot = moving.massive("five_bar")
    logged = Logged()
    run = rp.simulate(robot, logged, duration=end, dt=0.01, sampling=Sampling(period, delay), rtol=1e-6, atol=1e-6)
    assert run.status.value == "ok"
    assert run.t[-1] == end
    times = np.array(logged.times)
    np.testing.assert_allclose(np.diff(times), period, rtol=1e-6)
    assert times[0] == 0.0
    assert end - period - 1e-7 * period <= times[-1] < end
    assert (np.diff(run.tau[:, 0]) >= 0.0).all()
    due = np.floor((run.t[:-1] - delay) / period)
    early = np.floor((run.t[:-1] - delay) / period + 1e-6)
    acting = np.round(run.tau[:-1, 0] / 0.1) - 1
    assert ((acting >= np.maximum(due, 0)) & (acting <= np.maximum(early, 0))).all()


def test_the_integrator_starts_anew_where_efforts_jump() -> None:
    # a step over a jump would have to become tiny; without the break the integrator finds it by itself, dearly
    robot = moving.massive("five_bar")
    jump = Steps(np.array([0.1234567]), np.array([1.0, -3.0]))
    told = rp.simulate(robot, jump, duration=0.3, dt=0.05)
    assert told.statistics.restarts == 2
    first = rp.simulate(robot, Constant(np.array([1.0, -0.5]), np.zeros(2)), duration=0.1234567, dt=0.1)
    second = Constant(np.array([-3.0, 1.5]), np.zeros(2))
    start = State(moving.random_states(robot, 1, 1)[0].chain, float(first.t[-1]), first.q[-1], first.v[-1])
    rest = rp.simulate(robot, second, start=start, duration=0.3 - 0.1234567, dt=0.1)
    np.testing.assert_allclose(told.q[-1], rest.q[-1], atol=SAME)
    assert told.statistics.steps <= first.statistics.steps + rest.statistics.steps + 1


def test_samplings_out_of_their_domain_are_refused() -> None:
    wrong = ((0.0, 0.0, "period is 0 s"), (-1.0, 0.0, "period is -1 s"), (np.nan, 0.0, "period is nan s"))
    for period, delay, message in (*wrong, (0.01, -0.1, "delay is -0.1"), (0.01, np.inf, "delay is inf")):
        with pytest.raises(InputError, match=message):
            Sampling(period, delay)


def test_start_states_of_a_sampled_run_are_read_first() -> None:
    robot = moving.massive("five_bar")
    logged = Logged()
    start = closed_state(robot, sd=0.2, t=3.0)
    run = rp.simulate(robot, logged, start=start, duration=0.02, dt=0.01, sampling=Sampling(0.01))
    np.testing.assert_allclose(run.t, [3.0, 3.01, 3.02])
    np.testing.assert_allclose(logged.seen[0], start.q, atol=1e-12)
