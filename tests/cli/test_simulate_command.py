"""``redundancy-pin simulate``: the simulations of the Python API, how they ended told by the exit code."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused, write_motion

import redundancy_pin as rp
from redundancy_pin.simulation import Sampling, Simulation, closed_state, load_simulation, plan_reference
from redundancy_pin.simulation.controllers import ComputedTorque, Encoders, JointFriction
from redundancy_pin.trajectory import reference


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.npz"
    motion = reference.corner(radius=0.025).sample(0.02)
    rp.plan_stepwise(rp.RneaDynamics(rp.load_robot("3rrr")), motion).save(path)
    return path


def same(run: Simulation, expected: Simulation) -> None:
    for name in ("t", "q", "v", "a", "x", "tau", "carrier_force"):  # starts that are closed anew differ by rounding
        ours, theirs = getattr(run, name), getattr(expected, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9, err_msg=name)


def test_a_plan_on_another_machine_is_the_simulation_of_the_python_api(plan_file: Path, tmp_path: Path) -> None:
    out, plot = tmp_path / "run.npz", tmp_path / "run.png"
    result = call("simulate", "--plan", plan_file, "--machine", "carrier_mass=2.0", "--duration", "0.2",
                  "--out", out, "--plot", plot, "--json")  # fmt: skip
    assert (result.exit_code, result.stderr) == (0, "")
    machine = rp.load_robot("3rrr", carrier_mass=2.0)
    expected = rp.simulate(machine, rp.load_plan(plan_file), duration=0.2)
    same(load_simulation(out), expected)
    assert plot.read_bytes().startswith(b"\x89PNG")
    facts = json.loads(result.stdout)
    assert facts["status"] == "ok"
    assert facts["controller"] == "open-loop"
    apart = expected.x - reference.corner(radius=0.025).evaluate(expected.t).x
    away = np.linalg.norm(apart * [1.0, 1.0, machine.characteristic_length], axis=1)
    assert facts["largest_distance"] == pytest.approx(away.max(), rel=1e-9)
    assert facts["last_distance"] == pytest.approx(away[-1], rel=1e-9)
    assert away.max() > 1e-3
    assert facts["peak_effort"] == pytest.approx(np.abs(expected.tau).max(axis=0))


def test_a_machine_of_other_lengths_starts_where_the_plan_does(plan_file: Path) -> None:
    result = call("simulate", "--plan", plan_file, "--machine", "distal_length=1.003", "--duration", "0.02", "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    facts = json.loads(result.stdout)
    assert facts["largest_closure_residual"] < 1e-9
    assert facts["largest_distance"] < 1e-4


def test_a_table_has_the_joints_by_name(plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    result = call("simulate", "--plan", plan_file, "--duration", "0.1", "--dt", "0.02", "--out", out)
    assert result.exit_code == 0, result.stderr
    assert "distance at the end [m, rad times 0.9859 m]" in result.stdout  # its platform turns
    assert "peak of base_2 [N·m]" in result.stdout
    expected = rp.simulate(rp.load_robot("3rrr"), rp.load_plan(plan_file), duration=0.1, dt=0.02)
    with out.open() as file:
        rows = list(csv.DictReader(file))
    for name, values in (
        ("tau:base_2 [N*m]", expected.tau[:, 1]),
        ("qd:base_2 [rad/s]", expected.actuated_rate[:, 1]),
        ("s:carrier_3 [m]", expected.s[:, 2]),
        ("tau:carrier_1 [N]", expected.carrier_force[:, 0]),
        ("rz [rad]", expected.x[:, 2]),
    ):
        np.testing.assert_array_equal([float(row[name]) for row in rows], values, err_msg=name)


class Noisy:
    """The same noise as the command's, written down once more."""

    def __init__(self, controller: Encoders, seed: int, noise: float) -> None:
        self._controller, self._random, self._noise = controller, np.random.default_rng(seed), noise

    def effort(self, t: float, state: object) -> tuple[np.ndarray, np.ndarray]:
        tau, force = self._controller.effort(t, state)  # type: ignore[arg-type]
        return (
            tau + self._noise * self._random.standard_normal(3),
            force + self._noise * self._random.standard_normal(3),
        )


