"""Models of Gazebo: places by the specification's own words, torques by Pinocchio's tree with the loop as KKT rows."""

from __future__ import annotations

import os
import time
import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path

import cassie
import numpy as np
import pinocchio as pin
import pytest
from test_urdf_dialects import FILES as URDFS
from test_urdf_dialects import GRAVITY, MOTION, torque, torque_by_kkt
from written import write_changed
from zoo import home_of, places_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError, ModelFileError
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.formats.sdf import read_sdf
from redundancy_pin.robot.loads import JointForces

FILES = Path(__file__).parent / "files" / "sdf"
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
    return places_of(model, q, name)[0].homogeneous


def efforts(robot: rp.Robot, x: float, xd: float, xdd: float) -> Array:
    return rp.RneaDynamics(robot).torque([x], [xd], [xdd]).tau


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


# --- loops ------------------------------------------------------------------------------------------------------------

PIN = "<parent>bar</parent><child>arm</child><axis><xyz>0 0 1</xyz>"
SPRING = "<dynamics><damping>0.3</damping><friction>0.2</friction><spring_stiffness>5</spring_stiffness>"
SPRING += "<spring_reference>0.1</spring_reference></dynamics>"


def test_forces_of_a_joint_that_closes_the_loop_do_their_work(tmp_path: Path) -> None:
    """Power by power: spring, damper and friction of a pin at the torque of the motor, at the pin's own speed."""
    plain = rp.load_robot(FILES / "good" / "plain.sdf")
    robot = rp.load_robot(write_changed(tmp_path, FILES / "good" / "plain.sdf", (PIN, PIN + SPRING)))
    assert robot.loads == (JointForces("pin", 0.3, 0.2, stiffness=5.0, rest=0.1),)
    followed = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.3]], [[0.7]], [[-0.4]]))
    at = robot.model.joints[robot.model.getJointId("pin")]
    angle, speed = float(followed.q[0, at.idx_q]), float(followed.v[0, at.idx_v])
    power = (5.0 * (angle - 0.1) + 0.3 * speed + 0.2 * np.sign(speed)) * speed
    more = efforts(robot, 0.3, 0.7, -0.4) - efforts(plain, 0.3, 0.7, -0.4)
    assert more[0] * 0.7 == pytest.approx(power, rel=1e-9)


def test_a_joint_that_is_driven_closes_the_loop_too() -> None:
    """Power by power: the torque at the pin does the work of that at the motor; its own angle is the motion."""
    motor, pinned = (rp.load_robot(FILES / "good" / "plain.sdf", actuated=name) for name in ("motor", "pin"))
    given = rp.PlatformMotion([0.0], [[home_of(pinned)[0] + 0.1]], [[0.7]], [[-0.4]])
    followed = rp.inverse_kinematics(pinned, given)
    own = pinned.independent_joints[0]
    at = {name: pinned.model.joints[pinned.model.getJointId(name)].idx_v for name in ("motor", "pin", own)}
    state = {name: [float(each[0, at[name]]) for each in (followed.q, followed.v, followed.a)] for name in at}
    power = efforts(motor, *state["motor"])[0] * state["motor"][1]
    assert efforts(pinned, *state[own])[0] * state["pin"][1] == pytest.approx(power, rel=1e-9)


