"""Files that cannot be meant, or are read in part: the error, or a note, says what their first comment says."""

from __future__ import annotations

import logging
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError, ModelFileError, RedundancyPinError
from redundancy_pin.loading import propose_robot
from redundancy_pin.robot.shipped import shipped_robots

FILES = Path(__file__).parent / "files"
BAD, NOTED, SILENT = (
    [path for path in sorted(FILES.glob(f"*/{kind}/*.*")) if path.suffix != ".xml" or find_spec("mujoco")]
    for kind in ("bad", "noted", "silent")
)
DECLARATIONS: dict[str, dict[str, Any]] = yaml.safe_load((FILES / "declaration" / "bad.yaml").read_text())


def skip_newer_than_mujoco(path: Path) -> None:
    """Springs that yield, and the check of what is discarded, came with MuJoCo 4."""
    if path.stem in ("yielding", "discarded") and int(pytest.importorskip("mujoco").__version__.partition(".")[0]) < 4:
        pytest.skip("of MuJoCo 4")


def comment_of(path: Path) -> str:
    found = re.search(r"<!-- (.*) -->", path.read_text())
    assert found
    return found[1]


@pytest.mark.parametrize("path", NOTED, ids=lambda path: path.name)
def test_what_is_not_in_force_is_noted(path: Path) -> None:
    assert sum(comment_of(path) in note for note in rp.load_robot(path).notes) == 1


@pytest.mark.parametrize("path", SILENT, ids=lambda path: path.name)
def test_what_is_in_force_is_not_noted(path: Path) -> None:
    notes = " ".join(rp.load_robot(path).notes)
    assert not re.search("<inertial>|Not in force|Passed over|Contacts", notes)


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_state_all_masses(name: str) -> None:
    known = rp.load_robot(name).parameters
    switches = {key: True for key in ("carriers", "rod_carriers", "end_effector_carriers") if key in known}
    assert not any("<inertial>" in note for note in rp.load_robot(name, **switches).notes)


def test_links_without_a_mass_are_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "once.urdf"
    path.write_text((FILES / "urdf" / "noted" / "massless_crank.urdf").read_text())
    with caplog.at_level(logging.WARNING, "redundancy_pin"):
        note, _ = (rp.load_robot(path).notes[0] for _ in range(2))
    assert [each for each in caplog.messages if "<inertial>" in each] == [f"once.urdf: {note}"]


