"""Models of Gazebo: trees and loops out of links in one frame, judged by what the file itself says of places."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from zoo import home_of

import redundancy_pin as rp
from redundancy_pin.errors import InputError, ModelFileError, RedundancyPinError
from redundancy_pin.robot.formats.sdf import read_sdf
from redundancy_pin.robot.loads import JointForces

INERTIAL = """<inertial><pose>{centre} 0.1 0.2 0.3</pose><mass>{mass}</mass>
<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz><ixy>0.001</ixy></inertia></inertial>"""


def link(name, pose, mass=1.0, centre="0.1 0.02 0.03", more=""):
    return f'<link name="{name}"><pose>{pose}</pose>{INERTIAL.format(mass=mass, centre=centre)}{more}</link>\n'


def joint(name, kind, parent, child, xyz="0 0 1", pose="", more="", axis2=""):
    axis = f"<axis><xyz>{xyz}</xyz>{more}</axis>" if xyz else ""
    return f"""<joint name="{name}" type="{kind}">{f"<pose>{pose}</pose>" if pose else ""}
<parent>{parent}</parent><child>{child}</child>{axis}{axis2}</joint>\n"""


def sdf(*parts, version="1.6", more=""):
    return f'<sdf version="{version}"><model name="machine">{more}{"".join(parts)}</model></sdf>'


LINKS = [
    link("base", "0 0 0.1 0 0 0"),
    link("crank", "0 0 0.1 0 0 0.9"),
    link("rod", f"{float(0.2 * np.cos(0.9))!r} {float(0.2 * np.sin(0.9))!r} 0.1 0 0 -0.2", 0.5),
    link("rocker", "0.6 0 0.1 0 0 0.3", 0.7),
]
LIMIT = "<limit><lower>-2</lower><upper>2</upper><effort>9</effort></limit><dynamics><damping>0.3</damping></dynamics>"
FOUR_BAR = [
    *LINKS,
    joint("crank", "revolute", "base", "crank", more=LIMIT),
    joint("elbow", "revolute", "crank", "rod"),
    joint("foot", "revolute", "base", "rocker"),
]


def in_rocker():
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    x, y = turn.T @ (np.array([0.2 * np.cos(0.9) + 0.5, 0.3]) - np.array([0.6, 0.0]))
    return f"{float(x)!r} {float(y)!r} 0 0 0 0"


PIN = joint("pin", "revolute", "rod", "rocker", pose=in_rocker())


def written(folder, text):
    path = folder / "machine.sdf"
    path.write_text(text)
    return path


def placed(robot, name, q):
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(q))
    return data.oMf[robot.model.getFrameId(name, pin.FrameType.BODY)].homogeneous


@pytest.mark.parametrize("kind", ["revolute", "ball"])
def test_a_link_of_two_parents_closes_a_loop(kind, tmp_path):
    text = sdf(*FOUR_BAR, PIN if kind == "revolute" else PIN.replace("revolute", "ball"))
    robot = rp.load_robot(written(tmp_path, text))
    assert (robot.n, robot.m, robot.actuated) == (1, 1, ("crank",))
    assert list(robot.model.names)[1:] == ["crank", "elbow", "foot"]
    np.testing.assert_array_equal(robot.gravity, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(robot.q_reference, 0.0, atol=1e-12)
    # at the reference every link is where the file has it
    np.testing.assert_allclose(
        placed(robot, "rod", robot.q_reference)[:2, 3], 0.2 * np.array([np.cos(0.9), np.sin(0.9)])
    )
    # along a motion the pin of the rod stays on that of the rocker: lengths of a four-bar, by hand
    x = np.linspace(0.0, 0.4, 9)[:, None]
    lifted = rp.inverse_kinematics(robot, rp.PlatformMotion(np.arange(9.0), x, np.ones_like(x), np.zeros_like(x)))
    for q in lifted.q:
        rod, rocker = placed(robot, "rod", q), placed(robot, "rocker", q)
        elbow = 0.2 * np.array([np.cos(0.9 + q[0]), np.sin(0.9 + q[0])])
        np.testing.assert_allclose(rod[:2, 3], elbow, atol=1e-12)
        start = np.linalg.inv(placed(robot, "rod", robot.q_reference))
        point = rod @ start @ np.array([0.2 * np.cos(0.9) + 0.5, 0.3, 0.1, 1.0])
        other = rocker @ np.linalg.inv(placed(robot, "rocker", robot.q_reference))
        np.testing.assert_allclose(point, other @ np.array([0.2 * np.cos(0.9) + 0.5, 0.3, 0.1, 1.0]), atol=1e-9)
    notes = " ".join(robot.notes)
    assert "In force: damping, friction and springs of crank" in notes
    assert robot.loads == (JointForces("crank", 0.3),)
    assert "'base', which nothing joins to the world, is held" in notes


def test_masses_and_limits(tmp_path):
    robot = rp.load_robot(written(tmp_path, sdf(*FOUR_BAR, PIN)))
    model = robot.model
    own = model.inertias[model.getJointId("elbow")]
    assert own.mass == 0.5
    # the joint's axes are those of the model
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, -0.2)
    np.testing.assert_allclose(own.lever, turn @ [0.1, 0.02, 0.03], atol=1e-12)
    about = turn @ pin.rpy.rpyToMatrix(0.1, 0.2, 0.3)
    tensor = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, 0.0], [0.0, 0.0, 0.04]])
    np.testing.assert_allclose(own.inertia, about @ tensor @ about.T, atol=1e-12)
    crank = model.joints[model.getJointId("crank")]
    assert (model.lowerPositionLimit[crank.idx_q], model.upperPositionLimit[crank.idx_q]) == (-2.0, 2.0)
    assert model.upperEffortLimit[crank.idx_v] == 9.0


def test_a_link_without_a_parent_is_carried_the_other_way_round(tmp_path):
    """The rod as the parent of crank and rocker alike: the same machine, the elbow counted from the other side."""
    turned = [*FOUR_BAR[:5], joint("elbow", "revolute", "rod", "crank", pose="0.2 0 0 0 0 0"), FOUR_BAR[6], PIN]
    one, other = (rp.load_robot(written(tmp_path, sdf(*parts))) for parts in ([*FOUR_BAR, PIN], turned))
    x = np.array([[0.1], [0.3]])
    motion = rp.PlatformMotion([0.0, 1.0], x, np.full_like(x, 0.7), np.full_like(x, -0.4))
    efforts = [rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau for robot in (one, other)]
    np.testing.assert_allclose(efforts[1], efforts[0], rtol=1e-10)
    q = [rp.inverse_kinematics(robot, motion).q[0] for robot in (one, other)]
    np.testing.assert_allclose(placed(other, "rod", q[1]), placed(one, "rod", q[0]), atol=1e-9)
    # child's motion relative to its parent is positive about the axis, whichever of the two carries the other
    columns = [robot.model.joints[robot.model.getJointId("elbow")].idx_q for robot in (one, other)]
    assert q[1][columns[1]] == pytest.approx(-q[0][columns[0]], abs=1e-9)


@pytest.mark.parametrize(
    ("version", "xyz", "more", "expected"),
    [
        ("1.6", "1 0 0", "", [np.cos(0.9), np.sin(0.9), 0.0]),
        ("1.6", "1 0 0", "<use_parent_model_frame>1</use_parent_model_frame>", [1.0, 0.0, 0.0]),
        ("1.7", "1 0 0", "", [np.cos(0.9), np.sin(0.9), 0.0]),
        ("1.8", '1 0 0" expressed_in="__model__', "", [1.0, 0.0, 0.0]),
    ],
)
def test_axes_of_every_version(version, xyz, more, expected, tmp_path):
    text = joint("crank", "revolute", "base", "crank", xyz="@", more=more)
    given = xyz.partition('"')
    attribute = f' {given[2].strip()}"' if given[2] else ""
    text = text.replace("<xyz>@</xyz>", f"<xyz{attribute}>{given[0]}</xyz>")
    path = written(tmp_path, sdf(LINKS[0], LINKS[1], text, version=version))
    model = read_sdf(path).model
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(1))
    np.testing.assert_allclose(np.ravel(data.J)[3:], expected, atol=1e-12)


@pytest.mark.parametrize(("version", "taken"), [("1.5", True), ("1.6", True), ("1.7", False), ("1.10", False)])
def test_the_frame_of_the_model_is_asked_for_up_to_version_1_6(version, taken, tmp_path):
    more = "<use_parent_model_frame>true</use_parent_model_frame>"
    path = written(tmp_path, sdf(LINKS[0], LINKS[1], joint("crank", "revolute", "base", "crank", more=more)))
    path.write_text(path.read_text().replace('version="1.6"', f'version="{version}"'))
    if taken:
        assert read_sdf(path).model.nv == 1
    else:
        with pytest.raises(ModelFileError, match=r"use_parent_model_frame is no part of SDF 1\.7"):
            read_sdf(path)


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous"])
@pytest.mark.parametrize(
    ("text", "end", "most"),
    [
        ("1.5", 1.5, 1.5),
        ("-1.5", -1.5, np.inf),  # a speed or effort below zero is none
        ("0", 0.0, 0.0),
        ("9.9e14", 9.9e14, 9.9e14),
        ("-9.9e14", -9.9e14, np.inf),
        ("1e15", None, np.inf),
        ("-1e15", None, np.inf),
        ("inf", None, np.inf),
        ("-Infinity", None, np.inf),
    ],
)
def test_limits_hold_up_to_1e15(kind, text, end, most, tmp_path):
    """Each by itself; what is beyond is none, and a joint that turns for ever ends nowhere."""
    none = {"lower": -np.inf, "upper": np.inf, "effort": np.inf, "velocity": np.inf}
    for key in none:
        more = f"<limit><{key}>{text}</{key}></limit>"
        path = written(tmp_path, sdf(LINKS[0], LINKS[1], joint("crank", kind, "base", "crank", more=more)))
        model = read_sdf(path).model
        limits = model.lowerPositionLimit, model.upperPositionLimit, model.upperEffortLimit, model.upperVelocityLimit
        found = dict(zip(none, (float(limit[0]) for limit in limits), strict=True))
        is_end = key in ("lower", "upper")
        without = kind == "continuous" or end is None
        expected = (none[key] if without else end) if is_end else most
        assert found == none | {key: expected}


def test_poses_relative_to_others(tmp_path):
    """The crank in the frame of the base, the joint in that of the model."""
    crank = LINKS[1].replace("<pose>0 0 0.1 0 0 0.9</pose>", '<pose relative_to="base">1 0 0 0 0 0.5</pose>')
    text = joint("crank", "revolute", "base", "crank", pose="0 0 5 0 0 0").replace(
        "<pose>", '<pose relative_to="__model__">'
    )
    base = LINKS[0].replace("0 0 0.1 0 0 0", "0 2 0 0 0 1.5707963267948966")
    model = read_sdf(written(tmp_path, sdf(base, crank, text, version="1.9"))).model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(1))
    np.testing.assert_allclose(data.oMi[1].translation, [0.0, 0.0, 5.0], atol=1e-12)
    place = data.oMf[model.getFrameId("crank", pin.FrameType.BODY)]
    np.testing.assert_allclose(place.translation, [0.0, 3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(place.rotation, pin.rpy.rpyToMatrix(0.0, 0.0, 0.5 + np.pi / 2), atol=1e-12)


def test_universal_joints_in_tree_and_loop(tmp_path):
    """A shaft with two universal joints: the speed ratio of a single one is Hooke's formula."""
    bend = 0.4
    out = link("out", f"0.2 0 0.1 0 0 {bend}")
    shaft_in = joint("in", "revolute", "base", "crank", xyz="1 0 0")
    shaft_out = joint("exit", "revolute", "base", "out", xyz="1 0 0")
    # the first arm of the cross along z in the input, the second one along y of the output
    axis2 = "<axis2><xyz>0 1 0</xyz></axis2>"
    hooke = joint("cross", "universal", "crank", "out", xyz="0 0 1", axis2=axis2)
    crank = link("crank", "0 0 0.1 0 0 0")
    robot = rp.load_robot(written(tmp_path, sdf(LINKS[0], crank, out, shaft_in, shaft_out, hooke)), actuated="in")
    assert robot.n == 1
    x = np.array([[0.0], [0.3], [0.8], [1.2]])
    lifted = rp.inverse_kinematics(robot, rp.PlatformMotion(np.arange(4.0), x, np.ones_like(x), np.zeros_like(x)))
    column = robot.model.joints[robot.model.getJointId("exit")].idx_v
    # at zero the arm of the input is normal to the plane of both shafts
    ratio = np.cos(bend) / (1.0 - np.sin(bend) ** 2 * np.sin(x[:, 0]) ** 2)
    np.testing.assert_allclose(np.abs(lifted.v[:, column]), ratio, atol=1e-9)


