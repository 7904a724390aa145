"""Models of Gazebo: places by the specification's own words, torques by Pinocchio's tree with the loop as KKT rows."""

from __future__ import annotations

import os
import time
import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from test_urdf_dialects import FILES as URDFS
from test_urdf_dialects import GRAVITY, MOTION, torque, torque_by_kkt
from zoo import home_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, ModelFileError, RedundancyPinError
from redundancy_pin.robot.formats.sdf import read_sdf
from redundancy_pin.robot.loads import JointForces

FILES = Path(__file__).parent / "files" / "sdf"
BAD = sorted(path.stem for path in (FILES / "bad").glob("*.sdf"))
INERTIAL = """<inertial><pose>{centre} 0.1 0.2 0.3</pose><mass>{mass}</mass>
<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz><ixy>0.001</ixy></inertia></inertial>"""


def link(name: str, pose: str, mass: float = 1.0, centre: str = "0.1 0.02 0.03") -> str:
    return f'<link name="{name}"><pose>{pose}</pose>{INERTIAL.format(mass=mass, centre=centre)}</link>\n'


def joint(name: str, kind: str, parent: str, child: str, more: str = "", xyz: str = "0 0 1") -> str:
    axis = more if "<axis>" in more else f"<axis><xyz>{xyz}</xyz>{more}</axis>"
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{axis}</joint>\n'


def written(folder: Path, *parts: str, version: str = "1.9", more: str = "") -> Path:
    path = folder / "machine.sdf"
    path.write_text(f'<sdf version="{version}"><model name="machine"{more}>{"".join(parts)}</model></sdf>')
    return path


def placed(model: pin.Model, name: str, q: Array) -> Array:
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous


def efforts(robot: rp.Robot, x: float, xd: float, xdd: float) -> Array:
    motion = rp.PlatformMotion([0.0], [[x]], [[xd]], [[xdd]])
    return rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau[0]


# --- what each file means ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["plain", "frames", "nested", "world"])
def test_torques_are_those_of_the_closed_loop(name: str) -> None:
    """One four-bar, written in four ways; the file of its parts and that of its rocker are included by the world."""
    robot = rp.load_robot(FILES / "good" / f"{name}.sdf", gravity=None if name == "world" else GRAVITY)
    assert (robot.n, robot.actuated) == (1, ("motor",))
    np.testing.assert_array_equal(robot.gravity, GRAVITY)
    text = (URDFS / "good" / "gazebo.urdf").read_text()
    model = pin.buildModelFromXML(text)
    bar, arm = (placed(model, each, pin.neutral(model)) for each in ("bar", "arm"))
    points = {"bar": (np.linalg.inv(bar) @ arm @ [0.2, 0.0, 0.0, 1.0])[:3], "arm": np.array([0.2, 0.0, 0.0])}
    foot, knee = 0.1757, -0.3446  # near the pose where the motor has turned by 0.3
    near = np.array([np.cos(foot), np.sin(foot), MOTION[0], np.cos(knee), np.sin(knee)])
    assert torque(robot) == pytest.approx(torque_by_kkt(text, points, near), rel=1e-9)
    if name == "world":
        assert any("model://ground_plane, which comes with Gazebo" in note for note in robot.notes)


def test_objects_beside_the_machine_are_passed_over(tmp_path: Path) -> None:
    """A world has its own gravity, 9.8 m/s² where it says none."""
    path = written(tmp_path, link("base", "0 0 0 0 0 0"), link("arm", "0 0 0 0 0 0"), joint("j", "ball", "base", "arm"))
    boxes = "".join(f'<model name="{name}"><link name="l"/></model>' for name in ("box", "can"))
    text = path.read_text().replace("<model", f'<world name="w">{boxes}<model', 1)
    path.write_text(text.replace("</sdf>", "</world></sdf>"))
    mechanism = read_sdf(path)
    assert [str(name) for name in mechanism.model.names] == ["universe", "j"]
    assert "Passed over: the models without joints, box, can." in mechanism.notes
    np.testing.assert_array_equal(mechanism.model.gravity.linear, [0.0, 0.0, -9.8])


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_cannot_be_meant_is_refused_by_name(name: str) -> None:
    """The first line of each says what its error must contain."""
    path = FILES / "bad" / f"{name}.sdf"
    message = path.read_text().partition("\n")[0].removeprefix("<!-- ").removesuffix(" -->")
    with pytest.raises(RedundancyPinError) as refusal:
        rp.load_robot(path)
    assert message in str(refusal.value)
    assert f"{name}.sdf" in str(refusal.value)
    assert "line " in str(refusal.value)


