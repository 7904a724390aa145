"""Files that are almost right: the shipped ones, and what the package writes, with one to three things wrong.

Every generator takes dice (``random.Random``) and returns the files of a folder by name; the same dice, the same files.
"""

from __future__ import annotations

import copy
import datetime
import functools
import random
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import mjcf_models
import numpy as np
import yaml
import zoo
from parked_plans import parked_plan

import redundancy_pin as rp
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot.formats.xacro_file import render
from redundancy_pin.robot.shipped import models_root

Files = Mapping[str, bytes]
Dice = random.Random

HUGE = "9" * 5000
NUMBERS = (
    "", " ", "nan", "-nan", "inf", "-inf", "0", "-0", "-1", "1e400", "1e-400", "1e308", "1e-308", HUGE, "2**1000000",
    "9**9**9", "0x10", "1_000", "٣", "½", "1e", "1,5", "0.5, 0, 0", "1 2", "1 2 3 4", "0 0 0", "nan 0 0", "1 0",
    "1 0 0 junk", "true", "None", "[]", "1\n2", "\x1b[31m", "%s", "{0}", "100000", "1e18", "-2", "1.5", "1e-9",
    "9223372036854775808", "١ ٢ ٣", "0.1.2", "--1", "+1", "1d0", "1f", "infinity 0 0", "1e5 1e5 1e5", "0 0 1e-12",
)  # fmt: skip
EXPRESSIONS = (
    "9**9**9", "2**1000000", "(lambda: 1)()", "(lambda f: f(f))(lambda f: f(f))", "().__class__.__bases__",
    "base_distance.__class__", "__import__('os').system('true')", "[x for x in range(10**9)]", "'a' * 10**10",
    "[0] * 10**10", "1/0", "sqrt(-1)", "exp(1e4)", "10**400", "1e308 * 10", "(" * 3000 + "1" + ")" * 3000,
    "-" * 5000 + "1", "+".join(["1"] * 5000), "1 if True else", "a := 1", "open('/etc/passwd')", "globals()",
    "eval('1')", "print(1)", "undefined_name", "{1: 2}[3]", "[1][5]", "''.join(['a'])", "'%d' % 1",
    "'{0.__class__}'.format(1)", "f'{1}'", "1 < 2 < 3", "not", "~1.5", "1 @ 2", "1 if 0.5 else 2", "True + True",
    "max()", "min([])", "round(1e400)", "1e400", "float('nan')", "0 * inf", "pi", "sin(1) + cos(2)",
    "abs(-3) ** 0.5", "1 ; 2", "\\", "\x00", "é", "1 +", "${1}", "$(arg base_distance)", "factorial(10**6)",
    "range(10**12)", "sum(range(10**9))", "pow(7, 10**9)",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 10**400, 1e308, float("nan"), float("inf"), -0.5, "", " ", "x", "nan", HUGE,
    "é" * 300, "../../x", "/dev/zero", [], {}, [[]], [None], {"": ""}, {1: 2}, [1, 2, 3, 4, 5, 6, 7], ["x"],
    {"x": {"y": {"z": []}}}, "x" * 70_000, datetime.date(2001, 12, 14), datetime.datetime(2001, 12, 14, 21, 59, 43),
    b"bytes", (1, 2), "true", "1e-3", "[1, 2]", "*a", [[[[[[[[[[]]]]]]]]]], ["x"] * 3000, "\x1b[31m", "\x00",
    "base_distance / 2", "__import__('os')", "9**9**9", "()", "- 1", "<<",
)  # fmt: skip


YAML_TEXTS = (
    "2001-12-14t21:59:43.10-05:00", "2001-12-14", ".inf", ".nan", "0x" + "f" * 2000, "null", "[[[[]]]]", "[1, [2]]",
    "!!binary aGFsbG8=", "!!set {a, b}", "!!python/object:os.system x", "!!python/name:os.system", "*a", "&a 1",
    "&a *a", "'text'", '"\\u0000"', "~", "<<", "{a: {b: c}}", "1:30:00", "0o17", "- 1", "- -", "=", "?", "1e-320",
    "[" * 3000 + "]" * 3000, "é" * 300, "~nobody-of-that-name/x",
)  # fmt: skip
"""What YAML may make something else of than it looks like."""


