"""The backend that a robot gets: generated code, and RNEA with a note where no compiler is."""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from click.testing import CliRunner

import redundancy_pin as rp
from redundancy_pin.cli import main
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import CompilerError, InputError, ModelFileError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation import motion_reference
from redundancy_pin.simulation.controllers import controller_by_name
from redundancy_pin.studies.co_design import DesignTask
from redundancy_pin.trajectory import reference

CIRCLE = reference.circle(speed=0.5)
MOTION = CIRCLE.sample(dt=0.05)
AWAY = reference.polygon([[0.2, 0.3], [0.25, 0.35], [0.3, 0.35]], radius=0.02, speed=0.3, ramp_time=0.2)
"""A path without singular poses."""
REMEDY = r"pip install 'redundancy_pin\[compiler\]'"
MODELS = Path(rp.__file__).parents[1] / "models"


@functools.cache
def plan() -> Plan:
    return rp.plan_switch_off(rp.VirtualWork(zoo.robot_of("2rpr")), CIRCLE, threshold=20.0, dt=0.05)


TAKERS: dict[str, Callable[[Any], Any]] = {
    "inverse_dynamics": lambda dynamics: rp.inverse_dynamics(dynamics, MOTION).efforts.tau,
    "plan_switch_off": lambda dynamics: rp.plan_switch_off(dynamics, CIRCLE, threshold=20.0, dt=0.05).tau,
    "plan_stepwise": lambda dynamics: rp.plan_stepwise(dynamics, AWAY, dt=0.05).tau,
    "plan_stepwise, baseline": lambda dynamics: rp.plan_stepwise("2rpr", AWAY, dt=0.05, lam=0.5, baseline=dynamics).tau,
    "plan_whole_trajectory, baseline": lambda dynamics: (
        rp.plan_whole_trajectory("2rpr", AWAY, dt=0.05, objective="tracking", lam=0.5, baseline=dynamics).tau
    ),
    "plan_whole_trajectory": lambda dynamics: rp.plan_whole_trajectory(dynamics, AWAY, dt=0.05).tau,
    "plan_time_optimal": lambda dynamics: rp.plan_time_optimal(dynamics, AWAY, effort=50.0).t,
    "RecedingHorizon": lambda dynamics: rp.RecedingHorizon(dynamics).dynamics.reduce(MOTION).f,
    "check_plan": lambda dynamics: rp.check_plan(plan(), dynamics).peak_effort,
    "efforts_at": lambda dynamics: plan().efforts_at([0.1, 0.2], dynamics),
    "base_wrench": lambda dynamics: plan().base_wrench(dynamics),
    "DesignTask": lambda dynamics: DesignTask(dynamics, CIRCLE).dynamics.reduce(MOTION).f,
}
"""Whatever takes dynamics, and something that depends on the robot."""


@pytest.mark.parametrize("name", TAKERS)
def test_a_robot_is_as_good_as_its_generated_code(name: str) -> None:
    robot = zoo.robot_of("2rpr")
    expected = TAKERS[name](rp.CompiledDynamics(robot))
    assert np.asarray(expected).size
    np.testing.assert_array_equal(TAKERS[name](robot), expected)
    np.testing.assert_array_equal(TAKERS[name]("2rpr"), expected)
    for wrong in (5, rp.RneaDynamics, MOTION) if name != "plan_stepwise, baseline" else ():  # which may be efforts
        with pytest.raises(InputError, match=f"{type(wrong).__name__} was given for the dynamics. Pass a robot"):
            TAKERS[name](wrong)
    with pytest.raises(ModelFileError, match="2rp"):
        TAKERS[name]("2rp")


def test_simulations_and_controllers_take_a_robot_for_its_generated_code() -> None:
    robot = zoo.robot_of("five_bar", carriers=False)
    motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 0.05, 51))

    def run(dynamics: Any) -> Any:
        controller = controller_by_name("computed torque", motion_reference(robot, motion), dynamics=dynamics)
        return rp.simulate(robot, controller, duration=0.02, dynamics=dynamics)

    named, given, plain = run("five_bar"), run(rp.CompiledDynamics(robot)), run(None)
    np.testing.assert_array_equal(named.q, given.q)
    assert named.statistics != plain.statistics or (named.q != plain.q).any()  # other code has run
    np.testing.assert_allclose(named.q, plain.q, atol=1e-7)
    with pytest.raises(InputError, match="int was given for the dynamics"):
        run(5)


def test_a_backend_stays_the_one_that_was_given() -> None:
    robot = zoo.robot_of("2rpr")
    for given in (rp.RneaDynamics(robot), rp.VirtualWork(robot), rp.CompiledDynamics(robot)):
        assert as_dynamics(given) is given
    for named in (robot, "2rpr", MODELS / "2rpr"):
        assert isinstance(as_dynamics(named), rp.CompiledDynamics)
    assert as_dynamics(robot).robot is robot


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_rnea_takes_its_place_and_a_note_says_so_once() -> None:
    robot = zoo.robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 1.0, 5))
    with pytest.raises(CompilerError, match=rf"no C compiler .*{REMEDY}"):
        rp.CompiledDynamics(robot)
    with pytest.warns(RuntimeWarning, match=rf"no C compiler .*RNEA is used.*{REMEDY}"):
        found = rp.inverse_dynamics(robot, motion)
    np.testing.assert_array_equal(found.efforts.tau, rp.inverse_dynamics(rp.RneaDynamics(robot), motion).efforts.tau)
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("default")  # as Python has it
        assert isinstance(as_dynamics("five_bar"), rp.RneaDynamics)
        assert isinstance(as_dynamics("2rpr"), rp.RneaDynamics)  # from another line
    assert len(notes) == 1


def judged_by(folder: Path, *arguments: str) -> tuple[dict[str, Any], str]:
    plan().save(folder / "plan.npz")
    done = CliRunner().invoke(main, ["check", str(folder / "plan.npz"), "--json", *arguments])
    return json.loads(done.stdout), done.stderr


def test_commands_use_generated_code_unless_a_backend_is_named(tmp_path: Path) -> None:
    by_default, _ = judged_by(tmp_path)
    assert by_default["backend"] == "compiled"
    for name in ("rnea", "virtual-work", "compiled"):
        named, _ = judged_by(tmp_path, "--backend", name)
        assert named["backend"] == name
        np.testing.assert_allclose(named["peak_effort"], by_default["peak_effort"], rtol=1e-9)


@pytest.mark.usefixtures("no_compiler")
def test_commands_say_what_to_install(tmp_path: Path) -> None:
    facts, said = judged_by(tmp_path)
    assert facts["backend"] == "rnea"
    assert facts["passed"]
    assert said.startswith("warning: ")
    assert "pip install 'redundancy_pin[compiler]'" in said