def test_the_hinges_of_a_ball_that_moves_freely_can_be_driven(tmp_path: Path) -> None:
    """By the names that notes call them: torques are those of a file with the three hinges in a row."""
    inertia = "<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz></inertia>"
    body = f"<inertial><pose>0.1 0.2 0.3 0 0 0</pose><mass>2</mass>{inertia}</inertial>"
    none = "<inertial><mass>0</mass><inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial>"
    ends = ["world", "first", "second", "body"]
    hinges = "".join(
        f'<joint name="{name}" type="revolute"><parent>{parent}</parent><child>{child}</child>'
        f"<axis><xyz>{xyz}</xyz></axis></joint>"
        for name, parent, child, xyz in zip(
            ("rz", "ry", "rx"), ends, ends[1:], ("0 0 1", "0 1 0", "1 0 0"), strict=False
        )
    )
    parts = {
        "ball": '<joint name="b" type="ball"><parent>world</parent><child>body</child></joint>',
        "hinges": f'<link name="first">{none}</link><link name="second">{none}</link>{hinges}',
    }
    tau = {}
    for name, part in parts.items():
        link = f'<link name="body">{body}</link>'
        (tmp_path / f"{name}.sdf").write_text(f'<sdf version="1.9"><model name="m">{link}{part}</model></sdf>')
        own = "b_" if name == "ball" else ""
        robot = rp.load_robot(tmp_path / f"{name}.sdf", actuated=[f"{own}{axis}" for axis in ("rx", "ry", "rz")])
        assert (robot.n, robot.m) == (3, 3)
        tau[name] = rp.RneaDynamics(robot).torque([0.3, -0.2, 0.5], [1.0, 2.0, -1.0], [0.1, 3.0, -2.0]).tau
    np.testing.assert_allclose(tau["ball"], tau["hinges"], atol=1e-12)
    assert np.abs(tau["ball"]).min() > 0.01


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


def test_mimic() -> None:
    """The follower, rad or m, is multiplier · (leader − reference) + offset, by the axis that is named."""
    path = FILES / "other" / "mimic.sdf"
    robot = rp.load_robot(path, actuated="cross_1,cross_2")
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
    with pytest.raises(DeclarationError, match=r"driven, of cross_1, cross_2\?.*--actuate cross_1,cross_2"):
        rp.load_robot(path)  # no followers


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
    places = {"base": "0 0 0.1 0 0 0", "crank": "0 0 0.1 0 0 0.9", "rotor": "0 0.3 0 0 0 0.4", "rod": "0.2 0 0 0 0 0"}
    parts = [link(name, place) for name, place in places.items()]
    parts += [joint("drive", "revolute", "base", "crank"), joint("spin", "revolute", *ends)]
    parts += [joint("still", "fixed", "crank", "rod")]
    gears = GEARBOX.format(parent="rotor", child="crank", one=one, two=two)
    robot = rp.load_robot(written(tmp_path, *parts, gears), actuated="drive")
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
        rp.load_robot(written(tmp_path, *parts, gears.replace(">crank<", ">rod<")))


# --- numbers ----------------------------------------------------------------------------------------------------------


def test_masses_are_placed_by_the_pose_of_the_inertial(tmp_path: Path) -> None:
    parts = link("base", "0 0 0 0 0 0"), link("rod", "0.3 0 0 0 0 -0.2", 0.5)
    own = read_sdf(written(tmp_path, *parts, joint("j", "revolute", "base", "rod"))).model.inertias[1]
    turn = turned(0.0, 0.0, -0.2)
    assert own.mass == 0.5
    np.testing.assert_allclose(own.lever, turn @ [0.1, 0.02, 0.03], atol=1e-12)
    about = turn @ turned(0.1, 0.2, 0.3)
    tensor = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, 0.0], [0.0, 0.0, 0.04]])
    np.testing.assert_allclose(own.inertia, about @ tensor @ about.T, atol=1e-12)
    bare = read_sdf(FILES / "noted" / "masses_of_the_specification.sdf").model.inertias[1]
    assert (bare.mass, bare.inertia.tolist()) == (1.0, np.eye(3).tolist())


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
        ("model://circle", "which leads out of"),
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
    circle = tmp_path / "models" / "circle"
    circle.mkdir()
    (circle / "model.config").write_text("<model><sdf>model.sdf</sdf></model>")
    os.symlink(circle / "model.sdf", circle / "model.sdf")
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


