"""Running the command line in tests."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import patch

import numpy as np
from click.testing import CliRunner, Result

from redundancy_pin.cli import main, output
from redundancy_pin.trajectory import Trajectory


def call(*arguments: str, every: float = 3600.0) -> Result:
    """Run ``redundancy-pin`` with arguments; an exception that is not an exit is raised, not swallowed.

    ``every`` so many seconds progress is printed on stderr: on a slow machine too, tests read there what they expect.
    """
    with patch.object(output, "EVERY", every):
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refused(*arguments: str, code: int = 2) -> str:
    """Run a command that must fail, and return its one line on stderr."""
    result = call(*arguments)
    assert result.exit_code == code, (result.exit_code, result.stderr)
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("error: ")
    assert "Traceback" not in result.stderr
    return lines[0]


def write_motion(path: Path, trajectory: Trajectory, dt: float, carriers: int = 0) -> Path:
    """Write a trajectory as a user would, with carriers that oscillate if there are any."""
    motion = trajectory.sample(dt)
    n = motion.x.shape[1]
    names = ["t", *(f"{name}{i}" for name in ("x", "xd", "xdd") for i in range(n))]
    columns = [motion.t[:, None], motion.x, motion.xd, motion.xdd]
    if carriers:
        names += [f"{name}{i}" for name in ("s", "sd", "sdd") for i in range(carriers)]
        wave = 2.0 * motion.t[:, None] + np.arange(carriers)
        columns += [0.05 * np.sin(wave), 0.1 * np.cos(wave), -0.2 * np.sin(wave)]
    rows = np.concatenate(columns, axis=1)
    lines = [",".join(names), *(",".join(repr(value) for value in row) for row in rows.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