def test_springs_and_dampers(tmp_path):
    law = "<dynamics><damping>0.3</damping><friction>0.2</friction><spring_stiffness>5</spring_stiffness>"
    law += "<spring_reference>0.1</spring_reference></dynamics>"
    parts = [*FOUR_BAR[:5], joint("elbow", "revolute", "crank", "rod", more=law), FOUR_BAR[6], PIN]
    cut = joint("pin", "revolute", "rod", "rocker", pose=in_rocker(), more=law)
    robot = rp.load_robot(written(tmp_path, sdf(*parts)))
    assert robot.loads == (JointForces("crank", 0.3), JointForces("elbow", 0.3, 0.2, stiffness=5.0, rest=0.1))
    other = rp.load_robot(written(tmp_path, sdf(*parts[:-1], cut)))
    assert other.loads == robot.loads
    assert any("Not in force" in note and "dynamics of pin" in note for note in other.notes)


def test_base_and_driven_joints(tmp_path):
    path = written(tmp_path, sdf(*FOUR_BAR, PIN, more="<pose>0 0 1 0 0 0</pose>"))
    assert rp.load_robot(path, actuated="foot").actuated == ("foot",)
    free = rp.load_robot(path, base="free", actuated="crank")
    assert (free.n, free.m) == (7, 1)
    np.testing.assert_allclose(placed(free, "base", free.q_reference)[:3, 3], [0.0, 0.0, 1.1], atol=1e-12)
    with pytest.raises(ModelFileError, match=r"actuated names 'krank'.*mean 'crank'"):
        rp.load_robot(path, actuated="krank")
    with pytest.raises(InputError, match="no argument 'keyframe'"):
        rp.load_robot(path, keyframe="home")
    still = LIMIT.replace("-2", "0").replace(">2<", ">0<")
    lid = [link("lid", "0 0 0.2 0 0 0"), joint("latch", "revolute", "rocker", "lid", more=still)]
    fixed = rp.load_robot(written(tmp_path, sdf(*FOUR_BAR, *lid, PIN)))
    assert "latch" not in fixed.model.names
    assert any("'latch' has the limits 0 and 0" in note for note in fixed.notes)