# ------------------------------------------------------------------------------------------------------ what is right


@functools.cache
def declaration_of(name: str) -> str:
    """Return the text of a shipped declaration."""
    return (models_root() / name / "robot.yaml").read_text(encoding="utf-8")


@functools.cache
def xacro_of(name: str) -> str:
    """Return the text of a shipped xacro."""
    return (models_root() / name / f"{name}.urdf.xacro").read_text(encoding="utf-8")


@functools.cache
def urdf_of(name: str) -> str:
    """Return the URDF that a shipped xacro gives for the robots of the zoo."""
    return render(models_root() / name / f"{name}.urdf.xacro", zoo.WITH_CARRIERS.get(name, {}))[0]


@functools.cache
def plain_declaration(name: str) -> str:
    """Return a shipped declaration for the URDF without arguments: expressions become numbers."""
    data = yaml.safe_load(declaration_of(name))
    robot = zoo.robot_of(name)
    for key in ("requires", "closed_form"):
        data.pop(key, None)
    data["urdf"] = "robot.urdf"
    carriers = [each for each in data.pop("carriers", ()) if each["joint"] in robot.carriers]
    data["carriers"] = [{key: value for key, value in each.items() if key != "when"} for each in carriers]
    values = dict(robot.parameters)

    def number(value: Any) -> Any:
        # the shipped expressions are arithmetic of arguments; this is a test's own evaluation of them
        if isinstance(value, str):
            import math

            return float(eval(value, {"__builtins__": {}}, {**vars(math), **values}))
        return value

    reference = data["reference"]
    for part in ("platform", "guess"):
        entries = reference.get(part)
        if isinstance(entries, list):
            reference[part] = [number(value) for value in entries]
        elif isinstance(entries, dict):
            reference[part] = {key: number(value) for key, value in entries.items()}
    for closure in data.get("closures", ()):
        for key, value in closure.items():
            if isinstance(value, list) and key not in ("frames", "axes"):
                closure[key] = [number(entry) for entry in value]
    return yaml.safe_dump(data, sort_keys=False)


@functools.cache
def plan_of(name: str) -> Plan:
    """Return a short plan: parked carriers along a smooth motion."""
    robot = rp.load_robot(name)
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.3, 7))
    return parked_plan(
        rp.RneaDynamics(robot),
        motion,
        parameters={"threshold": 5.0, "window": (0.1, np.inf)},
        diagnostics={"switch": np.array([0.1, np.nan])},
    )


@functools.cache
def stepwise_plan() -> Plan:
    """Return a plan with functions of time."""
    robot = rp.load_robot("3rrr")
    return rp.plan_stepwise(rp.RneaDynamics(robot), rp.trajectory.reference.corner(radius=0.025), mesh=rp.Mesh(dt=0.05))


@functools.cache
def saved(plan: Callable[[], Plan]) -> bytes:
    """Return the file of a plan."""
    with tempfile.TemporaryDirectory() as folder:
        plan().save(Path(folder) / "plan.npz")
        return (Path(folder) / "plan.npz").read_bytes()


@functools.cache
def motion_csv(name: str) -> str:
    """Return a motion that a shipped robot can follow, as CSV."""
    robot = zoo.robot_of(name)
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.2, 12))
    x = motion.x
    if x.ndim == 3:
        from scipy.spatial.transform import Rotation

        x = np.concatenate([x[:, :3, 3], Rotation.from_matrix(x[:, :3, :3]).as_quat()], axis=1)
    names = [
        "t",
        *(
            f"{key}{i}"
            for key, part in (("x", x), ("xd", motion.xd), ("xdd", motion.xdd))
            for i in range(part.shape[1])
        ),
    ]
    rows = np.concatenate([motion.t[:, None], x, motion.xd, motion.xdd], axis=1)
    return "\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n"