def turned(roll: float, pitch: float, yaw: float) -> Array:
    """Return R_z R_y R_x (3, 3), by its nine entries."""
    (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array([[c * b, c * e * d - f * a, c * e * a + f * d],
                     [f * b, f * e * d + c * a, f * e * a - c * d],
                     [-e, b * d, b * a]])  # fmt: skip


def pose_text(place: Array, spelling: int, relative_to: str) -> str:
    """Return the <pose> of a placement (4, 4): in radians, in degrees, or as a quaternion of another length."""
    turn = place[:3, :3]
    angles = np.array([np.arctan2(turn[2, 1], turn[2, 2]), np.arcsin(-turn[2, 0]), np.arctan2(turn[1, 0], turn[0, 0])])
    words = [angles, np.degrees(angles), 3.0 * pin.Quaternion(turn).coeffs()][spelling]
    form = ("", ' degrees="true"', ' rotation_format="quat_xyzw"')[spelling]
    within = f' relative_to="{relative_to}"' if relative_to else ""
    return f"<pose{within}{form}>{' '.join(repr(float(word)) for word in (*place[:3, 3], *words))}</pose>"


@pytest.mark.parametrize("seed", range(10))
def test_frames_are_where_the_specification_puts_them(seed: int, tmp_path: Path) -> None:
    """Places in the model are chosen first; each pose is written in whatever frame comes before it in the list.

    So nothing composes poses as the reader does. Every link turns about an axis of some frame, and what is attached to
    it turns with it.
    """
    rng = np.random.default_rng(seed)
    places: dict[str, Array] = {"": np.eye(4)}  # by full name; "a" and "a::b" are the models in the model
    carriers: dict[str, str] = {}
    text, joints = dict.fromkeys(("", "a::", "a::b::"), ""), ""
    models: dict[str, tuple[str, str]] = {}
    axes: dict[str, Array] = {}
    for stage, scope in enumerate(("", "a::", "a::b::", "a::", "")):
        items = [f"{kind}{stage}{number}" for kind in ("link", "frame") for number in range(2)]
        items += ["ab"[stage]] if stage < 2 else []
        for own in rng.permutation(items):
            full = scope + str(own)
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = turned(*rng.uniform(-3.0, 3.0, 3)), rng.uniform(-1.0, 1.0, 3)
            near = [name.removeprefix(scope) for name in places if name.startswith(scope) and name != ""]
            near = [name for name in near if not f"{scope}{name}::".startswith(f"{full}::")]
            attached_to = str(rng.choice(near)) if near and str(own).startswith("frame") else ""
            relative_to = str(rng.choice(near)) if near and rng.random() < 0.7 else ""
            base = f"{scope}{relative_to or attached_to}" if relative_to or attached_to else scope.removesuffix("::")
            places[full] = place
            if len(own) == 1:
                models[full] = base, relative_to
                continue
            tag, more = str(own)[:-2], f' attached_to="{attached_to}"' if attached_to else ""
            carriers[full] = full if tag == "link" else f"{scope}{attached_to}" if attached_to else scope[:-2]
            pose = pose_text(np.linalg.inv(places[base]) @ place, int(rng.integers(3)), relative_to)
            inertial = INERTIAL.format(mass=1.0, centre="0 0 0") if tag == "link" else ""
            text[scope] += f'<{tag} name="{own}"{more}>{pose}{inertial}</{tag}>'
    for full, (base, relative_to) in reversed(models.items()):
        marked = str(rng.choice([name for name in carriers if name.startswith(f"{full}::")]))
        pose = pose_text(np.linalg.inv(places[base]) @ places[marked], int(rng.integers(3)), relative_to)
        named = f'name="{full[-1]}" placement_frame="{marked.removeprefix(full + "::")}"'
        text[full[:-1]] += f"<model {named}>{pose}{text[full + '::']}</model>"
    links = [name for name, carrier in carriers.items() if name == carrier]
    for scope in ("a::b", "a", ""):  # what is attached to a model moves with its first link
        inside = [name for name in links if name.rpartition("::")[0] == scope]
        carriers[scope] = min(inside, key=lambda name: text[f"{scope}::" if scope else ""].index(f'"{name[-6:]}"'))
    for name in links:
        axis = str(rng.choice(list(places)[1:]))
        axes[name] = places[axis][:3, 0]
        joints += joint(f"to_{name.replace('::', '_')}", "revolute", "world", name, xyz="X").replace(
            "<xyz>X", f'<xyz expressed_in="{axis}">2 0 0'
        )
    model = read_sdf(written(tmp_path, text[""], joints)).model
    q = rng.uniform(-1.0, 1.0, model.nq)
    for full, place in list(places.items())[1:]:
        if full in models:
            continue
        carrier = full
        while carriers[carrier] != carrier:
            carrier = carriers[carrier]
        angle = q[model.joints[model.getJointId(f"to_{carrier.replace('::', '_')}")].idx_q]
        expected, point = np.array(place), places[carrier][:3, 3]
        turn = np.array(pin.exp3(angle * axes[carrier]))
        expected[:3, :3], expected[:3, 3] = turn @ place[:3, :3], point + turn @ (place[:3, 3] - point)
        np.testing.assert_allclose(placed(model, full, q), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("version", "given", "expected"),
    [
        ("1.4", "<xyz>1 0 0</xyz>", [1.0, 0.0, 0.0]),
        ("1.5", "<xyz>1 0 0</xyz>", [np.cos(0.9), np.sin(0.9), 0.0]),
        ("1.6", "<xyz>1 0 0</xyz>", [np.cos(0.9), np.sin(0.9), 0.0]),
        ("1.6", "<xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame>", [1.0, 0.0, 0.0]),
        ("1.7", "<xyz>1 0 0</xyz>", [np.cos(0.9), np.sin(0.9), 0.0]),
        ("1.8", '<xyz expressed_in="__model__">3 0 0</xyz>', [1.0, 0.0, 0.0]),
        ("1.8", "", [0.0, 0.0, 1.0]),
    ],
)
def test_axes_of_every_version(version: str, given: str, expected: list[float], tmp_path: Path) -> None:
    text = joint("turn", "revolute", "base", "crank", more=f"<axis>{given}</axis>")
    parts = link("base", "0 0 0.1 0 0 0"), link("crank", "0 0 0.1 0 0 0.9")
    model = read_sdf(written(tmp_path, *parts, text, version=version)).model
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(1))
    np.testing.assert_allclose(np.ravel(data.J)[3:], expected, atol=1e-12)


