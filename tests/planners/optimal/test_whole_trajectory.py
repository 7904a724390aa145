"""Whole-trajectory plans: their numbers, the singular instants, and what each setting is for."""

import numpy as np
import pytest
import zoo

from redundancy_pin import CarrierMotion, CompiledDynamics, RneaDynamics, VirtualWork, distribute, plan_whole_trajectory
from redundancy_pin.planners.optimal import nlp
from redundancy_pin.planners.options import Mesh, Objective
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

DENSE = 1.05
"""Largest effort between nodes over that at the nodes which the planner promises."""

BOTH_BACKENDS = 1e-6
"""What the planner promises; they agree to 1e-12."""


def circle(speed=0.5):
    """The circle with symmetric ramps, v T / 2 long."""
    return reference.circle(speed, 0.2, 0.1 * speed)


def two_rpr(**arguments):
    return VirtualWork(zoo.robot_of("2rpr", **arguments))


def five_bar_crossing():
    path = Line((0.25, 0.6), (0.32, 0.3))
    return Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))


def between(plan, parts):
    """Times inside the steps, (P,), and the carriers there with s̈ linear in a step, by their definition."""
    t, c = plan.t, plan.carriers
    left = np.flatnonzero(np.diff(t) > 0.0)
    fraction = (np.arange(parts) + 0.5) / parts
    h = np.diff(t)[left, None, None]
    x = fraction[None, :, None] * h
    jerk = (c.sdd[left + 1] - c.sdd[left])[:, None] / h
    s, sd, sdd = (part[left][:, None] for part in (c.s, c.sd, c.sdd))
    motion = (s + sd * x + sdd * x**2 / 2 + jerk * x**3 / 6, sd + sdd * x + jerk * x**2 / 2, sdd + jerk * x)
    times = (t[left, None] + fraction * np.diff(t)[left, None]).ravel()
    return times, CarrierMotion(*(part.reshape(-1, c.s.shape[1]) for part in motion))


def require_sound(dynamics, trajectory, plan):
    """Optimal, within limits also between the nodes, at rest at the datum, and as good between the nodes as at them."""
    assert plan.status is ResultStatus.OK
    assert plan.findings.optimal
    assert np.isfinite(plan.tau).all()
    for end in (0, -1):
        np.testing.assert_allclose(plan.carriers.s[end], 0.0, atol=1e-9)
        np.testing.assert_allclose(plan.carriers.sd[end], 0.0, atol=1e-9)
    times, motion = between(plan, 20)
    for i, limit in enumerate(plan.limits.judged_by.of_carriers):
        assert (motion.s[:, i] <= limit.upper).all()
        assert (motion.s[:, i] >= limit.lower).all()
        assert (np.abs(motion.sd[:, i]) <= limit.speed).all()
        assert (np.abs(motion.sdd[:, i]) <= limit.acceleration).all()
    dense = distribute(dynamics.reduce(trajectory.sample_at(times), motion)).tau
    assert np.abs(dense).max() <= DENSE * np.abs(plan.tau).max()
    assert plan.between.passed


# the bounds are those that issue 4 asks for, where it states any
@pytest.mark.long_for("effort-0.75-arguments2-0.5", "peak-0.5-arguments1-0.11")
@pytest.mark.parametrize(
    ("objective", "speed", "arguments", "most"),
    [
        ("effort", 0.5, {}, 0.21),
        ("peak", 0.5, {}, 0.11),
        ("effort", 0.75, {}, 0.5),
        pytest.param("peak", 0.75, {}, 0.25, marks=pytest.mark.long),
        pytest.param("effort", 0.5, {"end_effector_mass": 0.5, "cylinder_mass": 0.3}, 3.0, marks=pytest.mark.long),
    ],
)
def test_circle(objective, speed, arguments, most):
    dynamics, trajectory = two_rpr(**arguments), circle(speed)
    plan = plan_whole_trajectory(dynamics, trajectory, objective=Objective(objective, calm=0.0), mesh=Mesh(dt=0.01))
    require_sound(dynamics, trajectory, plan)
    assert plan.peak_effort.max() <= most


