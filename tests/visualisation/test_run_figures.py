"""Pictures of a simulation show its arrays, by the names of its joints, and the plan it was to follow."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure

import redundancy_pin as rp
from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import Event, Simulation
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference

Runs = tuple[Robot, Plan, Simulation]


@pytest.fixture(scope="module")
def runs() -> Runs:
    """A plan, and how it goes on a machine whose carriers are heavier than planned."""
    planned, heavier = rp.load_robot("3rrr"), rp.load_robot("3rrr", carrier_mass=2.4)
    plan = rp.plan_stepwise(rp.RneaDynamics(planned), reference.corner(radius=0.025).sample(0.01))
    return heavier, plan, rp.simulate(heavier, plan, duration=0.4, dt=0.02, rtol=1e-7, atol=1e-9)


def _panel(drawn: Figure, label: str) -> Any:
    return next(axes for axes in drawn.axes if axes.get_ylabel().startswith(label))


def _labels(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_simulation_is_drawn_over_its_plan(runs: Runs) -> None:
    robot, plan, run = runs
    drawn = rp.plot.simulation(run, plan)
    assert drawn.get_suptitle() == "3rrr: simulation, stepwise, ok"
    for label, ours, theirs in (
        ("main torque [N·m]", run.tau, plan.tau),
        ("carrier force [N]", run.carrier_force, plan.carrier_force),
        ("carrier position s [m]", run.s, plan.carriers.s),
        ("carrier speed ṡ [m/s]", run.sd, plan.carriers.sd),
        ("carrier acceleration s̈ [m/s²]", run.sdd, plan.carriers.sdd),
    ):
        lines = _panel(drawn, label).lines
        np.testing.assert_array_equal(np.stack([line.get_ydata() for line in lines[:3]], axis=1), theirs)
        np.testing.assert_array_equal(np.stack([line.get_ydata() for line in lines[3:6]], axis=1), ours)
    assert _labels(drawn.axes[0]) == ["plan", "base_1", "base_2", "base_3"]
    assert _labels(_panel(drawn, "carrier position")) == ["plan", "carrier_1", "carrier_2", "carrier_3"]
    # the corner in closed form, not the plan's own functions
    apart = run.x - reference.corner(radius=0.025).evaluate(run.t).x
    expected = np.linalg.norm(apart * [1.0, 1.0, robot.characteristic_length], axis=1)
    (line,) = _panel(drawn, "distance of the platform").lines
    np.testing.assert_allclose(line.get_ydata()[1:], expected[1:], rtol=1e-9, atol=1e-13)
    assert expected.max() > 1e-3  # heavier carriers do lead it astray


def test_without_a_plan_there_is_no_distance(runs: Runs) -> None:
    labels = [axes.get_ylabel() for axes in rp.plot.simulation(runs[2]).axes]
    assert not [label for label in labels if label.startswith("distance")]
    assert len(labels) == 5


def test_condition_and_efforts_of_a_run_are_those_of_its_poses(runs: Runs) -> None:
    robot, _, run = runs
    motion = rp.PlatformMotion(run.t, run.x, run.xd, np.zeros_like(run.xd), check_rates=False)
    expected = rp.distribute(rp.RneaDynamics(robot).reduce(motion, run.carriers)).condition
    np.testing.assert_allclose(rp.plot.condition(run).axes[0].lines[0].get_ydata(), expected, rtol=1e-9)
    lines = rp.plot.efforts(run).axes[0].lines
    np.testing.assert_array_equal(np.stack([line.get_ydata() for line in lines[:3]], axis=1), run.tau)
    assert len(rp.plot.comparison({"as planned": runs[1], "heavier": run}).axes) == 3


def test_a_plan_of_another_machine_or_of_other_times_is_refused(runs: Runs) -> None:
    _, plan, run = runs
    with pytest.raises(InputError, match=r"plan is for 2rpr, the simulation of 3rrr"):
        rp.plot.simulation(run, replace(plan, robot=replace(plan.robot, name="2rpr", actuated=("a", "b", "c"))))
    with pytest.raises(InputError, match=r"plan runs from 0 to .* s, the simulation from 9 to 9.4 s"):
        rp.plot.simulation(replace(run, t=run.t + 9.0), plan)


def test_a_run_is_shown_as_it_was_simulated(runs: Runs) -> None:
    robot, plan, run = runs
    scene = rp.show(run).scene
    assert scene.title == "3rrr: simulation, stepwise, ok"
    data = robot.model.createData()
    frame = len(scene.t) // 2
    pin.forwardKinematics(robot.model, data, np.array(run.q[int(np.abs(run.t - scene.t[frame]).argmin())]))
    for j in range(1, robot.model.njoints):  # the carriers, which no inverse kinematics moves, among them
        np.testing.assert_allclose(scene.placement[frame, j], data.oMi[j].homogeneous, atol=1e-15)
    assert {arrow.name for arrow in scene.arrows} == {*robot.actuated, *robot.carriers}
    with pytest.raises(InputError, match="simulation has its own motions"):
        rp.show(run, reference.corner().sample(0.1))
    with pytest.raises(InputError, match=r"Simulation is no motion. Pass show\(simulation, robot=robot\)"):
        rp.show(robot, run)
    with pytest.raises(InputError, match=r"Plan is no motion. Pass show\(plan, robot=robot\)"):
        rp.show(robot, plan)


def test_where_the_robot_is_gone_efforts_are_drawn_and_nothing_is_made_up(runs: Runs) -> None:
    run = replace(runs[2], robot=replace(runs[2].robot, source="nowhere/robot.yaml"))
    np.testing.assert_array_equal(rp.plot.efforts(run).axes[0].lines[0].get_ydata(), run.tau[:, 0])
    with pytest.raises(InputError, match="condition number is not known"):
        rp.plot.condition(run)
    with pytest.raises(PlanFileError):
        rp.show(run)
    assert rp.show(run, robot=runs[0]).scene.duration == pytest.approx(0.4)


def test_titles_say_how_a_run_ended(runs: Runs) -> None:
    event = Event("track", "carrier_2 lower", 0.4, True)
    stopped = replace(runs[2], status=ResultStatus.STOPPED, events=(event,))
    failed = replace(runs[2], status=ResultStatus.NOT_CONVERGED, reason="rank loss")
    titles = [rp.plot.efforts(run).get_suptitle() for run in (stopped, failed)]
    assert titles == [f"3rrr: simulation, stepwise, {end} 0.4 s{why}" for end, why in
                      (("stopped at", ": carrier_2 lower"), ("failed at", ""))]  # fmt: skip