def test_the_model_of_an_axis_is_the_one_that_it_is_in(tmp_path: Path) -> None:
    axis = "<axis><xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame></axis>"
    parts = link("base", "0 0 0 0 0 0.4"), link("crank", "0 0 0 0 0 0.9"), joint("j", "revolute", "base", "crank", axis)
    inner = f'<model name="inner"><pose>0 0 0 0 0 1.2</pose>{"".join(parts)}</model>'
    model = read_sdf(written(tmp_path, inner, version="1.6")).model
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(1))
    np.testing.assert_allclose(np.ravel(data.J)[3:], [np.cos(1.2), np.sin(1.2), 0.0], atol=1e-12)


# --- loops ------------------------------------------------------------------------------------------------------------

LINKS = [
    link("base", "0 0 0.1 0 0 0"),
    link("crank", "0 0 0.1 0 0 0.9"),
    link("rod", f"{float(0.2 * np.cos(0.9))!r} {float(0.2 * np.sin(0.9))!r} 0.1 0 0 -0.2", 0.5),
    link("rocker", "0.6 0 0.1 0 0 0.3", 0.7),
]
LIMIT = "<limit><lower>-2</lower><upper>2</upper><effort>9</effort></limit><dynamics><damping>0.3</damping></dynamics>"
SPRING = "<dynamics><damping>0.3</damping><friction>0.2</friction><spring_stiffness>5</spring_stiffness>"
SPRING += "<spring_reference>0.1</spring_reference></dynamics>"
TREE = [
    joint("drive", "revolute", "base", "crank", LIMIT),
    joint("elbow", "revolute", "crank", "rod"),
    joint("foot", "revolute", "base", "rocker"),
]


def pin_joint(kind: str = "revolute", more: str = "") -> str:
    """Return the joint that closes the four-bar, placed in the rocker."""
    x, y = turned(0.0, 0.0, -0.3)[:2, :2] @ [0.2 * np.cos(0.9) + 0.5 - 0.6, 0.3]
    pose = f"<pose>{float(x)!r} {float(y)!r} 0 0 0 0</pose>"
    return joint("pin", kind, "rod", "rocker", more).replace("<parent>", f"{pose}<parent>")


FOUR_BAR = [*LINKS, *TREE, pin_joint()]


@pytest.mark.parametrize("kind", ["revolute", "ball"])
def test_a_link_of_two_parents_closes_a_loop(kind: str, tmp_path: Path) -> None:
    robot = rp.load_robot(written(tmp_path, *LINKS, *TREE, pin_joint(kind)))
    assert (robot.n, robot.m, robot.actuated) == (1, 1, ("drive",))
    assert list(robot.model.names)[1:] == ["drive", "elbow", "foot"]
    np.testing.assert_array_equal(robot.gravity, [0.0, 0.0, -9.81])
    x = np.linspace(0.0, 0.4, 5)[:, None]
    motion = rp.PlatformMotion(np.arange(5.0), x, np.ones_like(x), np.zeros_like(x))
    start = [np.linalg.inv(placed(robot.model, name, robot.q_reference)) for name in ("rod", "rocker")]
    for q in rp.inverse_kinematics(robot, motion).q:  # lengths of a four-bar, by hand
        rod, rocker = placed(robot.model, "rod", q), placed(robot.model, "rocker", q)
        np.testing.assert_allclose(rod[:2, 3], 0.2 * np.array([np.cos(0.9 + q[0]), np.sin(0.9 + q[0])]), atol=1e-12)
        at = np.array([0.2 * np.cos(0.9) + 0.5, 0.3, 0.1, 1.0])
        np.testing.assert_allclose(rod @ start[0] @ at, rocker @ start[1] @ at, atol=1e-9)
    assert robot.loads == (JointForces("drive", 0.3),)
    assert "'base', which nothing joins to the world, is held" in " ".join(robot.notes)