@pytest.mark.parametrize("path", sorted(FILES.glob("urdf/open/*.urdf")), ids=lambda path: path.stem)
def test_what_a_urdf_leaves_open_is_certain_or_asked(path: Path) -> None:
    """The comment: what is asked, the arguments of ``new`` that decide it, and what comes of them."""
    case = yaml.safe_load(comment_of(path))
    proposal, robot = propose_robot(path)
    if "asks" in case:
        assert case["asks"] in " ".join(proposal.questions)
        assert case.get("never", "?!") not in " ".join(proposal.questions)
        if "of the links" in case["asks"]:  # what may be wrong is not written either
            assert set(proposal.found) <= {"closing_a_1 = closing_a_2", "arm_loop = rod_loop"}
        with pytest.raises(DeclarationError, match=rf"does not say it all.*`redundancy-pin new {path.name}`"):
            rp.load_robot(path)
    elif "decided" not in case:
        loaded = rp.load_robot(path)
        assert list(loaded.actuated) == list(proposal.mechanism.actuated) == case["actuated"]
        changes = {"masses": {next(body.name for body in loaded.bodies if body.mass): 2.0}}
        if "pin_r1" in loaded.model.names:  # moved by it, ends do not meet at zero any more
            place = loaded.model.jointPlacements[loaded.model.getJointId("pin_r1")].translation
            changes["lengths"] = {"pin_r1": 1.01 * float(np.linalg.norm(place))}
        for key, value in changes.items():
            changed = rp.with_parameters(loaded, **{key: value})
            assert (changed.n, changed.closures) == (loaded.n, loaded.closures)
    if "n" in case:
        proposal, robot = propose_robot(path, **case.get("decided", {}))
        assert (proposal.questions, robot.n, len(robot.closures)) == ((), case["n"], case["closures"])
        assert list(robot.independent_joints) == case.get("independent", list(robot.independent_joints))


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.name)
def test_a_file_that_cannot_be_meant_is_refused_by_name(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing is only on the error stream, where urdfdom and MuJoCo write."""
    skip_newer_than_mujoco(path)
    with pytest.raises(RedundancyPinError) as refusal:
        rp.load_robot(path)
    assert comment_of(path) in str(refusal.value)
    assert refusal.value.remedy
    assert path.name in str(refusal.value) or path.suffix == ".xml" or " parts/" in comment_of(path)
    assert "line " in str(refusal.value) or path.suffix != ".sdf"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("message", DECLARATIONS)
def test_a_declaration_that_cannot_be_meant_is_refused_by_name(message: str, tmp_path: Path) -> None:
    """The table gives what differs from ``declaration/robot.yaml``; a key of null is left out."""
    declaration = yaml.safe_load((FILES / "declaration" / "robot.yaml").read_text()) | DECLARATIONS[message]
    given = {key: value for key, value in declaration.items() if value is not None}
    (tmp_path / "bar.urdf").write_text((FILES / "declaration" / "bar.urdf").read_text())
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(given))
    with pytest.raises(DeclarationError) as refusal:
        rp.load_robot(tmp_path)
    assert message in str(refusal.value)
    assert refusal.value.remedy


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("- {frames: [tip1, tip2]", "- {frames: [tip1, tip3]", 4),
        ("actuated: [a1, a2]", "actuated: [a1, a3]", 5),
        ("- {joint: slider", "- {joint: slides", 7),
        ("b1: -1.0", "b3: -1.0", 12),
    ],
)
def test_a_name_that_the_model_does_not_have_is_refused_at_its_line(
    right: str, wrong: str, line: int, tmp_path: Path
) -> None:
    text = (FILES / "declaration" / "robot.yaml").read_text()
    assert right in text
    (tmp_path / "bar.urdf").write_text((FILES / "declaration" / "bar.urdf").read_text())
    (tmp_path / "robot.yaml").write_text(text.replace(right, wrong))
    with pytest.raises(DeclarationError, match=rf"robot\.yaml, line {line}: The model has no"):
        rp.load_robot(tmp_path)


@pytest.mark.parametrize(("given", "value"), [('gravity: [0, 0, "-9.81 * 1"]', -9.81), ("", 0.0)])
def test_a_declaration_of_a_urdf_that_leaves_gravity_out_has_none(given: str, value: float, tmp_path: Path) -> None:
    path = FILES / "urdf" / "good" / "urdf_plus.urdf"
    (tmp_path / "robot.yaml").write_text(f"urdf: {path}\nactuated: [motor]\n{given}\n")
    robot = rp.load_robot(tmp_path)
    assert robot.gravity.tolist() == [0.0, 0.0, value]
    noted = [note for note in robot.notes if note.startswith("No file states gravity: it is [0.0, 0.0, 0.0]")]
    assert len(noted) == (given == "") == sum("states gravity" in note for note in robot.notes)


@pytest.mark.parametrize(
    ("name", "details"),
    [
        ("negative_mass", {"link": "l1", "line": 5}),
        ("axis_of_length_zero", {"joint": "slider", "line": 20}),
        ("unknown_parent", {"joint": "b1", "link": "l11"}),
        ("two_parents", {"link": "l2"}),
    ],
)
def test_what_a_mistake_is_about_is_in_its_details(name: str, details: dict[str, object]) -> None:
    with pytest.raises(ModelFileError) as caught:
        rp.load_robot(FILES / "urdf" / "bad" / f"{name}.urdf")
    assert details.items() <= caught.value.details.items()


def test_a_file_behind_a_link_is_named_by_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "machine").symlink_to(FILES / "sdf" / "bad", target_is_directory=True)
    with pytest.raises(ModelFileError, match=r"'part' of parts/wind\.sdf is in the wind"):
        rp.load_robot(tmp_path / "machine" / "included_wind.sdf")
