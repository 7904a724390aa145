"""``redundancy-pin show``: what it writes, what it refuses, and a live viewer that ends with Ctrl-C."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from command_line import call, write_motion

import redundancy_pin as rp
from redundancy_pin.trajectory import reference


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("plan") / "plan.npz"
    plan = rp.plan_switch_off(
        rp.VirtualWork(rp.load_robot("2rpr")), reference.circle(speed=0.5), threshold=7.0, mesh=rp.Mesh(dt=0.01)
    )
    plan.save(file)
    return file


def test_a_robot_is_written_to_one_file(tmp_path: Path) -> None:
    done = call("show", "3rrr", "--html", tmp_path / "out.html", "--json")  # MODEL, or --robot
    assert done.exit_code == 0
    facts = json.loads(done.stdout)
    assert facts["title"] == "3rrr"
    assert facts["duration"] == pytest.approx(reference.corner().duration)
    assert [path.name for path in tmp_path.iterdir()] == ["out.html"]
    assert (tmp_path / "out.html").stat().st_size < 3e6


def test_a_plan_is_shown_with_its_own_robot(tmp_path: Path, plan_file: Path) -> None:
    done = call("show", "--plan", plan_file, "--html", tmp_path / "out.html", "--no-forces")
    assert done.exit_code == 0
    assert "2rpr: switch off" in done.stdout
    text = (tmp_path / "out.html").read_text(encoding="utf-8")
    assert "<title>2rpr: switch off" in text
    assert re.search(r'id="forces" type="checkbox"\s*>', text)


def test_a_motion_is_read_as_inverse_dynamics_reads_it(tmp_path: Path) -> None:
    trajectory = reference.line(speed=0.2)
    motion = write_motion(tmp_path / "in.csv", trajectory, dt=0.01, carriers=2)
    done = call("show", "--robot", "2rpr", "--motion", motion, "--html", tmp_path / "out.html", "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["duration"] == pytest.approx(trajectory.duration)


def test_a_live_view_runs_until_it_is_interrupted() -> None:
    command = [sys.executable, "-c", "from redundancy_pin.cli import main; main()", "show", "--robot", "five_bar"]
    # a shell starts what runs in its background with Ctrl-C ignored, and children inherit that
    heeding = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **heeding) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            line = process.stdout.readline()
            (url,) = re.findall(r"http://\S+", line)
            with urllib.request.urlopen(url, timeout=10) as answer:
                assert b"MeshCat" in answer.read()
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=20) == 0
        finally:
            process.kill()
        assert process.stderr.read() == ""
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=10)