def test_a_link_without_a_parent_is_carried_the_other_way_round(tmp_path: Path) -> None:
    """The rod as the parent of crank and rocker alike: the same machine, the elbow counted from the other side."""
    elbow = joint("elbow", "revolute", "rod", "crank").replace("<parent>", "<pose>0.2 0 0 0 0 0</pose><parent>")
    one, other = (
        rp.load_robot(written(tmp_path, *parts)) for parts in (FOUR_BAR, [*LINKS, TREE[0], elbow, TREE[2], pin_joint()])
    )
    np.testing.assert_allclose(efforts(other, 0.3, 0.7, -0.4), efforts(one, 0.3, 0.7, -0.4), rtol=1e-10)
    q = [
        rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.3]], [[0.0]], [[0.0]])).q[0] for robot in (one, other)
    ]
    np.testing.assert_allclose(placed(other.model, "rod", q[1]), placed(one.model, "rod", q[0]), atol=1e-9)
    assert q[1][1] == pytest.approx(-q[0][1], abs=1e-9)  # about the axis, whichever of the two carries the other


def test_forces_of_a_joint_that_closes_the_loop_do_their_work(tmp_path: Path) -> None:
    """Power by power: spring, damper and friction of a pin at the torque of the crank, at the pin's own speed."""
    plain = rp.load_robot(written(tmp_path, *FOUR_BAR))
    robot = rp.load_robot(written(tmp_path, *LINKS, *TREE, pin_joint(more=SPRING)))
    assert robot.loads == (JointForces("drive", 0.3), JointForces("pin", 0.3, 0.2, stiffness=5.0, rest=0.1))
    lifted = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.3]], [[0.7]], [[-0.4]]))
    at = robot.model.joints[robot.model.getJointId("pin")]
    angle, speed = float(lifted.q[0, at.idx_q]), float(lifted.v[0, at.idx_v])
    power = (5.0 * (angle - 0.1) + 0.3 * speed + 0.2 * np.sign(speed)) * speed
    more = efforts(robot, 0.3, 0.7, -0.4) - efforts(plain, 0.3, 0.7, -0.4)
    assert more[0] * 0.7 == pytest.approx(power, rel=1e-9)
    ranged = rp.load_robot(written(tmp_path, *LINKS, *TREE, pin_joint(more="<limit><lower>-1</lower></limit>")))
    assert "The limits of pin, which closes a loop, are left out." in ranged.notes


def test_a_joint_that_is_driven_closes_the_loop_too(tmp_path: Path) -> None:
    """Power by power: the torque at the pin does the work of that at the crank; its own angle is the motion."""
    path = written(tmp_path, *FOUR_BAR)
    crank, pinned = rp.load_robot(path, actuated="drive"), rp.load_robot(path, actuated="pin")
    assert pinned.actuated == ("pin",)
    given = rp.PlatformMotion([0.0], [[home_of(pinned)[0] + 0.1]], [[0.7]], [[-0.4]])
    lifted = rp.inverse_kinematics(pinned, given)
    at = {name: pinned.model.joints[pinned.model.getJointId(name)].idx_v for name in ("drive", "pin")}
    x, xd, xdd = (float(values[0, at["drive"]]) for values in (lifted.q, lifted.v, lifted.a))
    other = efforts(
        pinned, *(float(values[0, at[pinned.independent_joints[0]]]) for values in (lifted.q, lifted.v, lifted.a))
    )
    speed = float(lifted.v[0, at["pin"]])
    assert other[0] * speed == pytest.approx(efforts(crank, x, xd, xdd)[0] * xd, rel=1e-9)


@pytest.mark.parametrize("wrong", [0.0, 1e-5])
@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw", "universal"])
def test_two_equal_joints_do_as_one(kind: str, swapped: bool, wrong: float, tmp_path: Path) -> None:
    """A door on two hinges, a carriage on two rails, in tilted frames: no row is independent, all are rounding."""
    ends, axes = ("door", "frame") if swapped else ("frame", "door"), "<axis><xyz>0.6 0.8 0</xyz></axis>"
    more = "<screw_thread_pitch>0.5</screw_thread_pitch>" if kind == "screw" else ""
    if kind == "universal":
        axes += "<axis2><xyz>0 0 1</xyz></axis2>"
        ends = "frame", "door"  # its axes belong to its ends
    parts = [
        "<pose>0.1 0.2 0.3 0.4 0.5 0.6</pose>",
        link("frame", "0 0 0 0.3 0.1 0"),
        link("door", "0.4 0 0.3 0.3 0.1 0"),
        joint("one", kind, "frame", "door", f"{axes}<pose>-0.4 0.1 0 0.2 0 0</pose>{more}"),
    ]
    # of two joints the second is where the first is, off by the rounding of a file
    place = f"<pose relative_to='one'>{wrong} 0 {-wrong} 0 {wrong} 0</pose>"
    two = joint("two", kind, *ends, f"{axes}{place}{more}")
    alone = rp.load_robot(written(tmp_path, *parts))
    robot = rp.load_robot(written(tmp_path, *parts, two))
    assert robot.n == alone.n == (2 if kind == "universal" else 1)
    x = np.full(robot.n, 0.3)
    tau, want = (rp.RneaDynamics(each).torque(x, 2.0 * x, 3.0 * x).tau for each in (robot, alone))
    np.testing.assert_allclose(tau, want, rtol=1e-9 + 10.0 * wrong)
    ends = [rp.simulate(each, duration=0.1, dt=0.1).x[-1] for each in (robot, alone)]
    np.testing.assert_allclose(*ends, rtol=1e-6 + 100.0 * wrong)


