"""Simulations in files: bit for bit back, and anything else refused."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import moving
import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import OutputError, PlanFileError
from redundancy_pin.simulation.controllers.base import Constant
from redundancy_pin.simulation.result import Simulation, load_simulation
from redundancy_pin.simulation.state import closed_state
from redundancy_pin.status import ResultStatus


@pytest.fixture(params=["2rpr", "gough"])
def simulation(request: pytest.FixtureRequest) -> Simulation:
    robot = moving.massive(request.param)
    start = closed_state(robot, sd=0.5 if robot.k else 0.0)
    drive = Constant(np.zeros(robot.m), np.full(robot.k, 5.0))
    return rp.simulate(robot, drive, start=start, duration=0.3, dt=0.01)


def test_a_simulation_comes_back_bit_for_bit(simulation: Simulation, tmp_path: Path) -> None:
    simulation.save(tmp_path / "run.npz")
    again = load_simulation(tmp_path / "run.npz")
    for entry in fields(Simulation):
        before, after = getattr(simulation, entry.name), getattr(again, entry.name)
        if isinstance(before, np.ndarray):
            assert before.tobytes() == after.tobytes(), entry.name
            assert before.shape == after.shape
        else:
            assert before == after, entry.name


def test_a_simulation_prints_what_tells_it_apart(simulation: Simulation) -> None:
    text = repr(simulation)
    largest = np.abs(simulation.carrier_force).max(axis=0)
    assert f"Simulation('{simulation.robot.name}', {simulation.status.value}, {len(simulation.events)} events; " in text
    assert f"N={len(simulation)}, t=0..{simulation.t[-1]:g} s, n={simulation.xd.shape[1]}, " in text
    peaks = ", ".join(f"{value:.4g}" for value in largest)
    assert text.endswith(f"peak |carrier_force| {peaks} N)" if len(largest) else "no carrier_force)")
    assert "not_converged (too fast)" in repr(replace(simulation, status=ResultStatus.NOT_CONVERGED, reason="too fast"))


def test_what_is_no_simulation_is_refused_by_name(simulation: Simulation, tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with pytest.raises(PlanFileError, match=r"does not exist\. Give a file that a simulation was saved to"):
        load_simulation(path)
    path.write_bytes(b"no archive")
    with pytest.raises(PlanFileError, match=r"run\.npz"):
        load_simulation(path)
    arrays = [(name, np.array(value)) for name, value in vars(simulation).items() if isinstance(value, np.ndarray)]
    assert len(arrays) == 16
    for field, value, message in (
        *((name, value[:-1], rf"{name} has shape \({len(value) - 1}, ?") for name, value in arrays if name != "t"),
        ("energy", np.zeros(len(simulation.t), dtype=int), "energy is no array of floats"),
        ("x", np.zeros((3, 2)), "x has shape"),
        *((name, np.array(5.0), rf"{name} has shape \(\)") for name in ("t", "v", "x", "xd", "closure_force")),
        ("status", "elsewhere", r"a simulation's fields .*elsewhere.*Save the simulation again"),
        ("statistics", {"steps": 1}, "damaged"),
    ):
        replace(simulation, **{field: value}).save(path)
        with pytest.raises(PlanFileError, match=message):
            load_simulation(path)
    with pytest.raises(OutputError):
        simulation.save(tmp_path / "nowhere" / "run.npz")


def test_a_plan_is_no_simulation(tmp_path: Path) -> None:
    plan = rp.plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr")), rp.trajectory.reference.corner(radius=0.025), mesh=rp.Mesh(dt=0.02)
    )
    plan.save(tmp_path / "plan.npz")
    with pytest.raises(PlanFileError, match=r"redundancy_pin plan.*not a .*simulation"):
        load_simulation(tmp_path / "plan.npz")
