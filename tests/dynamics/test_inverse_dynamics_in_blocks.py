"""Motions that come in blocks: the numbers, instants, limits and errors of the whole, in memory that does not grow."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo
from command_line import call, write_motion
from folding import folding_four_bar, rocker_motion

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, PlatformMotion
from redundancy_pin.dynamics.compiled import build as compiled
from redundancy_pin.dynamics.inverse_dynamics import InverseDynamics, edge_of
from redundancy_pin.motion import require_consistent
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory import Line, RestToRest, Trajectory, reference

CIRCLE = reference.circle(speed=0.5)
ROUNDING = 1e-10
"""Guesses of Newton's method differ between blocks, solutions by roundings, efforts by those over the margin."""


def cut(
    whole: PlatformMotion, size: int, carriers: CarrierMotion | None = None
) -> Iterator[tuple[PlatformMotion, CarrierMotion | None]]:
    for first in range(0, len(whole), size):
        part = slice(first, first + size)
        yield whole[part], None if carriers is None else carriers[part]


def together(blocks: list[InverseDynamics], of: str, name: str) -> np.ndarray:
    return np.concatenate([getattr(getattr(block, of), name) for block in blocks])


@pytest.mark.long_for(
    *(f"{name}-{size}" for name in ("RneaDynamics", "VirtualWork") for size in (1, 37, 1000)),
    "VirtualWork-56",
    "RneaDynamics-52",
)
# the first instant lies between blocks of 52, and where blocks of 56 overlap
@pytest.mark.parametrize("size", [1, 37, 52, 56, 1000])
@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.VirtualWork])
def test_blocks_give_what_the_whole_gives(backend: type, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if size == 56:
        monkeypatch.setattr(
            importlib.import_module("redundancy_pin.dynamics.inverse_dynamics"),
            "edge_of",
            lambda tree: len(tree.motion) - 5,
        )
    sampled = CIRCLE.sample(0.01)
    wave = 2.0 * sampled.t[:, None] + np.arange(2)
    carriers = CarrierMotion(0.05 * np.sin(wave), 0.1 * np.cos(wave), -0.2 * np.sin(wave))
    dynamics = backend(zoo.robot_of("2rpr"))
    expected = rp.inverse_dynamics(dynamics, sampled, carriers)
    blocks = list(rp.inverse_dynamics_in_blocks(dynamics, cut(sampled, size, carriers)))
    assert [len(one.efforts) for one in blocks] == [len(part) for part, _ in cut(sampled, size)]
    for of, name in (("efforts", "tau"), ("reduced", "carrier_force"), ("efforts", "residual"), ("reduced", "W")):
        np.testing.assert_allclose(
            together(blocks, of, name), getattr(getattr(expected, of), name), rtol=ROUNDING, atol=ROUNDING
        )
    np.testing.assert_array_equal(together(blocks, "efforts", "status"), expected.efforts.status)
    np.testing.assert_array_equal(together(blocks, "reduced", "t"), sampled.t)
    instants = [one for block in blocks for one in block.instants]
    assert len(instants) == 2
    np.testing.assert_allclose([one.t for one in instants], [one.t for one in expected.instants], atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("size", [7, 20])
def test_marked_samples_and_what_lies_behind_them(size: int) -> None:
    robot = zoo.robot_of("five_bar")
    path = Line([0.25, 1.4], [0.25, 0.2])
    line = Trajectory(path, RestToRest(path.length, duration=2.0)).sample(0.02)
    dynamics = rp.RneaDynamics(robot)
    expected = rp.inverse_dynamics(dynamics, line, unreachable="mark")
    blocks = list(rp.inverse_dynamics_in_blocks(dynamics, cut(line, size), unreachable="mark"))
    status = together(blocks, "efforts", "status")
    assert (status == SampleStatus.UNREACHABLE).any()
    np.testing.assert_array_equal(status, expected.efforts.status)
    [one] = [one for block in blocks for one in block.instants]
    assert one.t == pytest.approx(expected.instants[0].t, abs=1e-8)


def test_a_branch_goes_on_through_a_flat_pose_and_the_next_block(tmp_path: Path) -> None:
    """Behind the pose the linkage is in another working mode than its reference: blocks start there."""
    lengths = (0.3, 0.2, 0.3, 0.2)
    robot = folding_four_bar(tmp_path, lengths, (1.0, 1.0, 2.0), modes=True)
    crank = np.pi + np.linspace(-1.0, 1.0, 101)[:, None]
    rate = np.full_like(crank, 2.0)
    turning = PlatformMotion(0.01 * np.arange(101.0), crank, rate, 0.0 * rate)
    angle = rocker_motion(robot, lengths, crank[:, 0], rate[:, 0], 0.0 * rate[:, 0])[1]
    for size in (26,):
        blocks = list(rp.inverse_dynamics_in_blocks(rp.RneaDynamics(robot), cut(turning, size)))
        whole = rp.RneaDynamics(robot).reduce(turning)
        np.testing.assert_allclose(together(blocks, "reduced", "f"), whole.f, atol=1e-7)
    assert np.ptp(angle) > 0.0


@pytest.mark.parametrize(("start", "turns", "leaves"), [(2.0 * np.pi + 0.1, 0.9, False), (0.1, 1.4, True)])
def test_turns_are_those_of_the_whole_motion(start: float, turns: float, leaves: bool) -> None:
    """Each block alone could be counted from a turn that suits it."""
    crank = zoo.robot_of("four_bar").independent_joints[0]
    robot = zoo.robot_of("four_bar").with_limits({crank: {"lower": 0.0, "upper": 6.2}})
    angle = start + turns * 2.0 * np.pi * np.linspace(0.0, 1.0, 201)[:, None]
    rate = np.full_like(angle, turns * 2.0 * np.pi)
    turning = PlatformMotion(np.linspace(0.0, 1.0, 201), angle, rate, 0.0 * rate)
    blocks = list(rp.inverse_dynamics_in_blocks(rp.RneaDynamics(robot), cut(turning, 25)))
    out = together(blocks, "efforts", "status") == SampleStatus.OUT_OF_RANGE
    np.testing.assert_array_equal(out, angle[:, 0] > 6.2 if leaves else np.zeros(201, dtype=bool))
    assert any(block.joint_limits for block in blocks) == leaves


def test_errors_number_samples_from_the_beginning() -> None:
    sampled, robot = CIRCLE.sample(0.01), zoo.robot_of("2rpr")
    away = np.zeros((len(sampled), 2))
    away[150:, 1] = 1.0
    off = CarrierMotion(away, 0.0 * away, 0.0 * away, check_rates=False)
    path = Line([0.25, 0.6], [0.25, 1.9])
    leaving = Trajectory(path, RestToRest(path.length, duration=1.0)).sample(0.01)
    five = zoo.robot_of("five_bar")
    cases = [(robot, sampled, off, rp.errors.CarrierLimitError), (five, leaving, None, rp.errors.RedundancyPinError)]
    for one, samples, carriers, kind in cases:
        with pytest.raises(kind) as expected:
            rp.inverse_dynamics(rp.RneaDynamics(one), samples, carriers)
        with pytest.raises(kind) as caught:
            list(rp.inverse_dynamics_in_blocks(rp.RneaDynamics(one), cut(samples, 23, carriers)))
        assert type(caught.value) is type(expected.value)
        assert caught.value.message == expected.value.message
        assert caught.value.details["sample"] == expected.value.details["sample"]
        assert f"sample {caught.value.details['sample']}" in caught.value.message.lower()


def test_loads_sampled_in_time_are_refused() -> None:
    sampled = CIRCLE.sample(0.1)
    dynamics = rp.RneaDynamics(zoo.robot_of("2rpr")).with_external(
        rp.Wrench("end_effector", np.zeros((len(sampled), 6)))
    )
    with pytest.raises(rp.errors.InputError, match="function of time"):
        list(rp.inverse_dynamics_in_blocks(dynamics, cut(sampled, 5)))


def test_blocks_that_are_none_of_one_motion_are_refused() -> None:
    dynamics, one = rp.RneaDynamics(zoo.robot_of("2rpr")), CIRCLE.sample(0.1)
    wide = PlatformMotion(one.t + 100.0, *(np.hstack([part, part]) for part in (one.x, one.xd, one.xdd)))
    for blocks, words in (([one], "pair"), ([(1, None)], "motion"), ([(one, None), (wide, None)], "one motion")):
        with pytest.raises(rp.errors.InputError, match=words):
            list(rp.inverse_dynamics_in_blocks(dynamics, blocks))


def test_long_motions_are_compared_to_their_end() -> None:
    t = np.arange(50_000) * 1e-3
    x, xd, xdd = (3.0**k * np.sin(3.0 * t + 0.5 * np.pi * k)[:, None] for k in range(3))
    require_consistent(PlatformMotion(t, x, xd, xdd))
    for late in (16_667, 49_990):  # parts of a motion are compared one by one, without a gap
        wrong = x.copy()
        wrong[late:] += 0.02
        with pytest.raises(rp.errors.InputError, match=f"from sample {late - 1} to {late} ") as caught:
            require_consistent(PlatformMotion(t, wrong, xd, xdd))
        assert caught.value.details["time"] == t[late]


MEASURE = """
import re, resource, sys
from pathlib import Path
from redundancy_pin.cli import main
code = main(sys.argv[1:], standalone_mode=False)
kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if Path("/proc/self/status").exists():  # the other counts the process that started this one as well
    kilobytes = re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]
print("peak", kilobytes, code, file=sys.stderr)
"""


def peak(path: Path, tmp_path: Path) -> float:
    """Return MB at most in memory while the command works on a file."""
    command = ["inverse-dynamics", "--robot", "2rpr", "--motion", str(path), "--out", str(tmp_path / "out.csv")]
    done = subprocess.run([sys.executable, "-c", MEASURE, *command], capture_output=True, text=True, check=True)
    kilobytes, code = re.search(r"peak (\d+) (\d)", done.stderr).groups()
    assert code == "0"
    return int(kilobytes) / (1024.0 if sys.platform != "darwin" else 1024.0**2)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="resource")
def test_memory_does_not_grow_with_the_motion(tmp_path: Path) -> None:
    """10⁶ samples take what 2 · 10⁵ take, except for the numbers of the motion, which are held up to three times."""
    path, rate, step = tmp_path / "motion.csv", np.pi, 1e-3
    peaks, written = [], 0
    with path.open("w", encoding="utf-8") as stream:
        stream.write("t,x0,x1,xd0,xd1,xdd0,xdd1\n")
        for samples in (200_000, 1_000_000):
            while written < samples:
                t = step * np.arange(written, written + 20_000)
                out = np.stack([np.cos(rate * t), np.sin(rate * t)], axis=1)
                along = np.stack([-np.sin(rate * t), np.cos(rate * t)], axis=1)
                rows = np.hstack([t[:, None], [0.6, 0.5] + 0.05 * out, 0.05 * rate * along, -0.05 * rate**2 * out])
                stream.writelines(",".join(map(repr, row)) + "\n" for row in rows.tolist())
                written += len(t)
            stream.flush()
            peaks.append(peak(path, tmp_path))
            with (tmp_path / "out.csv").open(encoding="utf-8") as file:
                assert sum(1 for _ in file) == samples + 1
    columns = 7 + 2 * 3  # of the file, and of two carriers that are parked
    assert peaks[1] - peaks[0] < 3 * 8e-6 * columns * 800_000 + 25.0


def test_the_command_goes_by_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables, warnings and JSON are those of one block."""
    path, outputs = write_motion(tmp_path / "motion.csv", CIRCLE, 0.01), []
    for size in (20_000, 40):
        monkeypatch.setattr("redundancy_pin.cli.inverse_dynamics.BLOCK", size)
        done = call("inverse-dynamics", "--robot", "2rpr", "--motion", path, "--out", tmp_path / "out.csv", "--json")
        assert done.exit_code == 3
        outputs.append((done.stderr, json.loads(done.stdout)))
        assert (tmp_path / "out.csv").read_text(encoding="utf-8").count("\n") == 1 + outputs[-1][1]["samples"]
        monkeypatch.undo()
    (warned, one), (also_warned, other) = outputs
    assert warned == also_warned
    for instants, expected in zip(other.pop("singular_instants"), one.pop("singular_instants"), strict=True):
        numbers = [name for name in expected if isinstance(expected[name], float)]
        assert [instants.pop(name) for name in numbers] == pytest.approx(
            [expected.pop(name) for name in numbers], rel=1e-6
        )
        assert instants == expected
    for name in ("largest_tau", "largest_carrier_force", "smallest_margin", "largest_gap"):
        assert other.pop(name) == pytest.approx(one.pop(name), rel=1e-9, abs=1e-12)
    assert other == one


def test_blocks_compile_nothing_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block starts from another configuration, which is no other code."""
    monkeypatch.setenv("REDUNDANCY_PIN_CACHE", str(tmp_path))
    made, build = [], compiled.define
    monkeypatch.setattr(compiled, "define", lambda robot: (made.append(robot), build(robot))[1])
    motion = rp.trajectory.from_points([[1.0], [2.0]], [0.0, 1.0], ends="rest").sample(0.05)
    dynamics = rp.CompiledDynamics("four_bar")
    blocks = list(rp.inverse_dynamics_in_blocks(dynamics, cut(motion, 5)))
    assert len(made) == 1
    whole = rp.distribute(rp.RneaDynamics("four_bar").reduce(motion)).tau
    np.testing.assert_allclose(together(blocks, "efforts", "tau"), whole, atol=ROUNDING)


@pytest.mark.parametrize(
    ("margin", "edge"),
    [
        ([0.9] * 18 + [0.2, 0.1], 18),  # of the last tenth the one that is farthest from losing the branch,
        ([0.9] * 18 + [0.1, 0.2], 19),
        ([0.9] * 18 + [np.nan, 0.1], 19),  # which is closed,
        ([0.9] * 18 + [np.nan, np.nan], 19),  # or the last one
        ([0.1, 0.9, 0.3], 2),  # at least one
    ],
)
def test_a_block_begins_where_the_branch_is_safest(margin: list[float], edge: int) -> None:
    size = np.array(margin)
    tree: Any = SimpleNamespace(motion=size, reachable=np.isfinite(size), serial_margin_bound=size)
    assert edge_of(tree) == edge