def hooke(axis2: str) -> list[str]:
    """Two shafts that meet at 0.4 rad, and a cross between them."""
    arms = f"<axis><xyz>0 0 1</xyz></axis><axis2><xyz>{axis2}</xyz></axis2>"
    return [
        link("base", "0 0 0 0 0 0"),
        link("in", "0 0 0.1 0 0 0"),
        link("out", "0.2 0 0.1 0 0 0.4"),
        joint("shaft_in", "revolute", "base", "in", xyz="1 0 0"),
        joint("shaft_out", "revolute", "base", "out", xyz="1 0 0"),
        joint("cross", "universal", "in", "out", more=arms),
    ]


@pytest.mark.parametrize("kind", ["universal", "revolute2"])
@pytest.mark.parametrize("lean", [0.0, 0.3])
def test_a_cross_between_shafts(kind: str, lean: float, tmp_path: Path) -> None:
    """With arms at right angles the ratio of the speeds is Hooke's; any other cross is a link between two hinges."""
    axis2 = f"0 {float(np.cos(lean))!r} {float(np.sin(lean))!r}"
    parts = hooke(axis2)
    robot = rp.load_robot(written(tmp_path, *(part.replace("universal", kind) for part in parts)), actuated="shaft_in")
    assert robot.n == 1
    x = np.array([[0.0], [0.3], [0.8], [1.2]])
    motion = rp.PlatformMotion(np.arange(4.0), x, np.ones_like(x), np.zeros_like(x))
    v = rp.inverse_kinematics(robot, motion).v[:, robot.model.joints[robot.model.getJointId("shaft_out")].idx_v]
    if not lean:
        np.testing.assert_allclose(np.abs(v), np.cos(0.4) / (1.0 - np.sin(0.4) ** 2 * np.sin(x[:, 0]) ** 2), atol=1e-9)
    light = '<link name="cross"><pose relative_to="out"/><inertial><mass>0</mass>'
    light += "<inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial></link>"
    turn = f'<axis><xyz expressed_in="out">{axis2}</xyz></axis>'
    arms = [joint("one", "revolute", "in", "cross"), joint("two", "revolute", "cross", "out", more=turn)]
    other = rp.load_robot(written(tmp_path, *parts[:5], light, *arms), actuated="shaft_in")
    np.testing.assert_allclose(efforts(robot, 0.8, 1.0, 0.5), efforts(other, 0.8, 1.0, 0.5), rtol=1e-9)


@pytest.mark.parametrize("root", ["parent", "child"])
def test_the_first_axis_of_two_is_the_parents(root: str, tmp_path: Path) -> None:
    """By hand, whichever of both links the other one hangs from: the child is turned by R_x(q₁) R_y(q₂)."""
    two = "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    links = [link(name, "0 0 0 0 0 0") for name in ("parent", "child")]
    held = joint("held", "fixed", "world", root)
    model = read_sdf(written(tmp_path, *links, held, joint("cross", "universal", "parent", "child", two))).model
    q = np.zeros(2)
    for name, value in (("cross_1", 0.4), ("cross_2", -0.7)):
        q[model.joints[model.getJointId(name)].idx_q] = value
    between = np.linalg.inv(placed(model, "parent", q)) @ placed(model, "child", q)
    np.testing.assert_allclose(between[:3, :3], turned(0.4, 0.0, 0.0) @ turned(0.0, -0.7, 0.0), atol=1e-12)


# --- couplings --------------------------------------------------------------------------------------------------------

UPRIGHT = "<inertial><mass>2</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>0.03</izz></inertia></inertial>"