# ------------------------------------------------------------------------------------------------- mutations of bytes


def spoiled_bytes(data: bytes, dice: Dice) -> bytes:
    """Return bytes with some flipped, removed, doubled, or noise put in."""
    spoiled = bytearray(data)
    for _ in range(dice.choice((1, 1, 2, 8))):
        at = dice.randrange(len(spoiled) + 1)
        kind = dice.randrange(5)
        if kind == 0 and at < len(spoiled):
            spoiled[at] ^= 1 << dice.randrange(8)
        elif kind == 1:
            del spoiled[at : at + dice.choice((1, 4, 100))]
        elif kind == 2:
            spoiled[at:at] = dice.randbytes(dice.choice((1, 4, 100)))
        elif kind == 3:
            spoiled[at:at] = dice.choice(
                (b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\t", "\u2028".encode(), b"\x1b[2J")
            )
        else:
            spoiled = spoiled[:at] if dice.random() < 0.5 else spoiled[at:]
    return bytes(spoiled)


def spoiled_lines(text: str, dice: Dice) -> str:
    """Return text with a line removed, doubled, moved, indented or with another value."""
    lines = text.splitlines()
    for _ in range(dice.choice((1, 1, 2))):
        at = dice.randrange(len(lines))
        kind = dice.randrange(6)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(dice.randrange(len(lines) + 1), lines[at])
        elif kind == 2:
            lines[at] = " " * dice.choice((1, 2, 7)) + lines[at]
        elif kind == 3:
            lines[at] = lines[at].lstrip()
        elif kind == 4 and ":" in lines[at]:
            key, _, value = lines[at].partition(":")
            texts = (*NUMBERS, *EXPRESSIONS, *YAML_TEXTS)
            lines[at] = f"{dice.choice(texts)}:{value}" if dice.random() < 0.1 else f"{key}: {dice.choice(texts)}"
        else:
            words = lines[at].split(" ")
            words[dice.randrange(len(words))] = dice.choice(NUMBERS)
            lines[at] = " ".join(words)
        lines = lines or [""]
    return "\n".join(lines) + "\n"


def spoiled_data(data: Any, dice: Dice) -> Any:
    """Return nested data with a node replaced, removed, renamed, doubled or swapped with another."""
    data = copy.deepcopy(data)
    for _ in range(dice.choice((1, 1, 2, 3))):
        nodes = list(_nodes(data))
        if not nodes:
            return dice.choice(VALUES)
        holder, key = dice.choice(nodes)
        kind = dice.randrange(6)
        if kind <= 2:
            value = dice.choice(VALUES)
            holder[key] = dice.choice(EXPRESSIONS) if isinstance(holder[key], str) and dice.random() < 0.3 else value
        elif kind == 3:
            del holder[key]
        elif kind == 4 and isinstance(holder, dict):
            holder[dice.choice(("", "x", 1, None, str(key) + "s", str(key).upper(), "<<"))] = holder.pop(key)
        elif kind == 4:
            holder.insert(key, holder[key])
        else:
            other, place = dice.choice(nodes)
            if place in other if isinstance(other, dict) else place < len(other):
                holder[key], other[place] = copy.deepcopy(other[place]), copy.deepcopy(holder[key])
    return data


def _nodes(data: Any) -> list[tuple[Any, Any]]:
    """Return (holder, key) of everything in nested lists and dictionaries."""
    mutations: list[tuple[Any, Any]] = []
    waiting = [data]
    while waiting:
        holder = waiting.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder)) if isinstance(holder, list) else ()
        for key in keys:
            mutations.append((holder, key))
            waiting.append(holder[key])
    return mutations


