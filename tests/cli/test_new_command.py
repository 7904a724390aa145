"""``new``: a declaration that loads, or one that asks; the loops and motors themselves are judged in tests/robot."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import call, refused
from written import J, urdf_of

import redundancy_pin as rp
from redundancy_pin.errors import DeclarationError

GUIDE = Path(__file__).parents[2] / "docs/guide/own_robot.md"
FILES = Path(__file__).parents[1] / "robot" / "files"


@pytest.fixture
def urdf(tmp_path):
    """The four-bar of the guide, which does not close at zero, where its links lie in a line."""
    path = tmp_path / "crank_drive.urdf"
    path.write_text(re.search(r"<robot .*?</robot>\n", GUIDE.read_text(encoding="utf-8"), re.DOTALL)[0])
    return path


DECIDED = ("--close", "coupler_tip,rocker_tip", "--actuate", "crank", "--guess", "crank=1,knee=-0.6,rocker=1.4")


def test_what_is_asked_is_in_the_file_until_it_is_decided(urdf, tmp_path):
    asked = call("new", urdf)
    assert asked.exit_code == 2
    assert "undecided: Where are loops cut?" in asked.stderr
    assert "--close rocker_tip,coupler_tip (the only two)" in asked.stderr
    assert "undecided: Which joints are driven, of crank, knee, rocker?" in asked.stderr
    # all that is asked is asked at once: with the three answers it is done
    assert "name the branch too, --guess JOINT=VALUE" in asked.stderr
    assert call("new", urdf, *DECIDED, "--out", tmp_path / "at_once.yaml").exit_code == 0
    with pytest.raises(DeclarationError, match=r"Where are loops cut\?.*Which joints are driven.*`undecided`"):
        rp.load_robot(tmp_path)
    declared = yaml.safe_load((tmp_path / "robot.yaml").read_text())
    # as a user would decide it in the file
    declared |= {"closures": [{"ball": ["coupler_tip", "rocker_tip"]}], "actuated": ["crank"]}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(declared))
    with pytest.raises(DeclarationError, match="Where are loops cut"):
        rp.load_robot(tmp_path)
    del declared["undecided"]
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(declared))
    assert rp.load_robot(tmp_path).n == 1


def test_what_is_decided_loads_and_is_closed(urdf, tmp_path):
    branch = call("new", urdf, *DECIDED[:4])
    assert (branch.exit_code, "undecided: Which branch?" in branch.stderr) == (2, True)
    assert call("new", urdf, *DECIDED).exit_code == 0  # in place of the file whose questions are open
    assert "is there already" in refused("new", urdf, *DECIDED)
    assert "names no joint" in refused("new", urdf, "--close", "coupler_tip")  # what was asked comes first
    out = tmp_path / "other" / "own.yaml"
    out.parent.mkdir()
    run = call("new", urdf, *DECIDED, "--out", out)
    assert (run.exit_code, run.stderr) == (0, "")
    assert "loop: ball of coupler_tip and rocker_tip, by --close" in run.stdout
    assert "motors: crank, by --actuate" in run.stdout
    assert "n = 1, m = 1" in run.stdout
    robot = rp.load_robot(out)
    # lengths by hand: a crank of 0.1, a coupler of 0.3, a rocker of 0.2 on a base of 0.3; the branch that was named
    crank, knee, rocker = robot.q_reference
    tip = 0.1 * np.exp(1j * crank) + 0.3 * np.exp(1j * (crank + knee))
    assert tip == pytest.approx(0.3 + 0.2 * np.exp(1j * rocker), abs=1e-10)
    assert [crank, knee, rocker] == pytest.approx([1.0, -0.6, 1.4], abs=0.2)


def test_joints_that_a_guess_leaves_out_are_named_with_the_branch_that_was_taken(urdf, tmp_path):
    """The crank alone: knee and rocker start at 0, and the branch is the other one; with what is listed it is kept."""
    run = call("new", urdf, *DECIDED[:4], "--guess", "crank=1")
    assert run.exit_code == 0
    named = re.search(r"--guess leaves out knee, rocker: the branch is the one with (\S+);", run.stderr)
    moved = re.search(r"closed far from --guess, with crank=(\S+), not 1:", run.stderr)
    assert named is not None
    assert moved is not None
    robot = rp.load_robot(tmp_path)
    at = dict(zip(list(robot.model.names)[1:], robot.q_reference.tolist(), strict=True))
    for name, value in (("crank", moved[1]), *(one.split("=") for one in named[1].split(","))):
        assert float(value) == pytest.approx(at[name], rel=5e-3)
    whole = call(
        "new", urdf, *DECIDED[:4], "--guess", f"crank={at['crank']:.6g},{named[1]}", "--out", tmp_path / "b.yaml"
    )
    assert (whole.exit_code, whole.stderr) == (0, "")
    assert rp.load_robot(tmp_path / "b.yaml").q_reference == pytest.approx(robot.q_reference, abs=0.02)


def test_a_joint_that_the_loops_move_a_little_is_said(urdf):
    """The four-bar closes for a knee some hundredths from -0.6: a note, no warning."""
    run = call("new", urdf, *DECIDED)
    assert (run.exit_code, run.stderr) == (0, "")
    (said,) = [line for line in run.stdout.splitlines() if line.startswith("The loops closed near --guess, with ")]
    robot = rp.load_robot(urdf.parent)
    at = dict(zip(list(robot.model.names)[1:], robot.q_reference.tolist(), strict=True))
    moved = {
        name: at[name]
        for name, guess in (("crank", 1.0), ("knee", -0.6), ("rocker", 1.4))
        if abs(at[name] - guess) > 1e-3
    }
    assert dict(re.findall(r"(\w+)=(\S+), not", said)) == {name: f"{value:.6g}" for name, value in moved.items()}


def test_other_formats(tmp_path):
    """Loops and motors of MJCF are in force by themselves; the reference is its own; hinges for balls get no name."""
    path = tmp_path / "model.xml"
    path.write_text(
        '<mujoco><worldbody><body><joint name="m" type="hinge" axis="0 0 1"/><geom size=".1"/><body pos=".3 0 0">'
        '<joint name="b" type="ball"/><geom size=".1" pos=".1 0 0"/></body></body></worldbody>'
        '<actuator><motor joint="m"/></actuator></mujoco>'
    )
    run = call("new", path)
    assert run.exit_code == 0
    assert "has 4 degrees of freedom and 1 actuated joint (m)" in run.stdout
    assert set(yaml.safe_load((tmp_path / "robot.yaml").read_text())) == {"name", "urdf", "closures", "actuated"}
    assert rp.load_robot(tmp_path).n == rp.load_robot(path).n == 4


def test_loops_of_the_file_are_listed_and_in_force(tmp_path):
    facts = json.loads(
        call("new", FILES / "urdf/good/urdf_plus.urdf", "--out", tmp_path / "robot.yaml", "--json").stdout
    )
    assert facts["loops"] == [{"name": "pin", "kind": "hinge", "links": ["bar", "arm"]}]
    assert (facts["found"], facts["actuated"], facts["motors"]) == ({}, ["motor"], "stated by the file")
    assert facts["undecided"] == []
    assert (rp.load_robot(tmp_path).n, len(rp.load_robot(tmp_path).closures)) == (1, 1)


def test_links_without_inertial_and_missing_motors_are_named(tmp_path):
    path = tmp_path / "arm.urdf"
    joints = [J("drive", "revolute", "base", "upper"), J("pin", "revolute", "upper", "lower", (0.3, 0, 0))]
    path.write_text(
        urdf_of(joints).replace("</robot>", '<transmission name="t"><joint name="drive"/></transmission></robot>')
    )
    assert "arm has 2 degrees of freedom and 1 actuated joint (drive)" in call("new", path, "--open").stdout
    bare = re.sub(r'<link name="lower">.*?</link>', '<link name="lower"/>', path.read_text())
    path.write_text(bare)
    assert "massless: lower" in call("new", path, "--out", tmp_path / "bare.yaml").stdout


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["model.xml"], "it does not exist"),
        (["nothing.urdf"], "nothing.urdf"),
        (["notes.yaml"], "no model of a robot"),
        (["crank_drive.urdf", "--guess", "crank"], "guess is 'crank', not JOINT=VALUE"),
        (["crank_drive.urdf", "--guess", "crack=1", *DECIDED[:4]], "'crack'"),
        (["crank_drive.urdf", "--close", "coupler_tip"], "close = 'coupler_tip' names no joint"),
    ],
)
def test_refusals(given, message, urdf, tmp_path):
    (tmp_path / "notes.yaml").write_text("a: 1\n")
    assert message in refused("new", tmp_path / given[0], *given[1:])
    assert not (tmp_path / "robot.yaml").exists()


def test_a_file_without_loops_is_told_how_to_close_one_and_asked_for_as_many_motors_as_it_has_freedoms(
    tmp_path: Path,
) -> None:
    file = tmp_path / "arm.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("base", "upper", "lower"))
    joint = '<joint name="{}" type="continuous"><parent link="{}"/><child link="{}"/><origin xyz="1 0 0"/></joint>'
    joints = joint.format("shoulder", "base", "upper") + joint.format("elbow", "upper", "lower")
    file.write_text(f'<robot name="arm">{links}{joints}</robot>')
    result = call("new", file)
    assert (
        "loops: none; where origins of links meet in a joint that the file leaves out, name it: --close A,B;"
        in result.stdout
    )
    assert "The mechanism has 2 DOF" in result.stderr


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "redundancy_pin", "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout.startswith("redundancy-pin, version ")


def test_a_joint_of_sdf_that_closes_the_loop_may_be_driven(tmp_path):
    """It is a joint of the tree then, whose end is welded: the torques are those of the file with that motor."""
    out = tmp_path / "robot.yaml"
    assert call("new", FILES / "sdf/good/plain.sdf", "--actuate", "pin", "--out", out).exit_code == 0
    robot, alone = rp.load_robot(out), rp.load_robot(FILES / "sdf/good/plain.sdf", actuated="pin")
    assert (robot.actuated, robot.independent_joints, robot.n) == (("pin",), ("pin",), 1)
    motion = rp.PlatformMotion([0.0], [[0.1]], [[0.7]], [[-0.4]])
    torques = [rp.inverse_dynamics(rp.RneaDynamics(each), motion).efforts.tau for each in (robot, alone)]
    assert np.abs(torques[0]).max() > 1e-3
    assert torques[0] == pytest.approx(torques[1], rel=1e-9)


FIVE_BAR = """<mujoco><compiler angle="radian"/><worldbody>
<body><joint name="left" axis="0 0 1"/><inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
  <body><joint name="car" type="slide" axis="1 0 0" range="-.05 .05"/>
    <inertial pos=".1 0 0" mass=".5" diaginertia=".001 .001 .001"/></body>
  <body pos=".4 0 0"><joint name="elbow" axis="0 0 1"/><inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
    <site name="a" pos=".5 0 0"/></body></body>