@pytest.mark.parametrize(
    ("given", "lead"),
    [
        ("<screw_thread_pitch>0.01</screw_thread_pitch>", 0.01 / (2.0 * np.pi)),
        ("<screw_thread_pitch>-0.02</screw_thread_pitch><thread_pitch>3</thread_pitch>", -0.02 / (2.0 * np.pi)),
        ("<thread_pitch>-628</thread_pitch>", 1.0 / 628.0),
    ],
)
@pytest.mark.parametrize("in_loop", [False, True])
def test_a_screw(given: str, lead: float, in_loop: bool, tmp_path: Path) -> None:
    """By hand: z = lead θ, τ = I θ̈ + m lead (g + lead θ̈); in a jack the nut does not turn, and goes the other way."""
    body, axis = f'<link name="body">{UPRIGHT}</link>', joint("screw", "screw", "world", "body")
    parts = [body, axis.replace("<parent>", f"{given}<parent>")]
    if in_loop:
        parts = [
            f'<link name="spindle">{UPRIGHT}</link>',
            body,
            joint("turn", "revolute", "world", "spindle"),
            joint("rail", "prismatic", "world", "body"),
            joint("screw", "screw", "spindle", "body").replace("<parent>", f"{given}<parent>"),
        ]
    robot = rp.load_robot(written(tmp_path, *parts), actuated="turn" if in_loop else "screw")
    assert robot.n == 1
    if in_loop:
        lead = -lead
    motion = rp.PlatformMotion([0.0], [[0.7]], [[0.0]], [[0.0]])
    place = placed(robot.model, "body", rp.inverse_kinematics(robot, motion).q[0])
    np.testing.assert_allclose(place[:3, 3], [0.0, 0.0, 0.7 * lead], atol=1e-12)
    np.testing.assert_allclose(place[:3, :3], turned(0.0, 0.0, 0.0 if in_loop else 0.7), atol=1e-9)
    assert efforts(robot, 0.7, 2.0, 5.0)[0] == pytest.approx(0.03 * 5.0 + 2.0 * lead * (9.81 + lead * 5.0), rel=1e-9)


def test_mimic(tmp_path: Path) -> None:
    """The follower, rad or m, is multiplier · (leader − reference) + offset, by the axis that is named."""
    follow = '<mimic joint="cross" axis="axis2"><multiplier>0.5</multiplier><offset>0.1</offset>{}</mimic>'
    two = "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 0</xyz></axis2>"
    parts = [
        *(link(name, "0 0 0 0 0 0") for name in ("base", "a", "b", "c")),
        joint("cross", "universal", "base", "a", more=two),
        joint("slide", "prismatic", "base", "b", follow.format("<reference>0.4</reference>")),
        joint("back", "revolute", "c", "base", '<mimic joint="slide"><multiplier>-3</multiplier></mimic>'),
    ]
    robot = rp.load_robot(written(tmp_path, *parts, version="1.11"), actuated="cross_1,cross_2")
    assert {(each.joint, each.of, each.polynomial) for each in robot.couplings} == {
        ("slide", "cross_2", (0.1 - 0.5 * 0.4, 0.5)),
        ("back", "slide", (0.0, -3.0)),
    }
    model, q = robot.model, robot.q_reference
    at = {name: q[model.joints[model.getJointId(name)].idx_q] for name in list(model.names)[1:]}
    assert at["slide"] == pytest.approx(0.5 * (at["cross_2"] - 0.4) + 0.1)
    assert at["back"] == pytest.approx(-3.0 * at["slide"])
    np.testing.assert_allclose(placed(model, "b", q)[:3, 3], [0.0, 0.0, at["slide"]], atol=1e-12)
    between = np.linalg.inv(placed(model, "c", q)) @ placed(model, "base", q)
    np.testing.assert_allclose(between[:3, :3], turned(0.0, 0.0, at["back"]), atol=1e-9)
    assert read_sdf(written(tmp_path, *parts, version="1.11")).actuated == ("cross_1", "cross_2")  # no followers


GEARBOX = """<joint name="gears" type="gearbox"><parent>{parent}</parent><child>{child}</child>
<gearbox_reference_body>base</gearbox_reference_body><gearbox_ratio>0.04</gearbox_ratio>
<axis><xyz>0 0 {one}</xyz></axis><axis2><xyz>0 0 {two}</xyz></axis2></joint>"""


@pytest.mark.parametrize("turned_round", [False, True])
@pytest.mark.parametrize(("one", "two"), [(1, 1), (1, -1)])
def test_a_gearbox_couples_angles_from_its_reference_body(
    one: int, two: int, turned_round: bool, tmp_path: Path
) -> None:
    """θ₂ = −ratio θ₁ by the places of the links: the file's own words, whichever way round its joints are written."""
    ends = ("rotor", "base") if turned_round else ("base", "rotor")
    rotor = [link("rotor", "0 0.3 0 0 0 0.4", 0.1), joint("spin", "revolute", *ends)]
    gears = GEARBOX.format(parent="rotor", child="crank", one=one, two=two)
    robot = rp.load_robot(written(tmp_path, *FOUR_BAR, *rotor, gears), actuated="drive")
    assert (robot.n, len(robot.couplings)) == (1, 1)
    spin = robot.model.joints[robot.model.getJointId("spin")]
    x = home_of(robot) + np.array([[0.0], [0.01]])
    q = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0, 1.0], x, 0 * x, 0 * x)).q
    turns = [
        [np.arctan2(*(placed(robot.model, name, each)[[1, 0], 0])) for each in q] for name in ("base", "rotor", "crank")
    ]
    base, first, second = np.diff(turns)[:, 0]
    first, second = (np.angle(np.exp(1j * (angle - base))) for angle in (first, second))
    assert abs(q[1, spin.idx_q] - q[0, spin.idx_q]) == pytest.approx(0.25)
    assert two * second == pytest.approx(-0.04 * one * first)
    with pytest.raises(ModelFileError, match="needs a hinge about its axis from 'base' to 'rod'"):
        rp.load_robot(written(tmp_path, *FOUR_BAR, *rotor, gears.replace(">crank<", ">rod<")))