def freedoms_by_pinocchio(mechanism: Mechanism) -> int:
    """Return what the rows of all loops and couplings leave of the tree, to the digits of a file, where it starts."""
    model, rows = mechanism.model, []
    data = model.createData()
    pin.computeJointJacobians(model, data, mechanism.start)
    pin.updateFramePlacements(model, data)
    kept = {"hinge": [0, 1, 2, 3, 4], "slider": [0, 1, 3, 4, 5], "ball": [0, 1, 2]}
    for closure in mechanism.loop_joints:
        ends = []
        for name, place in zip(closure.links, closure.placements, strict=True):
            frame = model.getFrameId(name, pin.FrameType.BODY)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL)
            ends.append(pin.SE3(place).toActionMatrixInverse() @ jacobian)
        rows.append((ends[0] - ends[1])[kept[closure.kind]])
    for coupling in mechanism.couplings:
        row = np.zeros((1, model.nv))
        for name, factor in ((coupling.joint, 1.0), (coupling.of, -coupling.polynomial[1])):
            row[0, model.joints[model.getJointId(name)].idx_v] = factor
        rows.append(row)
    return int(model.nv - np.sum(np.linalg.svd(np.vstack(rows), compute_uv=False) > 5e-5))


@pytest.mark.long_for("_reduced-11", "_simple-11", "_v2-12")
@pytest.mark.skipif(not _cassie().is_dir(), reason="example-robot-data is not installed")
@pytest.mark.parametrize(
    ("name", "freedoms"),
    [
        *(("_reduced", 11), ("_simple", 11), ("_v2", 12)),
        *(pytest.param(*case, marks=pytest.mark.long) for case in (("_wo_gearbox_spring", 13), ("", 12))),
    ],
)
def test_cassie_loads_and_moves(name, freedoms):
    """Freedoms by hand: three of a hip, knee and shin or spring with the rod, a foot unless tilted axes lock it.

    In the file with gearboxes the slide of each shin's spring is at right angles to the arm of 35 mm that it ends. Its
    loop moves to first order only: singular values are 4e-6 on the left and 3e-7 on the right, the next one is 6e-4.
    """
    path = _cassie() / f"cassie{name}.sdf"
    with pytest.raises(DeclarationError, match=rf"Which joints are driven, .* The mechanism has {freedoms} DOF"):
        rp.load_robot(path)
    robot = rp.load_robot(path, actuated=cassie.drives(path))
    assert (robot.n, robot.m) == (freedoms, freedoms)
    assert freedoms_by_pinocchio(read_sdf(path)) == freedoms
    assert sum(body.mass for body in robot.model.inertias) == pytest.approx(
        sum(float(mass.text) for mass in ElementTree.parse(path).iter("mass"))
    )
    x = home_of(robot) + 0.03 * np.sin(np.arange(robot.n))
    motion = rp.PlatformMotion([0.0], x[None], 0.1 * np.ones((1, robot.n)), np.zeros((1, robot.n)))
    assert np.isfinite(rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau).all()


@pytest.mark.parametrize("wrong", [0.0, 1e-5])
@pytest.mark.parametrize("swapped", [False, pytest.param(True, marks=pytest.mark.long)])
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
    driven = "one_1,one_2" if kind == "universal" else "one"
    alone = rp.load_robot(written(tmp_path, *parts), actuated=driven)
    robot = rp.load_robot(written(tmp_path, *parts, two), actuated=driven)
    assert robot.n == alone.n == (2 if kind == "universal" else 1)
    x = np.full(robot.n, 0.3)
    tau, want = (rp.RneaDynamics(each).torque(x, 2.0 * x, 3.0 * x).tau for each in (robot, alone))
    np.testing.assert_allclose(tau, want, rtol=1e-9 + 10.0 * wrong)
    ends = [rp.simulate(each, duration=0.1, dt=0.1).x[-1] for each in (robot, alone)]
    np.testing.assert_allclose(*ends, rtol=1e-6 + 100.0 * wrong)
