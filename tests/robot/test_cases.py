"""Files that say what they mean: their first comment lists what is loaded, asked or refused of them, one case a line.

A case has the arguments of ``load_robot`` (``with``) or of ``propose_robot`` (``new``), texts that are replaced in the
file before (``replace``), arguments of ``with_parameters`` (``change``), and what comes of it: facts of the robot
(``facts``, below), parts of one note each (``notes``; of none, ``silent``), of the questions (``asks``, none if it is
empty), or of the error (``raises``).
"""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.loading import propose_robot

FILES = Path(__file__).parent / "files"
CASES = [
    pytest.param(path, case, id=f"{path.name}-{number}")
    for path in sorted(FILES.glob("*/cases/*.*"))
    if path.suffix != ".xml" or find_spec("mujoco")
    for number, case in enumerate(yaml.safe_load(re.findall(r"<!--(.*?)-->", path.read_text(), re.DOTALL)[0]))
]


def facts(robot: rp.Robot) -> dict[str, Any]:
    """Return what cases may say of a robot; mappings are by joint or link, of which a case may say some."""
    model, data = robot.model, robot.model.createData()
    q = np.array(robot.q_reference)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    joints = dict(zip(map(str, list(model.names)[1:]), list(model.joints)[1:], strict=True))
    single = {name: joint for name, joint in joints.items() if joint.nv == 1}
    jacobian = np.reshape(data.J, (6, -1))
    twists = {name: jacobian[:, joint.idx_v] for name, joint in single.items()}
    bodies = dict(zip(joints, list(model.inertias)[1:], strict=True))
    places = {frame.name: data.oMf[i] for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY}

    def ends(what: str, at: str) -> dict[str, list[float]]:
        return {
            name: [float(getattr(model, f"{end}{what}Limit")[getattr(joint, at)]) for end in ("lower", "upper")]
            for name, joint in single.items()
        }

    return {
        **{name: getattr(robot, name) for name in ("n", "m", "actuated", "gravity")},
        "nq": model.nq,
        "joints": list(joints),
        "independent": robot.independent_joints,
        "closures": len(robot.closures),
        "couplings": [[each.joint, each.of, *each.polynomial] for each in robot.couplings],
        "loads": [repr(load) for load in robot.loads],
        "positions": {name: q[joint.idx_q] for name, joint in single.items() if joint.nq == 1},
        "ranges": ends("Position", "idx_q"),
        "efforts": ends("Effort", "idx_v"),
        "speeds": {name: model.upperVelocityLimit[joint.idx_v] for name, joint in single.items()},
        "armature": {name: model.armature[joint.idx_v] for name, joint in single.items()},
        "axes": {name: twist[3:] if twist[3:].any() else twist[:3] for name, twist in twists.items()},
        "centres": {name: body.lever for name, body in bodies.items()},
        "moments": {name: body.inertia.diagonal() for name, body in bodies.items()},
        "places": {name: [*place.translation, *pin.rpy.matrixToRpy(place.rotation)] for name, place in places.items()},
    }


def require_same(found: Any, expected: Any) -> None:
    """Numbers agree to 1e-9."""
    if isinstance(expected, dict):
        for name, value in expected.items():
            require_same(found[name], value)
    elif isinstance(expected, list) and all(isinstance(value, int | float) for value in expected):
        assert list(found) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    else:
        assert (list(map(str, found)) if isinstance(expected, list) else found) == (
            list(map(str, expected)) if isinstance(expected, list) else pytest.approx(expected, rel=1e-9)
        )


@pytest.mark.parametrize(("path", "case"), CASES)
def test_a_file_means_what_its_comment_says(path: Path, case: dict[str, Any], tmp_path: Path) -> None:
    expected, text = dict(case), path.read_text().partition("-->")[2]
    for old, new in expected.pop("replace", {}).items():
        assert old in text
        text = text.replace(old, new, 1)
    own = tmp_path / path.name
    own.write_text(text)
    given, decided = expected.pop("with", {}), expected.pop("new", None)
    parts = expected.pop("raises", None)
    if parts is not None:
        with pytest.raises(RedundancyPinError) as refusal:
            rp.load_robot(own, **given) if decided is None else propose_robot(own, **decided)
        assert refusal.value.remedy
        assert [part for part in parts if part not in str(refusal.value)] == []
        return
    if decided is None:
        robot = rp.load_robot(own, **given)
        if change := expected.pop("change", None):
            robot = rp.with_parameters(robot, **change)
    else:
        proposal, robot = propose_robot(own, **decided)
        asked, parts = " ".join(proposal.questions), expected.pop("asks", [])
        assert [part for part in parts if part not in asked] == []
        assert bool(parts) == bool(asked)
        assert not any(part in asked for part in expected.pop("never", []))
        driven = list(proposal.mechanism.actuated)
        assert [proposal.motors, driven] == [expected.pop("motors", proposal.motors), expected.pop("driven", driven)]
    for part in expected.pop("notes", []):
        assert sum(part in note for note in robot.notes) == 1
    assert not [note for part in expected.pop("silent", []) for note in robot.notes if part in note]
    if torque := expected.pop("torque", None):
        require_same(rp.RneaDynamics(robot).torque(*torque[:3]).tau, torque[3])
    if expected:
        require_same(facts(robot), expected)