GEARBOX = """<joint name="gears" type="gearbox"><parent>{parent}</parent><child>{child}</child>
<gearbox_reference_body>base</gearbox_reference_body><gearbox_ratio>0.04</gearbox_ratio>
<axis><xyz>0 0 {one}</xyz></axis><axis2><xyz>0 0 {two}</xyz></axis2></joint>"""


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("one", "two"), [(1, 1), (1, -1)])
def test_a_gearbox_couples_angles_from_its_reference_body(one, two, turned, tmp_path):
    """θ₂ = −ratio θ₁ by the places of the links: the file's own words, whichever way round its joints are written."""
    rotor = [
        link("rotor", "0 0.3 0 0 0 0.4", 0.1),
        joint("spin", "revolute", *(["base", "rotor"][:: -1 if turned else 1])),
    ]
    gears = GEARBOX.format(parent="rotor", child="crank", one=one, two=two)
    robot = rp.load_robot(written(tmp_path, sdf(*FOUR_BAR, *rotor, PIN, gears)), actuated="crank")
    assert (robot.n, len(robot.couplings)) == (1, 1)
    model = robot.model
    spin = model.joints[model.getJointId("spin")]
    x = home_of(robot) + np.array([[0.0], [0.01]])
    q = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0, 1.0], x, 0 * x, 0 * x)).q
    turns = [[np.arctan2(*(placed(robot, name, each)[[1, 0], 0])) for each in q] for name in ("base", "rotor", "crank")]
    base, first, second = np.diff(turns)[:, 0]
    first, second = (np.angle(np.exp(1j * (angle - base))) for angle in (first, second))
    assert abs(q[1, spin.idx_q] - q[0, spin.idx_q]) == pytest.approx(0.25)
    assert two * second == pytest.approx(-0.04 * one * first)
    with pytest.raises(ModelFileError, match="needs a hinge of the tree about its axis from 'base' to 'rod'"):
        rp.load_robot(written(tmp_path, sdf(*FOUR_BAR, *rotor, PIN, gears.replace(">crank<", ">rod<"))))