def bomb() -> str:
    """Return YAML whose aliases stand for 9¹¹ words."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    return "\n".join(lines) + "\n"


def yaml_text(data: Any, dice: Dice) -> bytes:
    """Return nested data, spoiled, as YAML."""
    return yaml.dump(spoiled_data(data, dice), sort_keys=False).encode("utf-8", "surrogatepass")


def _rare_yaml(text: str, dice: Dice) -> bytes:
    return dice.choice(
        (
            lambda: (bomb() + text).encode(),
            lambda: (text + "closures: [*a]\n").encode(),
            lambda: b"# " + b"x" * 30_000_000 + b"\n" + text.encode(),
            lambda: text.encode("utf-16"),
            lambda: text.encode() + text.encode(),
            lambda: b"---\n" + text.encode() + b"\n---\n" + text.encode(),
            lambda: ("[" * 5000 + "]" * 5000).encode(),
            lambda: ("a: " + "{a: " * 3000 + "1" + "}" * 3000).encode(),
            lambda: b"",
            lambda: b"robot",
            lambda: dice.randbytes(500),
        )
    )()


# ----------------------------------------------------------------------------------------------------------- generators


def declarations(dice: Dice) -> Files:
    """A shipped robot whose declaration is spoiled."""
    name = dice.choice(zoo.SHIPPED)
    text = declaration_of(name)
    kind = dice.random()
    if kind < 0.6:
        spoiled = yaml_text(yaml.safe_load(text), dice)
    elif kind < 0.85:
        spoiled = spoiled_lines(text, dice).encode("utf-8", "surrogatepass")
    elif kind < 0.95:
        spoiled = spoiled_bytes(text.encode(), dice)
    else:
        spoiled = _rare_yaml(text, dice)
    return {"robot.yaml": spoiled, f"{name}.urdf.xacro": xacro_of(name).encode()}


NAMESPACE = "http://www.ros.org/wiki/xacro"
TAGS = (
    "link",
    "joint",
    "inertial",
    "origin",
    "mass",
    "inertia",
    "parent",
    "child",
    "axis",
    "limit",
    "mimic",
    "visual",
    "x",
    "robot",
)


def spoiled_xml(text: str, dice: Dice) -> bytes:
    """Return XML with attributes or elements replaced, removed, doubled, renamed or moved."""
    ElementTree.register_namespace("xacro", NAMESPACE)
    root = ElementTree.fromstring(text)
    for _ in range(dice.choice((1, 1, 2, 3))):
        pairs = [(parent, child) for parent in root.iter() for child in parent]
        if not pairs:
            break
        parent, child = dice.choice(pairs)
        kind = dice.randrange(9)
        if kind <= 3 and child.attrib:
            key = dice.choice(list(child.attrib))
            child.set(key, "".join(c for c in dice.choice(NUMBERS) if c in "\n\t" or ord(c) >= 32))
        elif kind == 4 and child.attrib:
            del child.attrib[dice.choice(list(child.attrib))]
        elif kind == 5:
            parent.remove(child)
        elif kind == 6:
            parent.insert(dice.randrange(len(parent) + 1), copy.deepcopy(child))
        elif kind == 7:
            child.tag = dice.choice(TAGS)
        else:
            names = [
                entry.get("name") or entry.get("link")
                for entry in root.iter()
                if entry.get("name") or entry.get("link")
            ]
            for key in ("name", "link", "joint"):
                if key in child.attrib and names:
                    child.set(key, dice.choice(names) or "")
    return ElementTree.tostring(root, encoding="utf-8")


def chain(links: int) -> str:
    """Return the URDF of a chain."""
    parts = ["<robot name='chain'><link name='l0'/>"]
    for i in range(1, links):
        parts.append(
            f"<link name='l{i}'/><joint name='j{i}' type='revolute'><parent link='l{i - 1}'/><child link='l{i}'/>"
            "<axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
        )
    return "".join(parts) + "</robot>"


FOREIGN = '<!ENTITY f SYSTEM "file:///etc/passwd">'


def _rare_xml(text: str, dice: Dice) -> bytes:
    body = text[text.index("<robot") :]
    return dice.choice(
        (
            lambda: f'<!DOCTYPE r [<!ENTITY a0 "x">{_BOMB}]>{body.replace("</robot>", "&a11;</robot>")}'.encode(),
            lambda: f"<!DOCTYPE r [{FOREIGN}]>{body.replace('</robot>', '&f;</robot>')}".encode(),
            lambda: (f"<!-- {'x' * 30_000_000} -->" + body).encode(),
            lambda: chain(dice.choice((300, 3000, 30_000))).encode(),
            lambda: ("<robot>" * 20_000 + "</robot>" * 20_000).encode(),
            lambda: text.encode("utf-16"),
            lambda: b'<?xml version="1.0" encoding="utf-7"?>' + body.encode(),
            lambda: b'<?xml version="1.1"?>' + body.encode(),
            lambda: b"<robot/>",
            lambda: b"<sdf/>",
            lambda: b"",
            lambda: body.replace(
                "revolute", dice.choice(("floating", "planar", "spherical", "screw", "continuous", "Revolute"))
            ).encode(),
        )
    )()


def urdfs(dice: Dice) -> Files:
    """A URDF that is spoiled, with a declaration that is right."""
    name = dice.choice(zoo.SHIPPED)
    text = urdf_of(name)
    kind = dice.random()
    if kind < 0.8:
        spoiled = spoiled_xml(text, dice)
    elif kind < 0.95:
        spoiled = spoiled_bytes(text.encode(), dice)
    else:
        spoiled = _rare_xml(text, dice)
    return {"robot.yaml": plain_declaration(name).encode(), "robot.urdf": spoiled}


_BOMB = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
FOREIGN_XML = (
    '<!DOCTYPE r [<!ENTITY f SYSTEM "file:///etc/passwd">]>',
    f'<!DOCTYPE r [<!ENTITY a0 "x">{_BOMB}]>',
    f"<!-- {'x' * 30_000_000} -->", '<?xml version="1.0" encoding="utf-7"?>', "\ufeff", "\x00",
)  # fmt: skip
"""What stands before a model that is none of its own."""

MJCF = (
    '<include file="model.xml"/>', '<include file="settings.xml"/>', '<include file="/etc/passwd"/>',
    '<include file="../../../../../../etc/passwd"/>', '<include file=""/>', '<include file="link.xml"/>', "<include/>",
    '<default class="a"><default class="a"/></default>', '<default class="main"><joint range="nan 1"/></default>',
    '<worldbody><replicate count="1000000000" offset="1 0 0"><body/></replicate></worldbody>',
    '<worldbody><composite type="grid" count="1000 1000 1000"/></worldbody>',
    '<worldbody><body childclass="nobody"><joint/></body></worldbody>', '<compiler eulerseq="xyzxyz"/>',
    '<compiler angle="turns"/>', '<compiler meshdir="/etc"/>',
    '<compiler inertiafromgeom="true" balanceinertia="true"/>',
    '<asset><mesh name="m" file="/etc/passwd"/></asset><worldbody><geom type="mesh" mesh="m"/></worldbody>',
    '<equality><joint joint1="crank" joint2="crank" polycoef="0 1"/></equality>',
    '<equality><connect body1="crank" anchor="1e308 0 0"/></equality>', '<equality><weld body1="crank"/></equality>',
    '<keyframe><key qpos="1 2"/><key qpos="nan nan nan"/></keyframe>', '<option gravity="nan 0 0"/>',
    '<option gravity="0 0 -1e308"/>', "<frame>" * 20_000 + "</frame>" * 20_000,
    "<worldbody>" + '<body><joint axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>' * 3_000
    + "</body>" * 3_000 + "</worldbody>", f'<worldbody><geom size="{"1 " * 1_000_000}"/></worldbody>',
    '<worldbody><body><joint name="crank"/></body></worldbody>', '<contact><pair geom1="a" geom2="b"/></contact>',
    '<extension><plugin plugin="x"/></extension>', '<worldbody><body mocap="true"/></worldbody>',
    '<tendon><fixed><joint joint="crank" coef="1"/></fixed></tendon>',
    '<actuator><motor joint="crank" gear="1e308"/></actuator>', '<actuator><motor joint="nobody"/></actuator>',
    '<default><joint axis="0 0 0"/></default>', '<default><geom density="-1"/></default>',
)  # fmt: skip
"""Elements of MuJoCo's models that deceive, explode, or lead out of the folder."""


