"""Four-bars that fold flat, and their closed form: smooth through the flat poses, on the branch of one tangent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Robot

MODEL = Path(__file__).parents[2] / "models" / "four_bar"

Lengths = tuple[float, float, float, float]
"""Ground, crank, coupler, rocker, m."""

_FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
_SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
_STEP = 5e-3


def folding_four_bar(
    folder: Path, lengths: Lengths, guess: tuple[float, float, float], *, modes: bool = False
) -> Robot:
    """Load the shipped four-bar with other lengths, from a guess of crank, rocker and coupler that picks the branch."""
    text = (MODEL / "robot.yaml").read_text()
    if not modes:
        text = text[: text.index("# mode +1")] + text[text.index("reference:") :]
    start = text.index("reference:")
    values = dict(zip(("crank", "rocker", "coupler"), guess, strict=True))
    text = f"{text[:start]}reference:\n  joints: {{crank: {guess[0]}}}\n  guess: {values}\n".replace("'", "")
    (folder / "robot.yaml").write_text(text)
    (folder / "four_bar.urdf.xacro").write_text((MODEL / "four_bar.urdf.xacro").read_text())
    names = ("ground_length", "crank_length", "coupler_length", "rocker_length")
    return load_robot(str(folder / "robot.yaml"), **dict(zip(names, lengths, strict=True)))


def joint(robot: Robot, name: str) -> int:
    """Return the column of a joint of one freedom."""
    return int(robot.model.joints[robot.model.getJointId(name)].idx_v)


def rocker_angle(lengths: Lengths, sign: float) -> Callable[[Array], Array]:
    """Return the rocker's angle as a function of the crank's, without a root that could lose its sign.

    With d the distance of the crank pin from the rocker's hinge, 16 times the squared area of coupler, rocker and d is
    ((b + c)² − d²) (d² − (b − c)²). Where b + c = g + a the first factor is 4 g a cos²(θ/2), where |b − c| = |g − a|
    the second is 4 g a sin²(θ/2).
    """
    g, a, b, c = lengths

    def angle(crank: Array) -> Array:
        squared = a * a + g * g - 2.0 * a * g * np.cos(crank)
        stretched = 2.0 * np.sqrt(a * g) * np.cos(crank / 2.0)
        folded = 2.0 * np.sqrt(a * g) * np.sin(crank / 2.0)
        if abs(b + c - g - a) > 1e-12:
            stretched = np.sqrt((b + c) ** 2 - squared)
        if abs(abs(b - c) - abs(g - a)) > 1e-12:
            folded = np.sqrt(squared - (b - c) ** 2)
        pin = a * np.exp(1j * crank) - g
        return np.unwrap(np.angle(pin * (c * c + squared - b * b + 1j * sign * stretched * folded)))

    return angle


def rocker_motion(
    robot: Robot, lengths: Lengths, crank: Array, rate: Array, second: Array
) -> tuple[Array, Array, Array]:
    """Return angle, rate and second rate of the rocker, by the closed form and its eighth-order differences."""
    home = robot.q_reference[joint(robot, "crank")], robot.q_reference[joint(robot, "rocker")]
    sign = min(
        (1.0, -1.0), key=lambda one: abs(np.sin((rocker_angle(lengths, one)(np.array([home[0]]))[0] - home[1]) / 2))
    )
    around = np.array([rocker_angle(lengths, sign)(at + _STEP * np.arange(-4, 5)) for at in crank])
    first, bend = around @ _FIRST / _STEP, around @ _SECOND / _STEP**2
    return around[:, 4], first * rate, bend * rate**2 + first * second