REFUSED = {
    "version": ('version="1.6"', 'version="1.4"', "version '1.4'"),
    "screw": ('"elbow" type="revolute"', '"elbow" type="screw"', "type 'screw', which is not covered"),
    "unknown": ("<parent>base</parent>", "<parents>base</parents>", "has <parents>, which is not covered"),
    "no link": ("<child>rod</child>", "<child>rot</child>", "child 'rot', which is no link"),
    "no inertial": ("<inertial>", "<inertia/><inertial>", "has <inertia>"),
    "gravity": ('<link name="crank">', '<link name="crank"><gravity>0</gravity>', "has no gravity"),
    "nested": ("</model>", '<model name="inner"/></model>', "has <model>, which is not covered"),
    "include": ("</model>", "<include/></model>", "has <include>, which is not covered"),
    "number": ("<mass>0.5</mass>", "<mass>half</mass>", "'half' is not 1 finite"),
    "moments": ("<ixx>0.02</ixx>", "<ixx>-0.02</ixx>", "the moments"),
    "axis": ("<xyz>0 0 1</xyz>", "<xyz>0 0 0</xyz>", "axis of length zero"),
    "circle": ("<pose>0 0 0.1 0 0 0.9</pose>", '<pose relative_to="crank">0 0 0.1 0 0 0.9</pose>', "back to itself"),
    "twice": ('name="rocker"', 'name="rod"', "the name 'rod', which is taken"),
    "degrees": ("<pose>0 0 0.1 0 0 0.9</pose>", '<pose degrees="true">0 0 0.1 0 0 50</pose>', "another form"),
    "static": ("<link", "<static>1</static><link", "is static"),
    "placed": ('name="machine"', 'name="machine" placement_frame="rod"', "placement_frame"),
    "posed": ("<link", '<pose relative_to="crank">1 0 0 1 0 0</pose><link', "a pose relative to a frame"),
    "flag": ('<link name="crank">', '<link name="crank"><gravity>no</gravity>', "<gravity> is 'no'"),
    "limits": ("<lower>-2<", "<lower>3<", "the limits 3 and 2, the lower above the upper"),
    "loose": ("</model>", link("loose", "0 0 0 0 0 0") + "</model>", "'loose' is joined to nothing"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_covered_is_refused_by_name(case, tmp_path):
    old, new, message = REFUSED[case]
    text = sdf(*FOUR_BAR, PIN)
    assert old in text
    with pytest.raises(RedundancyPinError, match=r"machine\.sdf, line \d+: .*" + message):
        rp.load_robot(written(tmp_path, text.replace(old, new, 1)))


def test_an_initial_position_is_named(tmp_path):
    text = sdf(*FOUR_BAR, PIN).replace("</axis>", "<initial_position>0.4</initial_position></axis>", 1)
    assert "initial position of 'crank' is not read" in str(rp.load_robot(written(tmp_path, text)).notes)


def _cassie():
    spec = find_spec("cmeel")
    place = Path(next(iter(spec.submodule_search_locations))).parent / "cmeel.prefix" if spec else Path()
    return place / "share/example-robot-data/robots/cassie_description/robots"


@pytest.mark.long_for("_reduced-11", "_simple-11", "_v2-12")
@pytest.mark.skipif(not _cassie().is_dir(), reason="example-robot-data is not installed")
@pytest.mark.parametrize(
    ("name", "freedoms"),
    [
        *(("_reduced", 11), ("_simple", 11), ("_v2", 12), ("_wo_gearbox_spring", 13)),
        pytest.param("", 11, marks=pytest.mark.long),  # the spring of a shin is a slide, which locks the knee's spring
    ],
)
def test_cassie_loads_and_moves(name, freedoms):
    """Freedoms by hand: three of a hip, knee and shin or spring with the rod, a foot unless tilted axes lock it."""
    robot = rp.load_robot(_cassie() / f"cassie{name}.sdf")
    assert (robot.n, robot.m) == (freedoms, freedoms)
    assert sum(body.mass for body in robot.model.inertias) == pytest.approx(
        sum(float(mass.text) for mass in ElementTree.parse(_cassie() / f"cassie{name}.sdf").iter("mass"))
    )
    x = home_of(robot) + 0.03 * np.sin(np.arange(robot.n))
    motion = rp.PlatformMotion([0.0], x[None], 0.1 * np.ones((1, robot.n)), np.zeros((1, robot.n)))
    assert np.isfinite(rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau).all()


def test_a_model_that_drives_nothing_is_told_how_to_say_it(tmp_path: Path) -> None:
    """An SDF has no actuators to add: joints are named. One with a spring is not taken to be driven unasked."""
    spring = "<dynamics><spring_stiffness>5</spring_stiffness><spring_reference>0</spring_reference></dynamics>"
    arm = joint("hinge", "revolute", "base", "arm", more=spring)
    path = written(tmp_path, sdf(link("base", "0 0 0 0 0 0"), link("arm", "0 0 0 0 0 0"), arm))
    with pytest.raises(RedundancyPinError, match='actuated="a,b"') as caught:
        rp.load_robot(path)
    assert "actuators" not in str(caught.value)
    assert rp.load_robot(path, actuated="hinge").actuated == ("hinge",)


@pytest.mark.parametrize(("aside", "right"), [(0.0, True), (0.5e-6, True), (2e-6, False), (0.3, False), (1.0, False)])
def test_arms_of_a_cross_that_closes_a_loop_are_at_right_angles(aside, right, tmp_path):
    """But for a millionth, which files round; along one another they are none."""
    arms = f"<axis2><xyz>0 {float(np.sqrt(1.0 - aside**2))!r} {aside!r}</xyz></axis2>"
    parts = [
        LINKS[0],
        link("crank", "0 0 0.1 0 0 0"),
        link("out", "0.2 0 0.1 0 0 0.4"),
        joint("in", "revolute", "base", "crank", xyz="1 0 0"),
        joint("exit", "revolute", "base", "out", xyz="1 0 0"),
        joint("cross", "universal", "crank", "out", xyz="0 0 1", axis2=arms),
    ]
    path = written(tmp_path, sdf(*parts))
    if right:
        (closure,) = read_sdf(path).loop_joints
        assert closure.name == "cross"
    else:
        with pytest.raises(ModelFileError, match="'cross' has axes that are not at right angles"):
            read_sdf(path)


@pytest.mark.parametrize(("count", "taken"), [(100, True), (101, False)])
def test_poses_follow_one_another_a_hundred_times(count, taken, tmp_path):
    """The last is that of a joint, in the last of the links."""
    parts = [link("link_0", "0 0 0.01 0 0 0")]
    for i in range(1, count):
        place = f'<pose relative_to="link_{i - 1}">0 0 0.01 0 0 0</pose>'
        parts.append(link(f"link_{i}", "0 0 0 0 0 0").replace("<pose>0 0 0 0 0 0</pose>", place))
        parts.append(joint(f"joint_{i}", "fixed" if i > 1 else "revolute", f"link_{i - 1}", f"link_{i}"))
    path = written(tmp_path, sdf(*parts, version="1.9"))
    if taken:
        model = read_sdf(path).model
        data = model.createData()
        pin.framesForwardKinematics(model, data, np.zeros(1))
        last = data.oMf[model.getFrameId(f"link_{count - 1}", pin.FrameType.BODY)].translation
        np.testing.assert_allclose(last, [0.0, 0.0, 0.01 * count], atol=1e-12)
    else:
        with pytest.raises(ModelFileError, match="a pose is relative to"):
            read_sdf(path)


def test_joints_along_an_axis_are_pinocchios_own(tmp_path):
    """Which compute faster; along no axis, or against one, they are those of any direction."""
    parts = [link("base", "0 0 0 0 0 0")]
    wanted = {
        "1 0 0": ("RX", "PX"),
        "0 2 0": ("RY", "PY"),
        "0 0 1": ("RZ", "PZ"),
        "0 0 -1": ("RevoluteUnaligned", "PrismaticUnaligned"),
        "1 1 0": ("RevoluteUnaligned", "PrismaticUnaligned"),
    }
    names = []
    for xyz, kinds in wanted.items():
        for kind, name in zip(("revolute", "prismatic"), kinds, strict=True):
            child = f"body_{len(names)}"
            parts += [link(child, "0 0 0 0 0 0"), joint(f"to_{child}", kind, "base", child, xyz=xyz)]
            names.append(f"JointModel{name}")
    model = read_sdf(written(tmp_path, sdf(*parts))).model
    assert [str(each.shortname()) for each in list(model.joints)[1:]] == names
