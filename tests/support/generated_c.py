"""Generated C, compiled and called from tests."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.codegen import write_c
from redundancy_pin.robot import Robot

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
NOTHING_WRITTEN = 6
"""Least status at which neither state nor result is written."""


def compiled(sources: Sequence[Path], target: Path, *flags: str, compiler: str = "gcc") -> Path:
    """Compile, with every warning an error."""
    command = [compiler, *STRICT, *flags, *map(str, sources), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return target


def run(program: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(program), *arguments], capture_output=True, text=True, check=False, timeout=300)


@functools.cache
def folder_of(robot: Robot) -> Path:
    """Write the C of a robot once a session, in a folder that stays until the process ends."""
    kept = tempfile.TemporaryDirectory(prefix="generated-")
    _KEPT.append(kept)
    return write_c(robot, Path(kept.name) / "code", prefix="unit").folder


_KEPT: list[tempfile.TemporaryDirectory[str]] = []


ACTUATED: Mapping[str, tuple[str, ...]] = {
    "more actuators": ("four_bar", "crank", "rocker"),
    "fewer actuators": ("five_bar", "base_1"),
}
"""Shipped machines with other actuated joints: a machine, and what ``zoo.driven_by`` drives of it."""


class Code:
    """The functions of a robot's C, with numpy arrays."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        folder = folder_of(robot)
        library = folder.parent / "unit.so"
        if not library.exists():
            compiled([folder / "unit.c"], library, "-O0", "-shared", "-fPIC")
        self._library = ctypes.CDLL(str(library))
        n, m, k, nq, nv = robot.n, robot.m, robot.k, robot.model.nq, robot.model.nv
        r = sum(len(closure.axes) for closure in robot.closures)
        nx = 16 if robot.platform is not None and robot.platform.is_pose else n
        self.state_type = _struct(q=nq, sign=0)
        carriers = {"s": k, "sd": k, "sdd": k} if k else {}
        self.motion_type = _struct(x=nx, xd=n, xdd=n, **carriers)
        force = {"carrier_force": k} if k else {}
        scalars = dict.fromkeys(("residual", "margin", "condition", "type_I_margin", "closure_residual"), 0)
        self.efforts_type = _struct(tau=m, W=n * m, f=n, **force, **scalars, rank=-1)
        self.drives_type = _struct(position=m, velocity=m)
        self.platform_type = _struct(x=nx, xd=n, mismatch=0, margin=0, type_I_margin=0, closure_residual=0)
        self.jacobians_type = _struct(**({"closure": r * nv} if r else {}), gamma=nv * n, W=n * m)
        self.margins_type = _struct(type_I=0, type_II=0, condition=0, rank=-1)

    def call(self, name: str, *arguments: Any) -> int:
        given = [ctypes.byref(each) if isinstance(each, ctypes.Structure) else each for each in arguments]
        return int(getattr(self._library, f"unit_{name}")(*given))

    def start(self) -> Any:
        state = self.state_type()
        assert self.call("reset", state) == 0
        return state

    def go_to(self, state: Any, x: Array) -> int:
        return self.call("go_to", state, (ctypes.c_double * x.size)(*x.ravel()))

    def efforts(self, state: Any, *motion: Array) -> SimpleNamespace:
        """Return status and results; motion is x, xd, xdd and, with carriers, s, sd, sdd."""
        given, out = filled(self.motion_type, *motion), filled_with(self.efforts_type, 7.0)
        status = self.call("inverse_dynamics", state, given, out)
        return _read(out, status)

    def platform(self, state: Any, position: Array, velocity: Array) -> SimpleNamespace:
        given, out = filled(self.drives_type, position, velocity), filled_with(self.platform_type, 7.0)
        return _read(out, self.call("forward_kinematics", state, given, out))

    def at(self, what: str, state: Any) -> SimpleNamespace:
        out = filled_with(getattr(self, f"{what}_type"), 7.0)
        return _read(out, self.call(f"{what}_at", state, out))


def _struct(**sizes: int) -> type[ctypes.Structure]:
    """A structure of arrays of doubles; 0 is one number, -1 an integer."""
    kinds = {0: ctypes.c_double, -1: ctypes.c_int}
    fields = [(name, kinds[size] if size < 1 else ctypes.c_double * size) for name, size in sizes.items()]
    return type("Struct", (ctypes.Structure,), {"_fields_": fields})


def filled(kind: type[ctypes.Structure], *values: Array) -> Any:
    return kind(*((ctypes.c_double * np.size(value))(*np.ravel(value)) for value in values))


def filled_with(kind: type[ctypes.Structure], value: float) -> Any:
    made = kind()
    ctypes.memmove(ctypes.byref(made), np.full(ctypes.sizeof(kind) // 8, value).tobytes(), ctypes.sizeof(kind) // 8 * 8)
    return made


def _read(out: Any, status: int) -> SimpleNamespace:
    values = {name: getattr(out, name) for name, *_ in out._fields_}
    arrays = {name: value if isinstance(value, (int, float)) else np.array(value) for name, value in values.items()}
    return SimpleNamespace(status=status, raw=bytes(out), **arrays)