@pytest.mark.long_for("five_bar")
@pytest.mark.parametrize("case", ["circle", "five_bar"])
def test_efforts_at_singular_instants_are_the_limits_from_both_sides(case):
    dynamics = two_rpr(end_effector_mass=0.5, cylinder_mass=0.3) if case == "circle" else None
    dynamics = dynamics or CompiledDynamics(zoo.robot_of("five_bar"))
    trajectory = circle() if case == "circle" else five_bar_crossing()
    plan = plan_whole_trajectory(dynamics, trajectory, mesh=Mesh(dt=0.03))
    assert plan.diagnostics["singular_nodes"]
    for i in plan.diagnostics["singular_nodes"]:
        assert plan.sample_status[i] == SampleStatus.SINGULAR_CONSISTENT
        c, t = plan.carriers, plan.t
        jerks = [(c.sdd[j + 1] - c.sdd[j]) / (t[j + 1] - t[j]) for j in (i - 1, i)]
        np.testing.assert_allclose(jerks[0], jerks[1], rtol=1e-6, atol=1e-4)
        for e in (-1e-5, 1e-5):
            motion = CarrierMotion(
                (c.s[i] + e * c.sd[i] + e**2 / 2 * c.sdd[i] + e**3 / 6 * jerks[0])[None],
                (c.sd[i] + e * c.sdd[i] + e**2 / 2 * jerks[0])[None],
                (c.sdd[i] + e * jerks[0])[None],
            )
            beside = distribute(dynamics.reduce(trajectory.sample_at(np.array([t[i] + e])), motion)).tau[0]
            # τ changes by some 10 N/s here, so by 1e-4 N in this time
            np.testing.assert_allclose(beside, plan.tau[i], atol=1e-3 * max(1.0, np.abs(plan.tau).max()))


@pytest.mark.long_for("circle-effort")
@pytest.mark.parametrize(
    ("case", "objective"),
    [("circle", "effort"), ("corner", "peak"), pytest.param("heavy", "peak", marks=pytest.mark.long)],
)
def test_both_backends_give_the_same_plan(case, objective):
    """The optimum of "peak" is flat: plans differ by 1e-4 to 1e-2 if the solver is content too early."""
    if case == "corner":
        robot, trajectory, dt = zoo.robot_of("3rrr"), reference.corner(0.013), 0.03
    else:
        arguments = {"end_effector_mass": 0.5, "cylinder_mass": 0.3} if case == "heavy" else {}
        robot, trajectory, dt = zoo.robot_of("2rpr", **arguments), circle(), 0.02
    plans = [
        plan_whole_trajectory(backend(robot), trajectory, objective=objective, mesh=Mesh(dt=dt, refinements=0))
        for backend in (VirtualWork, RneaDynamics)
    ]
    for part in ("s", "sd", "sdd"):
        ours, theirs = (getattr(plan.carriers, part) for plan in plans)
        np.testing.assert_allclose(ours, theirs, atol=BOTH_BACKENDS * np.abs(theirs).max())
    np.testing.assert_allclose(plans[0].tau, plans[1].tau, atol=BOTH_BACKENDS * np.abs(plans[1].tau).max())


def measures(plan, target):
    """Every objective, from the arrays of a plan."""
    t = plan.t
    half = 0.5 * np.diff(t)
    w = (np.append(half, 0.0) + np.append(0.0, half))[:, None]
    return {
        "effort": (w * plan.tau**2).sum(),
        "peak": np.abs(plan.tau).max(),
        "tracking": (w * (plan.tau - 0.5 * target(t)) ** 2).sum(),
        "carrier_force": (w * plan.carrier_force**2).sum(),
        "carrier_acceleration": (w * plan.carriers.sdd**2).sum(),
        "effort_rate": sum(
            ((after - before) ** 2).sum() / step
            for before, after, step in zip(plan.tau, plan.tau[1:], np.diff(t), strict=False)
            if step > 0.0
        ),
        "energy": (w * np.abs(plan.main_power)).sum() + (w * np.abs(plan.carrier_power)).sum(),
    }


def test_each_objective_is_least_for_its_own_plan():
    dynamics, baseline = (VirtualWork(zoo.robot_of("3rrr", carriers=carriers)) for carriers in (True, False))
    trajectory = reference.corner()

    def target(t):
        return distribute(baseline.reduce(trajectory.sample_at(t))).tau

    names = ("effort", "peak", "tracking", "carrier_force", "carrier_acceleration", "effort_rate", "energy")
    plans = {}
    for name in names:
        plan = plan_whole_trajectory(
            dynamics,
            trajectory,
            objective=Objective(name, lam=0.5, baseline=baseline) if name == "tracking" else name,
            mesh=Mesh(dt=0.09, refinements=0),
        )
        plans[name] = measures(plan, target)
        # the regularisation costs less than 1e-3 of each
        np.testing.assert_allclose(plan.diagnostics["objective"][name], plans[name][name], rtol=1e-6, atol=1e-12)
    for name in names:
        for other in names:
            assert plans[name][name] <= plans[other][name] * (1.0 + 1e-3), (name, other)