# --- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "text", "end", "most"),
    [
        ("revolute", "1.5", 1.5, 1.5),
        ("prismatic", "-1.5", -1.5, np.inf),  # a speed or effort below zero is none
        ("revolute", "0", 0.0, 0.0),
        ("prismatic", "9.9e14", 9.9e14, 9.9e14),
        ("revolute", "-1e15", None, np.inf),
        ("revolute", "1.79769e+308", None, np.inf),
        ("prismatic", "-Infinity", None, np.inf),
        ("continuous", "1.5", None, 1.5),  # it turns for ever
    ],
)
def test_limits_hold_up_to_1e15(kind: str, text: str, end: float | None, most: float, tmp_path: Path) -> None:
    none = {"lower": -np.inf, "upper": np.inf, "effort": np.inf, "velocity": np.inf}
    for key in none:
        turn = joint("turn", kind, "base", "crank", f"<limit><{key}>{text}</{key}></limit>")
        model = read_sdf(written(tmp_path, *LINKS[:2], turn)).model
        limits = model.lowerPositionLimit, model.upperPositionLimit, model.upperEffortLimit, model.upperVelocityLimit
        found = dict(zip(none, (float(limit[0]) for limit in limits), strict=True))
        assert found == none | {key: (none[key] if end is None else end) if key in ("lower", "upper") else most}
        np.testing.assert_array_equal(model.lowerEffortLimit, -model.upperEffortLimit)


def test_masses_are_placed_by_the_pose_of_the_inertial(tmp_path: Path) -> None:
    model = read_sdf(written(tmp_path, *FOUR_BAR)).model
    own, turn = model.inertias[model.getJointId("elbow")], turned(0.0, 0.0, -0.2)
    assert own.mass == 0.5
    np.testing.assert_allclose(own.lever, turn @ [0.1, 0.02, 0.03], atol=1e-12)
    about = turn @ turned(0.1, 0.2, 0.3)
    tensor = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, 0.0], [0.0, 0.0, 0.04]])
    np.testing.assert_allclose(own.inertia, about @ tensor @ about.T, atol=1e-12)


@pytest.mark.parametrize(
    ("inertial", "mass", "moments"),
    [
        ("", 1.0, [1.0, 1.0, 1.0]),
        ("<inertial><mass>3</mass></inertial>", 3.0, [1.0, 1.0, 1.0]),
        ("<inertial><inertia><iyy>0.5</iyy></inertia></inertial>", 1.0, [1.0, 0.5, 1.0]),
    ],
)
def test_masses_that_the_file_leaves_out_are_those_of_the_specification(
    inertial: str, mass: float, moments: list[float], tmp_path: Path
) -> None:
    mechanism = read_sdf(written(tmp_path, f'<link name="a">{inertial}</link>', joint("j", "revolute", "world", "a")))
    body = mechanism.model.inertias[1]
    assert body.mass == mass
    np.testing.assert_allclose(np.diag(body.inertia), moments)
    assert any("SDF's own 1 kg and 1 kg·m²: a." in note for note in mechanism.notes)


def test_base_and_driven_joints(tmp_path: Path) -> None:
    path = written(tmp_path, *FOUR_BAR, "<pose>0 0 1 0.1 0.2 0.3</pose>")
    assert rp.load_robot(path, actuated="foot").actuated == ("foot",)
    free = rp.load_robot(path, base="free", actuated="drive")
    assert (free.n, free.m) == (7, 1)
    expected = np.eye(4)
    expected[:3, :3] = turned(0.1, 0.2, 0.3)
    expected[:3, 3] = expected[:3, :3] @ [0.0, 0.0, 0.1] + [0.0, 0.0, 1.0]
    np.testing.assert_allclose(placed(free.model, "base", free.q_reference), expected, atol=1e-12)
    with pytest.raises(ModelFileError, match=r"actuated names 'krank'"):
        rp.load_robot(path, actuated="krank")
    with pytest.raises(InputError, match="no argument 'keyframe'"):
        rp.load_robot(path, keyframe="home")
    still = joint("latch", "revolute", "rocker", "lid", LIMIT.replace("-2", "0").replace(">2<", ">0<"))
    fixed = rp.load_robot(written(tmp_path, *FOUR_BAR, link("lid", "0 0 0.2 0 0 0"), still))
    assert "latch" not in fixed.model.names
    assert any("'latch' has the limits 0 and 0" in note for note in fixed.notes)