def test_a_digital_controller_with_noise_friction_and_encoders(plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.npz"
    result = call("simulate", "--plan", plan_file, "--controller", "computed-torque", "--period", "0.004", "--delay",
                  "0.002", "--noise", "0.2", "--seed", "5", "--encoders", "--friction", "revolute_coulomb=0.3",
                  "--friction", "prismatic_viscous=2", "--max-effort", "1.5", "--duration", "0.1",
                  "--out", out)  # fmt: skip
    assert result.exit_code == 0, result.stderr
    robot, planned = rp.load_robot("3rrr"), plan_reference(rp.load_plan(plan_file))
    sampling = Sampling(0.004, 0.002)
    controller = ComputedTorque(planned, sampling=sampling, effort_limit=1.5)
    point = planned.at(0.0)
    sliding = np.array([name.startswith("carrier") for name in list(robot.model.names)[1:]])
    friction = JointFriction(np.where(sliding, 0.0, 0.3), np.where(sliding, 2.0, 0.0), np.where(sliding, 0.01, 0.05))
    expected = rp.simulate(
        robot, Noisy(Encoders(controller, planned, period=0.004), 5, 0.2), duration=0.1, dt=0.004, sampling=sampling,
        start=closed_state(robot, point.x, point.xd, point.s, point.sd), external=friction, effort_limit=1.5,
        rtol=1e-7, atol=1e-9, integrator="RK45",
    )  # fmt: skip
    same(load_simulation(out), expected)


def test_what_stops_it_is_said_by_code_3_and_in_one_line(plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.npz"
    result = call("simulate", "--plan", plan_file, "--machine", "carrier_mass=0.5", "--out", out)
    run = load_simulation(out)
    last = run.events[-1]
    assert (result.exit_code, last.kind, last.terminal) == (3, "track", True)
    assert result.stderr == f"warning: stopped at t = {last.t:.6g} s: track ({last.name})\n"
    beyond = call("simulate", "--plan", plan_file, "--machine", "carrier_mass=0.5", "--stop-at", "never", "--duration",
                  f"{last.t + 0.01}")  # fmt: skip
    assert beyond.exit_code == 0


def test_what_cannot_go_on_ends_with_code_4_and_is_kept(tmp_path: Path) -> None:
    robot, circle = rp.load_robot("2rpr"), reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=5.0, mesh=rp.Mesh(dt=0.005))
    plan.save(tmp_path / "plan.npz")
    result = call("simulate", "--plan", tmp_path / "plan.npz", "--carriers", "motion", "--stop-at", "never", "--out",
                  tmp_path / "run.npz")  # fmt: skip
    run = load_simulation(tmp_path / "run.npz")
    assert (result.exit_code, run.status.value) == (4, "not_converged")
    assert result.stderr.startswith(f"warning: could not go on at t = {run.t[-1]:.6g} s: ")
    assert len(result.stderr.splitlines()) == 1


def test_a_motion_from_a_file_and_a_trajectory(tmp_path: Path) -> None:
    trajectory = reference.corner(radius=0.05)
    file = write_motion(tmp_path / "motion.csv", trajectory, 0.01, carriers=3)
    given = ("--robot", "3rrr", "--duration", "0.2", "--json")
    moving = json.loads(call("simulate", *given, "--motion", file).stdout)
    parked = json.loads(call("simulate", *given, "--trajectory", "corner", "--radius", "0.05", "--park", "0.1").stdout)
    for facts in (moving, parked):
        assert facts["status"] == "ok"
        assert facts["largest_distance"] < 1e-9
    wave = 2.0 * np.arange(0.0, 0.2, 0.005)[:, None] + np.arange(3)
    dynamics, t = rp.RneaDynamics(rp.load_robot("3rrr")), np.arange(0.0, 0.2, 0.005)
    motion, carriers = (
        trajectory.sample(times=t, two_sided=False),
        rp.CarrierMotion(0.05 * np.sin(wave), 0.1 * np.cos(wave), -0.2 * np.sin(wave)),
    )
    needed = np.abs(dynamics.reduce(motion, carriers).carrier_force).max(axis=0)
    np.testing.assert_allclose(moving["peak_carrier_force"], needed, rtol=1e-2)  # samples beside the peak
    assert not np.allclose(parked["peak_carrier_force"], needed, rtol=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "nothing to simulate"),
        (("--robot", "3rrr"), "needs either --trajectory or --motion"),
        (("--plan", "PLAN", "--trajectory", "circle"), "--plan and --trajectory are both given"),
        (("--plan", "PLAN", "--park", "0.1"), "--plan and --park are both given"),
        (("--plan", "PLAN", "--set", "carrier_mass=2"), "cannot change the robot of a plan"),
        (("--plan", "PLAN", "--machine", "charm=2"), "no argument 'charm'"),
        (("--plan", "PLAN", "--noise", "1"), "--noise goes with a sampled controller. Add --period"),
        (("--plan", "PLAN", "--noise", "-1", "--period", "0.01"), "--noise is -1"),
        (("--plan", "PLAN", "--delay", "1"), "--delay goes with a sampled controller"),
        (("--plan", "PLAN", "--period", "-1"), "period -1.0 s"),
        (("--plan", "PLAN", "--friction", "coulomb=1"), "--friction has no key 'coulomb'"),
        (("--plan", "PLAN", "--friction", "revolute_coulomb=-1"), "--friction revolute_coulomb is -1"),
        (("--plan", "PLAN", "--stop-at", "never", "--stop-at", "track"), "--stop-at is never and track"),
        (("--plan", "PLAN", "--max-effort", "1,2"), "--max-effort is"),
        (("--plan", "PLAN", "--duration", "-1"), "positive, finite duration"),
        (("--plan", "PLAN", "--dt", "-1"), "--dt is -1"),
        (("--plan", "PLAN", "--dt", "0"), "--dt is 0"),
        (("--plan", "PLAN", "--noise", "1", "--period", "0.01", "--seed", "-3"), "--seed"),
        (("--robot", "2rpr", "--trajectory", "circle", "--park", "0,0,0"), "3 values for 2 carriers"),
        (("--plan", "PLAN", "--out", "run.txt"), "ends in neither .npz nor .csv"),
        (("--plan", "PLAN", "--out", "PLAN"), "--out is the file"),
        (("--plan", "PLAN", "--plot", "run.txt"), "no picture format"),
        (("--plan", "nothing.npz"), "nothing.npz"),
        (("--robot", "2rpr", "--trajectory", "circle"), "no finite efforts"),
        (("--robot", "gough", "--trajectory", "circle"), "gough moves through poses"),
    ],
)
def test_mistakes_are_one_line(arguments: tuple[str, ...], message: str, plan_file: Path) -> None:
    given = [str(plan_file) if argument == "PLAN" else argument for argument in arguments]
    assert message in refused("simulate", *given)