def mjcfs(dice: Dice) -> Files:
    """A model of MuJoCo that is spoiled, and the file that it includes."""
    text = dice.choice((mjcf_models.FOUR_BAR, mjcf_models.GEARED, mjcf_models.SPATIAL, mjcf_models.WELD))
    text = text.replace("{weld}", dice.choice(("", 'torquescale="2"', 'relpose="0 0 0 1 0 0 0"')))
    settings = mjcf_models.SETTINGS.encode()
    if dice.random() < 0.1:
        settings = spoiled_xml(mjcf_models.SETTINGS, dice)
    return {"model.xml": _spoiled_model(text, "</mujoco>", MJCF, dice), "settings.xml": settings}


SDF = (
    "<include><uri>file:///etc/passwd</uri></include>", "<include><uri>model://../../etc</uri></include>",
    "<include><uri>machine.sdf</uri></include>", '<frame name="a" attached_to="b"/><frame name="b" attached_to="a"/>',
    '<frame name="a"><pose relative_to="a">0 0 0 0 0 0</pose></frame>',
    '<model name="machine"><link name="base"/></model>',
    '<link name="far"><pose relative_to="far">1 0 0 0 0 0</pose></link>', "<model>" * 20_000 + "</model>" * 20_000,
    '<plugin name="x" filename="/bin/sh"/>',
    '<joint name="x" type="revolute2"><parent>base</parent><child>rod</child></joint>',
    '<joint name="self" type="revolute"><parent>rod</parent><child>rod</child></joint>', "<static>true</static>",
    '<joint name="g" type="gearbox"><parent>crank</parent><child>rocker</child>'
    '<gearbox_ratio>nan</gearbox_ratio></joint>',
    '<pose degrees="true">0 0 0 90 0 0</pose>', '<pose rotation_format="quat_xyzw">0 0 0 0 0 0 0</pose>',
    '<link name="l"><visual name="v"><geometry><mesh><uri>/etc/passwd</uri></mesh></geometry></visual></link>',
    '<link name="crank"/>', "".join(f'<link name="n{i}"/>' for i in range(5_000)), "<self_collide>x</self_collide>",
    '<joint name="y" type="revolute"><parent>world</parent><child>rod</child><axis><xyz>0 0 0</xyz></axis></joint>',
)  # fmt: skip
"""The same of SDF."""


