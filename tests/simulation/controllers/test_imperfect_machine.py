"""Plans made inside the loop, from what encoders see of a machine that is not as planned."""

import functools

import numpy as np
import pytest
from imperfect import MASSES, Imperfections, draw

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.receding_horizon import run_online
from redundancy_pin.simulation.controllers import Encoders, NoisyAmplifier, OnlinePlanning, Sampling, joint_friction
from redundancy_pin.simulation.state import closed_state
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import circle_path

ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(ARC, SpeedProfile(ARC.length, 0.45, 0.2))

ASKED = 2e-3
"""m."""


@functools.cache
def closed_loop(
    number: int, duration: float, weak: float | None = None, **settings: float
) -> tuple[float, OnlinePlanning]:
    """Drive an imperfect machine of the robustness study; return how far it was off, and its controller.

    ``weak``: limit of its carriers' acceleration, m/s², for a planner that may slow down.
    """
    bounds, nominal, sampling = Imperfections(), rp.load_robot("2rpr", **MASSES), Sampling(1e-3, 1e-3)
    dynamics, drawn = rp.CompiledDynamics(nominal), draw(nominal, bounds, 0, number)
    planner = rp.RecedingHorizon(
        dynamics, limits=rp.Limits(track=(-0.16, 0.16), acceleration=weak), slow_down=weak is not None
    )
    control = OnlinePlanning(planner, ACROSS, sampling, effort_scale=2.0, dynamics=dynamics, **settings)
    machine = rp.load_robot("2rpr", **{**MASSES, **drawn.arguments})
    point = control.reference.at(0.0)
    home = closed_state(machine, point.x, point.xd, point.s, point.sd).q - point.q
    seen = Encoders(control, control.reference, period=1e-3, phase=drawn.phase, home=home)
    beside = (point.x + drawn.x, point.xd + drawn.xd, point.s + drawn.s, point.sd + drawn.sd)
    run = rp.simulate(
        machine,
        NoisyAmplifier(seen, drawn.random, bounds.noise),
        start=closed_state(machine, *beside),
        duration=duration,
        dt=1e-3,
        sampling=sampling,
        external=joint_friction(machine, prismatic_coulomb=0.1, prismatic_viscous=0.2),
        rtol=1e-6,
        atol=1e-8,
        integrator="RK45",
    )
    assert run.status.value == "ok"
    if weak is None:
        planned = np.array([control.reference.platform(float(t))[0] for t in run.t])
        return float(np.linalg.norm(run.x - planned, axis=1).max()), control
    # when it was where is another matter: the arc, on as far as the latest plan has led it
    led = np.linalg.norm(control.reference.platform(duration)[0] - run.x[-1])
    off = np.abs(np.linalg.norm(run.x - (0.25, 0.05), axis=1) - 0.09).max()
    return float(max(off, led)), control


@pytest.mark.parametrize(
    ("number", "duration"), [(0, 0.25), *(pytest.param(i, 0.828, marks=pytest.mark.long) for i in range(1, 6))]
)
def test_an_imperfect_machine_crosses_by_plans_made_on_the_way(number, duration):
    away, control = closed_loop(number, duration)
    assert away < ASKED
    assert set(control.counts) == {"ok"}
    assert len(control.plans) == int(np.ceil(duration / control.tick))
    # plans begin a delay after what they come of, and where the carriers are by then
    starts = np.array([plan.t for plan in control.plans])[1:]
    np.testing.assert_allclose(starts, control.tick * np.arange(1, len(starts) + 1) + control.planning_delay, atol=1e-9)


@pytest.mark.parametrize("duration", [0.4, pytest.param(1.2, marks=pytest.mark.long)])
def test_an_imperfect_machine_of_weak_carriers_is_led_along_its_path_more_slowly(duration):
    away, control = closed_loop(0, duration, weak=1.5)
    assert away < ASKED
    assert set(control.counts) <= {"ok", "time_scaled"}
    behind = duration - float(control.plans[-1].scaling.at([duration])[0][0])
    assert behind > 0.02
    # platform and tree of the reference are at rates that are those of their places
    h, reference = 1e-4, control.reference
    bends = []
    for t in np.linspace(duration + 0.011, duration + 0.3, 23):
        bends.append(abs(float(control.plans[-1].scaling.at([t])[2][0])))
        (x0, xd0, _), (_, xd, xdd), (x1, xd1, _) = (reference.platform(t + shift) for shift in (-h, 0.0, h))
        np.testing.assert_allclose(xd, (x1 - x0) / (2.0 * h), atol=1e-6)
        np.testing.assert_allclose(xdd, (xd1 - xd0) / (2.0 * h), atol=2e-4)
        (_, v0, _), (_, _, a), (_, v1, _) = (reference.tree(t + shift) for shift in (-h, 0.0, h))
        np.testing.assert_allclose(a, (v1 - v0) / (2.0 * h), atol=0.02 * np.abs(a).max() + 1e-3)
    assert max(bends) > 0.2


def test_what_the_model_does_not_know_is_learnt_by_an_integral():
    """Friction leaves the platform behind by its share of ω² e, which an integral takes over."""
    (without, _), (learnt, control) = closed_loop(0, 0.25), closed_loop(0, 0.25, integral=10.0)
    assert learnt < 0.75 * without
    assert set(control.counts) == {"ok"}


def test_settings_that_make_no_sense_are_refused():
    planner = rp.RecedingHorizon(rp.CompiledDynamics(rp.load_robot("2rpr", **MASSES)))
    with pytest.raises(InputError, match="is not within a tick"):
        OnlinePlanning(planner, ACROSS, Sampling(1e-3), effort_scale=1.0, delay=0.03)
    for settings in ({"tick": 0.6}, {"delay": np.nan}, {"delay": "soon"}, {"integral": -1.0}, {"integral": np.nan}):
        with pytest.raises(InputError):
            OnlinePlanning(planner, ACROSS, Sampling(1e-3), effort_scale=1.0, **settings)
    with pytest.raises(InputError, match="integral of 30 rad/s is not within the bandwidth of 30 rad/s"):
        OnlinePlanning(planner, ACROSS, Sampling(1e-3), effort_scale=1.0, integral=30.0)
    with pytest.raises(InputError, match="RecedingHorizon"):
        OnlinePlanning(None, ACROSS, Sampling(1e-3), effort_scale=1.0)
    with pytest.raises(InputError, match="digital"):
        OnlinePlanning(planner, ACROSS, None, effort_scale=1.0)
    planner.update(0.0, ACROSS)
    with pytest.raises(InputError, match="another run"):
        OnlinePlanning(planner, ACROSS, Sampling(1e-3), effort_scale=1.0)
    with pytest.raises(InputError, match="another run"):
        run_online(planner, ACROSS)