def test_a_model_that_drives_nothing_is_told_how_to_say_it(tmp_path: Path) -> None:
    """An SDF has no actuators to add: joints are named. One with a spring is not taken to be driven unasked."""
    path = written(tmp_path, *LINKS[:2], joint("hinge", "revolute", "base", "crank", SPRING))
    with pytest.raises(RedundancyPinError, match='actuated="a,b"') as caught:
        rp.load_robot(path)
    assert "actuators" not in str(caught.value)
    assert rp.load_robot(path, actuated="hinge").actuated == ("hinge",)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("<axis>", "<axis><initial_position>0.4</initial_position>", "initial position of 'drive' is not read"),
        ("</model>", '<plugin name="p" filename="f"/></model>', "The plugin 'p' does not run"),
        ("</model>", '<x:tag xmlns:x="y"/></model>', "Passed over: <tag> in line 1"),
        ("</model>", "<model_state/></model>", "Not read: <model_state> in line"),
        ("<inertial>", '<collision name="c"/><inertial>', "Contacts are not modelled"),
        (
            "<inertial>",
            "<velocity_decay><linear>1</linear></velocity_decay><inertial>",
            "Not in force, though the file says it: velocity decay of base",
        ),
        ("</joint>", "<physics><ode><cfm>0.1</cfm></ode></physics></joint>", "though the file says it: <ode> of drive"),
        (
            "</joint>",
            "<physics><ode><cfm>0</cfm><suspension><cfm>1</cfm></suspension></ode></physics></joint>",
            "though the file says it: <ode> of drive",
        ),
        ("</axis>", "</axis><axis2><xyz>1 0 0</xyz></axis2>", "second axis of 'drive', which is revolute, is left out"),
    ],
)
def test_what_is_left_out_is_noted(old: str, new: str, note: str, tmp_path: Path) -> None:
    path = written(tmp_path, *FOUR_BAR)
    path.write_text(path.read_text().replace(old, new, 1))
    assert note in " ".join(rp.load_robot(path).notes)


# --- other files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("https://fuel.gazebosim.org/1.0/x/models/arm", "which is not beside it"),
        ("file:///etc/passwd", "which is not beside it"),
        ("/etc/passwd", "which is not beside it"),
        ("../part.sdf", "which is not beside it"),
        ("model://arm/../../part.sdf", "which is not beside it"),
        ("model://part.sdf", "which is not there"),  # only what is in a folder with a model.config, above
        ("model://arm", "which leads out of"),
        ("linked.sdf", "which leads out of"),
        ("machine.sdf", "includes itself"),
        ("other.sdf", "holds <light>"),
        ("robot.urdf", "is <robot>, not <sdf>"),
    ],
)
def test_no_file_is_read_outside_its_folders(uri: str, message: str, tmp_path: Path) -> None:
    folder = tmp_path / "robots"
    (tmp_path / "models" / "arm").mkdir(parents=True)
    folder.mkdir()
    (tmp_path / "part.sdf").write_text((FILES / "good" / "parts.sdf").read_text())
    (tmp_path / "models" / "arm" / "model.config").write_text("<model><sdf>../../part.sdf</sdf></model>")
    (folder / "other.sdf").write_text('<sdf version="1.9"><light name="sun"/></sdf>')
    (folder / "robot.urdf").write_text("<robot name='a'/>")
    os.symlink(tmp_path / "part.sdf", folder / "linked.sdf")
    path = written(folder, f"<include><uri>{uri}</uri></include>")
    with pytest.raises(ModelFileError, match=message) as caught:
        read_sdf(path)
    assert caught.value.details["line"] == 1


@pytest.mark.parametrize(
    ("files", "copies", "last", "message"),
    [(20, 2, '<link name="a"/>', "more than 6000 frames"), (2, 10, "<plugin/>" * 3000, "more than 20000 elements")],
)
def test_includes_that_multiply_end_soon(files: int, copies: int, last: str, message: str, tmp_path: Path) -> None:
    """Files that each include the next one several times."""
    for number in range(files):
        uri = f"<uri>part{number + 1}.sdf</uri>"
        body = "".join(f"<include>{uri}<name>m{copy}</name></include>" for copy in range(copies))
        body = body if number < files - 1 else last
        (tmp_path / f"part{number}.sdf").write_text(f'<sdf version="1.9"><model name="m">{body}</model></sdf>')
    began = time.process_time()
    with pytest.raises(ModelFileError, match=message):
        read_sdf(tmp_path / "part0.sdf")
    assert time.process_time() - began < 2.0


# --- Cassie -----------------------------------------------------------------------------------------------------------


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
        pytest.param("", 12, marks=pytest.mark.long),  # the shin's spring, a slide, closes to 3e-5 on both sides
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