def sdfs(dice: Dice) -> Files:
    """A model in SDF that is spoiled."""
    return {"machine.sdf": _spoiled_model(sdf_model(), "</model></sdf>", SDF, dice)}


def sdf_model() -> str:
    """Return a four-bar whose rod has two parents."""

    def link(name: str, pose: str, mass: float) -> str:
        inertia = "<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz><ixy>0.001</ixy></inertia>"
        inertial = f"<inertial><pose>0.1 0.02 0.03 0.1 0.2 0.3</pose><mass>{mass}</mass>{inertia}</inertial>"
        return f'<link name="{name}"><pose>{pose}</pose>{inertial}</link>'

    def joint(name: str, parent: str, child: str, pose: str = "0 0 0 0 0 0") -> str:
        ends = f"<pose>{pose}</pose><parent>{parent}</parent><child>{child}</child>"
        axis = "<axis><xyz>0 0 1</xyz><limit><lower>-3</lower><upper>3</upper><effort>9</effort></limit></axis>"
        return f'<joint name="{name}" type="revolute">{ends}{axis}</joint>'

    links = link("base", "0 0 0.1 0 0 0", 1.0) + link("crank", "0 0 0.1 0 0 1.5707963267948966", 1.0)
    links += link("rod", "0 0.2 0.1 0 0 0", 0.5) + link("rocker", "0.5 0 0.1 0 0 1.5707963267948966", 0.7)
    joints = joint("crank", "base", "crank") + joint("elbow", "crank", "rod") + joint("foot", "base", "rocker")
    pin = joint("pin", "rod", "rocker", "0.2 0 0 0 0 0")
    return f'<sdf version="1.6"><model name="machine">{links}{joints}{pin}</model></sdf>'


