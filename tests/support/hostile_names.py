"""Names as strangers may give them to a robot, its joints and its links, and a robot that has them everywhere."""

from __future__ import annotations

import functools
from pathlib import Path
from xml.sax.saxutils import quoteattr

import yaml
from parked_plans import parked_plan

import redundancy_pin as rp
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot

LONGEST = 255
"""Letters of a name."""

NAMES = {
    "mathtext": "$x_1$",
    "mathtext that fails": r"$\frac$",
    "underscore first": "_motor",
    "prototype": "__proto__",
    "property of every object": "constructor",
    "mark of the page": "{{ viewer }}",
    "another mark": "{{ data }}{% raw %}",
    "end of a script": "</script><script>alert(1)</script>",
    "end of a comment": "--> */ <!-- /*",
    "attribute": '" onload="alert(1)',
    "formula": "=1+1",
    "plus": "+1+1",
    "minus": "-1+1",
    "at": "@SUM(A1:A9)",
    "formula of full width": "＝1+1",
    "formula behind a semicolon": "a;=1+1",
    "quotes": '"it\'s"',
    "apostrophe": "'=1+1",
    "backslash": "a\\nb\\",
    "entities": "&amp;&lt;b&gt;",
    "templates": "{{ 7 * 7 }} ${7*7} @{7}@ {% raw %}",
    "macro": "??/ \\u000a #define",
    "comma": "a,b",
    "slash": "../a/b",
    "as many letters as may be": "x" * LONGEST,
    "other letters": "関節 θ ß",
    "picture": "\N{ROBOT FACE}",
    "name of the base": "base",
    "nothing": "null",
    "Markdown": "# [a](b) | <b>*c*</b>",
}
"""By what they try."""


def other(name: str, mark: str) -> str:
    """Return another name that begins as a name does."""
    return name[: LONGEST - len(mark)] + mark


def joints_of(name: str) -> dict[str, str]:
    """Return the joints of the robot of a name by those of the shipped one."""
    return {"slide_1": name, "slide_2": other(name, "2"), "carrier_1": other(name, "3"), "swivel_1": other(name, "4")}


@functools.cache
def _urdf() -> str:
    return rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3, piston_mass=0.2).urdf


def write_hostile(folder: Path, name: str) -> Path:
    """Write a robot that has a name, with variants of it for its joints, links and closures; return its declaration."""
    joints = joints_of(name)
    new = {**joints, "end_effector": other(name, "5"), "piston_2": other(name, "6")}
    urdf = _urdf().replace('<robot name="2rpr"', f"<robot name={quoteattr(name)}", 1)
    for old, given in new.items():
        urdf = urdf.replace(f'"{old}"', quoteattr(given))
    (folder / "robot.urdf").write_text(urdf, encoding="utf-8")
    data = {
        "name": name,
        "urdf": "robot.urdf",
        "gravity": [0, 0, 0],
        "closures": [{"name": name, "frames": [new["end_effector"], new["piston_2"]], "axes": ["x", "y"]}],
        "actuated": [joints["slide_1"], joints["slide_2"]],
        "carriers": [
            {"joint": joints["carrier_1"], "acceleration": 10.0},
            {"joint": "carrier_2", "acceleration": 10.0},
        ],
        "independent": {"platform": new["end_effector"], "axes": ["x", "y"]},
        "reference": {
            "platform": [0.25, 0.4],
            "guess": {joints["swivel_1"]: 1.0, joints["slide_1"]: 0.47, "swivel_2": 2.1, joints["slide_2"]: 0.47},
        },
    }
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump(data, allow_unicode=True), encoding="utf-8")
    return path


def plan_of(robot: Robot) -> Plan:
    """Return a short plan in which no carrier moves."""
    motion = rp.trajectory.reference.circle(speed=0.1).sample(0.05)[:2]
    return parked_plan(rp.RneaDynamics(robot), motion)