<body pos=".3 0 0"><joint name="right" axis="0 0 1"/><inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
  <body pos=".4 0 0"><joint name="knee" axis="0 0 1"/><inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
    <site name="b" pos=".5 0 0"/></body></body>
</worldbody><equality><connect site1="a" site2="b"/></equality>
<actuator><motor joint="left"/><motor joint="right"/><motor joint="car"/></actuator></mujoco>"""


def test_carriers_are_declared(tmp_path):
    path = tmp_path / "five.xml"
    path.write_text(FIVE_BAR)
    run = call("new", path, "--carrier", "car", "--guess", "left=1.8,elbow=-1.2,right=1.2,knee=1.2", "--json")
    facts = json.loads(run.stdout)
    assert (run.exit_code, facts["carriers"], facts["actuated"]) == (0, ["car"], ["left", "right"])
    robot = rp.load_robot(tmp_path)
    assert (robot.n, robot.m, robot.carriers) == (2, 2, ("car",))
    # bars of 0.4 and 0.5 m on feet that are 0.3 m apart; the branch is that of the guess
    left, _, elbow, right, knee = robot.q_reference
    tips = [0.4 * np.exp(1j * base) + 0.5 * np.exp(1j * (base + bend)) for base, bend in ((left, elbow), (right, knee))]
    assert tips[0] == pytest.approx(0.3 + tips[1], abs=1e-10)
    assert [left, elbow, right, knee] == pytest.approx([1.8, -1.2, 1.2, 1.2], abs=0.2)
    mistake = refused("new", path, "--carrier", "cat", "--out", tmp_path / "other.yaml")
    assert "no moving joint 'cat'. Did you mean 'car'?" in mistake


@pytest.mark.parametrize(("setting", "freedoms"), [("base=fixed", 1), ("base=free", 7)])
def test_arguments_of_the_file_are_given_again_when_it_is_loaded(setting, freedoms, tmp_path):
    """A free base has six degrees of freedom more; the robot.yaml says that it was written for one."""
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_of([J("turn", "revolute", "base", "arm")]))
    name, value = setting.split("=")
    run = call("new", path, "--actuate", "turn", "--open", "--set", setting)
    assert f"n = {freedoms}, m = 1" in run.stdout
    assert f"# Written for --set {setting}: pass the same" in (tmp_path / "robot.yaml").read_text()
    assert rp.load_robot(tmp_path, **{name: value}).n == freedoms
    assert "has no argument 'bas'" in refused("new", path, "--set", "bas=free", "--out", tmp_path / "other.yaml")


TWO_CRANKS = (
    J("left", "revolute", "base", "left"),
    J("elbow_l", "revolute", "left", "upper_l", (0.3, 0, 0)),
    J("right", "revolute", "base", "right", (0.4, 0, 0)),
    J("elbow_r", "revolute", "right", "upper_r", (0.3, 0, 0)),
    J("end_l", "fixed", "upper_l", "tip_l", (0.4, 0, 0)),
    J("end_r", "fixed", "upper_r", "tip_r", (0.4, 0, 0)),
)


def test_motions_of_a_point_of_a_link(tmp_path):
    (tmp_path / "bar.urdf").write_text(urdf_of(TWO_CRANKS))
    decided = (
        "--close",
        "tip_l,tip_r",
        "--actuate",
        "left,right",
        "--guess",
        "left=2.2,elbow_l=-1.2,right=0.9,elbow_r=1.2",
    )
    for link, message in (("tip", "tip"), ("tip_l,x,q", "q"), ("tip_l,x,y,rz", "")):
        assert message in refused("new", tmp_path / "bar.urdf", *decided, "--platform", link)
        assert not (tmp_path / "robot.yaml").exists()
    both = refused("new", tmp_path / "bar.urdf", *decided, "--platform", "tip_l", "--independent", "left,right")
    assert "--platform and --independent are both given" in both
    assert call("new", tmp_path / "bar.urdf", *decided, "--platform", "tip_l").exit_code == 0
    robot = rp.load_robot(tmp_path)
    assert (robot.n, robot.platform.axes) == (2, ("x", "y"))
    circle, out = "circle:centre=0.2 0.45,radius=0.05,speed=0.2", tmp_path / "efforts.csv"
    run = call("inverse-dynamics", "--robot", tmp_path, "--motion", circle, "--out", out)
    assert run.exit_code == 0, run.stderr
    assert out.read_text().startswith("t [s],x [m],y [m],")


def test_a_platform_is_kept_while_questions_are_open(tmp_path):
    """Who answers them in the file gets the coordinates that were named, and a link that there is none of is told."""
    (tmp_path / "bar.urdf").write_text(urdf_of(TWO_CRANKS))
    given = "--actuate", "left,right", "--guess", "left=2.2,elbow_l=-1.2,right=0.9,elbow_r=1.2"
    assert "no link 'nosuch'" in refused("new", tmp_path / "bar.urdf", *given, "--platform", "nosuch")
    assert not (tmp_path / "robot.yaml").exists()
    asked = call("new", tmp_path / "bar.urdf", *given, "--platform", "tip_l", "--json")
    facts = json.loads(asked.stdout)
    assert (asked.exit_code, facts["independent"]) == (2, {"platform": "tip_l", "axes": ["x", "y"]})
    assert [one.partition("?")[0] for one in facts["undecided"]] == ["Where are loops cut"]
    declared = yaml.safe_load((tmp_path / "robot.yaml").read_text())
    del declared["undecided"]
    declared["closures"] = [{"ball": ["tip_l", "tip_r"]}]
    declared["reference"] = {"guess": {"left": 2.2, "elbow_l": -1.2, "right": 0.9, "elbow_r": 1.2}}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(declared))
    robot = rp.load_robot(tmp_path)
    assert robot.platform is not None
    assert (robot.platform.frame, robot.platform.axes) == ("tip_l", ("x", "y"))


def test_a_refused_platform_leaves_the_earlier_file_as_it_was(tmp_path):
    (tmp_path / "bar.urdf").write_text(urdf_of(TWO_CRANKS))
    assert call("new", tmp_path / "bar.urdf", "--actuate", "left,right").exit_code == 2
    before = (tmp_path / "robot.yaml").read_bytes()
    guess = "left=2.2,elbow_l=-1.2,right=0.9,elbow_r=1.2"
    decided = "--close", "tip_l,tip_r", "--actuate", "left,right", "--guess", guess
    refused("new", tmp_path / "bar.urdf", *decided, "--platform", "tip_l,x,y,rz")
    assert (tmp_path / "robot.yaml").read_bytes() == before
    facts = json.loads(call("new", tmp_path / "bar.urdf", *decided, "--json").stdout)
    assert facts["independent"] == list(rp.load_robot(tmp_path).independent_joints)


def test_a_tool_is_offered_as_the_other_end_of_the_only_one(tmp_path):
    named = {"tip_l": "tool", "tip_r": "right_end"}
    joints = [replace(each, child=named.get(each.child, each.child)) for each in TWO_CRANKS]
    (tmp_path / "bar.urdf").write_text(urdf_of(joints))
    asked = call("new", tmp_path / "bar.urdf", "--actuate", "left,right", "--platform", "tool")
    assert "which of the links right_end, tool close loops: --close right_end,tool (the only two)" in asked.stderr