def _spoiled_model(text: str, end: str, more: tuple[str, ...], dice: Dice) -> bytes:
    kind = dice.random()
    if kind < 0.65:
        return spoiled_xml(text, dice)
    if kind < 0.75:
        return spoiled_bytes(text.encode(), dice)
    if kind < 0.95:
        return text.replace(end, dice.choice(more) + end).encode()
    return (dice.choice(FOREIGN_XML) + text).encode()


XACRO = (
    '<xacro:include filename="{file}"/>', '<xacro:include filename="/etc/passwd"/>',
    '<xacro:include filename="nowhere.xacro"/>',
    '<xacro:property name="a" value="${{b}}"/><xacro:property name="b" value="${{a}}"/><link name="${{a}}"/>',
    '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    '<xacro:if value="${{expression}}"><link name="x"/></xacro:if>', '<link name="$(arg nothing)"/>',
    '<link name="$(find nowhere)"/>', '<link name="$(env HOME)"/>', '<link name="$(eval 1 + 1)"/>',
    '<link name="$(optenv HOME /)"/>', '<link name="$(cwd)"/>', '<xacro:call macro="nothing"/>', '<xacro:nothing/>',
    '<xacro:insert_block name="x"/>', '<xacro:arg name="base_distance" default="2"/>',
    '<xacro:macro name="p" params="a:=${{9**9**9}}"/><xacro:p/>',
    '<xacro:property name="big" value="${{[0] * 10**9}}"/>',
    '<xacro:property name="y" value="${{load_yaml(\'/etc/passwd\')}}"/>',
    '<xacro:element xacro:name="link" name="q"/>', '<xacro:attribute name="x" value="1"/>',
    '<xacro:unless value="maybe"/>',
)  # fmt: skip


def xacros(dice: Dice) -> Files:
    """A xacro that is spoiled, with its shipped declaration."""
    name = dice.choice(zoo.SHIPPED)
    text, file = xacro_of(name), f"{name}.urdf.xacro"
    kind = dice.random()
    if kind < 0.35:
        pieces = text.split("${")
        at = dice.randrange(1, len(pieces))
        inside, brace, after = pieces[at].partition("}")
        expression = (
            dice.choice(EXPRESSIONS).replace("<", "&lt;").replace('"', "'").replace("&l", "&l").replace("\x00", "")
        )
        pieces[at] = (
            (expression if dice.random() < 0.7 else inside + dice.choice(("+", "*0", "/0", "**999", "[0]", ".real")))
            + brace
            + after
        )
        spoiled = "${".join(pieces).encode()
    elif kind < 0.6:
        spoiled = spoiled_xml(text, dice)
    elif kind < 0.75:
        put = dice.choice(XACRO).format(file=file, expression=dice.choice(EXPRESSIONS[:6]))
        spoiled = text.replace("</robot>", put + "</robot>").encode()
    elif kind < 0.85:
        spoiled = text.replace('default="', f'default="{dice.choice(NUMBERS[:30])}', 1).encode()
    elif kind < 0.97:
        spoiled = spoiled_bytes(text.encode(), dice)
    else:
        spoiled = _rare_xml(text, dice)
    return {"robot.yaml": declaration_of(name).encode(), file: spoiled}


HEADERS = (
    "x00", "x٣", "x99999999999999999999", "", "t", " t ", "xd", "x-1", "x1.0", "\x00", "X0", "s0", "sd0", "x" * 70_000,
    "x" + HUGE, "x7",
)  # fmt: skip


def motions(dice: Dice) -> Files:
    """A motion as CSV that is spoiled."""
    return {"motion.csv": spoiled_motion(motion_csv(dice.choice(("2rpr", "3rrr", "gough", "four_bar"))), dice)}