def test_ends():
    dynamics = two_rpr()
    plans = {
        end: plan_whole_trajectory(
            dynamics, circle(), end=end, start=0.02, mesh=Mesh(dt=0.1, refinements=0), datum=(0.01, -0.01)
        )
        for end in ("free", "rest", "datum", "periodic")
    }
    for plan in plans.values():
        np.testing.assert_allclose(plan.carriers.s[0], 0.02, atol=1e-9)
        np.testing.assert_allclose(plan.carriers.sd[0], 0.0, atol=1e-9)
    last = {end: (plan.carriers.s[-1], plan.carriers.sd[-1], plan.carriers.sdd[-1]) for end, plan in plans.items()}
    np.testing.assert_allclose(last["rest"][1], 0.0, atol=1e-9)
    np.testing.assert_allclose(last["datum"][1], 0.0, atol=1e-9)
    np.testing.assert_allclose(last["datum"][0], (0.01, -0.01), atol=1e-9)
    first = plans["periodic"].carriers
    for now, then in zip(last["periodic"], (first.s[0], first.sd[0], first.sdd[0]), strict=True):
        np.testing.assert_allclose(now, then, atol=1e-8)
    efforts = {end: plan.diagnostics["objective"]["effort"] for end, plan in plans.items()}
    assert efforts["free"] <= efforts["rest"] <= efforts["datum"]
    assert np.abs(last["free"][1]).max() > 1e-3


def test_a_plan_that_is_not_optimal_says_so(monkeypatch):
    monkeypatch.setattr(nlp, "TOLERANCE", 1e-40)  # never reached, so the solver ends at what it calls acceptable
    plan = plan_whole_trajectory(two_rpr(), circle(), mesh=Mesh(dt=0.2, refinements=0))
    assert plan.status is ResultStatus.NOT_CONVERGED
    assert not plan.findings.optimal


def test_nodes_have_every_event_and_are_integrated_exactly():
    """s̈ is linear in a step, s and ṡ are its integrals, and the jerk is continuous where the plan says so."""
    plan = plan_whole_trajectory(two_rpr(), circle(), mesh=Mesh(dt=0.03, refinements=1))
    h, c = np.diff(plan.t), plan.carriers
    assert h.max() <= 0.03 * (1.0 + 1e-9)
    assert np.isin(plan.findings.singular_instants, plan.t).all()
    step = h[:, None]
    sd = c.sd[:-1] + step * (c.sdd[:-1] + c.sdd[1:]) / 2.0
    np.testing.assert_allclose(c.sd[1:], sd, atol=1e-9 * np.abs(c.sd).max())
    s = c.s[:-1] + step * c.sd[:-1] + step**2 * (2.0 * c.sdd[:-1] + c.sdd[1:]) / 6.0
    np.testing.assert_allclose(c.s[1:], s, atol=1e-9 * np.abs(c.s).max())
    smooth = np.array(plan.diagnostics["smooth_nodes"], dtype=int)
    assert np.isin(plan.diagnostics["singular_nodes"], smooth).all()
    assert len(plan.diagnostics["singular_nodes"]) == 2
    jerk = np.diff(c.sdd, axis=0) / step
    np.testing.assert_allclose(jerk[smooth - 1], jerk[smooth], atol=1e-6 * np.abs(jerk).max())


def test_sampled_motion_gives_the_plan_of_its_trajectory():
    dynamics = two_rpr()
    exact = plan_whole_trajectory(dynamics, circle(), mesh=Mesh(dt=0.01))
    sampled = plan_whole_trajectory(dynamics, circle().sample(0.002), mesh=Mesh(dt=0.01))
    ours, theirs = (plan.diagnostics["objective"]["effort"] for plan in (sampled, exact))
    assert ours == pytest.approx(theirs, rel=1e-2)  # the ends of the ramps are on nodes of one grid only