def spoiled_motion(text: str, dice: Dice) -> bytes:
    """Return a motion as CSV with cells, rows or columns wrong, or that is none."""
    cells = [line.split(",") for line in text.splitlines()]
    kind = dice.random()
    if kind < 0.6:
        for _ in range(dice.choice((1, 1, 2))):
            row, column = dice.randrange(1, len(cells)), dice.randrange(len(cells[0]))
            done = dice.randrange(10)
            if done == 0:
                cells[0][column] = dice.choice(HEADERS)
            elif done <= 3:
                cells[row][min(column, len(cells[row]) - 1)] = dice.choice(NUMBERS)
            elif done == 4 and len(cells[row]) > 1:
                cells[row].pop()
            elif done == 5:
                cells[row].append("1")
            elif done == 6 and len(cells) > 3:
                del cells[row]
            elif done == 7:
                cells.insert(dice.randrange(1, len(cells) + 1), list(cells[row]))
            elif done == 8:
                dice.shuffle(cells[0])
            else:
                cells = [[value for i, value in enumerate(line) if i != column] or [""] for line in cells]
        return "\n".join(map(",".join, cells)).encode("utf-8", "surrogatepass")
    if kind < 0.7:
        which = dice.randrange(3)
        for line in cells[1:] if which else ():
            line[which - 1] = ("0.0", repr(1000.0 * float(line[1])))[which - 1]  # times that stand, other units
        return "\n".join(map(",".join, cells if which else [cells[0], *cells[:0:-1]])).encode()
    if kind < 0.93:
        return spoiled_bytes(text.encode(), dice)
    return dice.choice(
        (
            lambda: b"",
            lambda: text.encode("utf-16"),
            lambda: b"\x00" * 10**6,
            lambda: dice.randbytes(10**5),
            lambda: b"t," + b"x" * 10**7 + b"\n1,2\n",
            lambda: b'"' + text.encode(),
            lambda: text.splitlines()[0].encode(),
            lambda: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(),
            lambda: text.replace(",", ";").encode(),
            lambda: (",".join(f"c{i}" for i in range(20_000)) + "\n" + "1," * 20_000 + "\n").encode(),
        )
    )()


PROBLEM = {
    "planner": "switch-off",
    "robot": "2rpr",
    "set": {"carrier_mass": 2.0},
    "working_mode": "++",
    "gravity": [0, 0, 0],
    "backend": "rnea",
    "motion": {"name": "circle", "speed": 0.5},
    "parameters": {"threshold": 7, "dt": 0.01},
}
CORNER = {
    "planner": "stepwise",
    "robot": "3rrr",
    "working_mode": "+++",
    "backend": "virtual-work",
    "motion": {"name": "corner", "radius": 0.02, "speed": 0.3},
    "parameters": {"dt": 0.02, "lam": 0.5},
    "baseline": {"set": {"carriers": False}},
}
WHOLE = {
    "planner": "whole-trajectory",
    "robot": "2rpr",
    "motion": "motion.csv",
    "parameters": {"objective": {"effort": 1.0, "peak": 0.1}, "track": [-0.1, 0.1], "dt": 0.05, "starts": 2},
}


def problems(dice: Dice) -> Files:
    """A problem file that is spoiled."""
    return {
        "problem.yaml": spoiled_problem(dice.choice((PROBLEM, CORNER, WHOLE)), dice),
        "motion.csv": motion_csv("2rpr").encode(),
    }


def spoiled_problem(data: Any, dice: Dice) -> bytes:
    """Return a problem as YAML with something wrong with it."""
    kind = dice.random()
    text = yaml.safe_dump(data, sort_keys=False)
    if kind < 0.7:
        return yaml_text(data, dice)
    if kind < 0.85:
        return spoiled_lines(text, dice).encode("utf-8", "surrogatepass")
    return spoiled_bytes(text.encode(), dice) if kind < 0.95 else _rare_yaml(text, dice)
