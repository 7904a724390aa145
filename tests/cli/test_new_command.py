"""``new``: from a URDF to a declaration that loads, with nothing asked."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import call, refused

import redundancy_pin as rp

GUIDE = Path(__file__).parents[2] / "docs/guide/own_robot.md"


@pytest.fixture
def urdf(tmp_path):
    """The four-bar of the guide, which does not close at zero."""
    path = tmp_path / "crank_drive.urdf"
    path.write_text(re.search(r"<robot .*?</robot>\n", GUIDE.read_text(encoding="utf-8"), re.DOTALL)[0])
    return path


def test_what_is_written_loads_and_moves(urdf):
    text = call("new", urdf).stdout
    assert "n = 1, m = 1, 1 closure(s)" in text
    robot = rp.load_robot(urdf.parent)
    (closure,) = robot.closures
    assert ({closure.frame_a, closure.frame_b}, closure.axes) == ({"coupler_tip", "rocker_tip"}, ("x", "y"))
    # lengths by hand: a crank of 0.1, a coupler of 0.3, a rocker of 0.2 on a base of 0.3
    q = dict(zip(list(robot.model.names)[1:], robot.q_reference, strict=True))
    coupler = q["crank"] + q["knee"]
    tip = 0.1 * np.exp(1j * q["crank"]) + 0.3 * np.exp(1j * coupler)
    assert tip == pytest.approx(0.3 + 0.2 * np.exp(1j * q["rocker"]), abs=1e-10)
    x = np.array([[q[robot.actuated[0]]]])
    motion = rp.PlatformMotion([0.0], x, np.ones_like(x), np.ones_like(x))
    assert np.isfinite(rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau).all()
    comments = (urdf.parent / "robot.yaml").read_text()
    assert "only two links that carry nothing" in comments
    assert "as many joints as freedoms, those with limits first; choose" in comments
    assert "is there already" in refused("new", urdf)


def test_frames_that_coincide_and_transmissions(urdf, tmp_path):
    text = urdf.read_text()
    # the tips are where the pin is when all joints are at zero: the coupler points 0.5 rad upwards, the rocker along x
    tip = 0.1 + 0.3 * np.exp(0.5j)
    text = text.replace(
        'link="coupler"/><origin xyz="0.1 0 0"/>', 'link="coupler"/><origin xyz="0.1 0 0" rpy="0 0 0.5"/>'
    )
    foot = f'<origin xyz="{float(tip.real - 0.2)!r} {float(tip.imag)!r} 0"/>'
    text = text.replace('<child link="rocker"/><origin xyz="0.3 0 0"/>', f'<child link="rocker"/>{foot}')
    text = text.replace(
        "</robot>",
        '<transmission name="t"><joint name="rocker"/></transmission><link name="mark"/>\n'
        '<joint name="marked" type="fixed"><parent link="crank"/><child link="mark"/></joint></robot>',
    )
    urdf.write_text(text)
    out = tmp_path / "other" / "own.yaml"
    out.parent.mkdir()
    facts = json.loads(call("new", urdf, "--out", out, "--json").stdout)
    assert facts["actuated"] == ["rocker"]
    assert facts["independent"] == ["rocker"]
    assert set(facts["closures"][0]["frames"]) == {"coupler_tip", "rocker_tip"}
    assert rp.load_robot(out).actuated == ("rocker",)
    assert "they coincide when all joints are at zero" in out.read_text()


def test_what_it_cannot_know_is_said(urdf, tmp_path):
    """Of three links at one point two are paired; references out of range are named. Transmissions drive joints."""
    text = urdf.read_text()
    place = "".join(f'<link name="{name}"/>' for name in ("here", "there")) + "".join(
        f'<joint name="{name}_end" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{x} 0 0"/></joint>'
        for name, parent, x in (("here", "base", 0.4), ("there", "crank", 0.4))
    )
    urdf.write_text(text.replace("</robot>", '<transmission name="t"><joint name="no joint"/></transmission></robot>'))
    assert "drives 'no joint', which is no joint that moves" in " ".join(call("new", urdf).stderr.split())
    text = text.replace("</robot>", f"{place}</robot>")
    urdf.write_text(text.replace('lower="-100"', 'lower="0.5"', 1))
    run = call("new", urdf)
    written = (tmp_path / "robot.yaml").read_text()
    for said in (
        "'coupler_tip' is where 'here' and 'there' are",
        "The reference is out of the range of crank",
    ):
        assert said in " ".join(run.stderr.split()), run.stderr
        assert f"# Doubtful: {said}" in written
    assert rp.load_robot(tmp_path / "robot.yaml").n >= 1


MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
SLIDER = f"""<robot name="slider"><link name="base"/><link name="crank">{MASS}</link><link name="rod">{MASS}</link>
<link name="slider">{MASS}</link><link name="end"/><link name="mark"/>
<joint name="crank" type="continuous"><parent link="base"/><child link="crank"/><axis xyz="0 0 1"/></joint>
<joint name="pin" type="continuous"><parent link="crank"/><child link="rod"/><origin xyz="0 0.3 0"/>
<axis xyz="0 0 1"/></joint>
<joint name="slide" type="prismatic"><parent link="base"/><child link="slider"/><origin xyz="0.4 0 0"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
<joint name="ends" type="fixed"><parent link="rod"/><child link="end"/><origin xyz="0.4 -0.3 0"/></joint>
<joint name="marks" type="fixed"><parent link="rod"/><child link="mark"/></joint></robot>"""


def test_a_pin_that_is_marked_on_one_link(tmp_path):
    """And a mark on a link's own pin, which closes nothing."""
    path = tmp_path / "slider.urdf"
    path.write_text(SLIDER)
    facts = json.loads(call("new", path, "--json").stdout)
    assert facts["closures"] == [{"frames": ["end", "slider"], "axes": ["x", "y"]}]
    assert facts["actuated"] == facts["independent"] == ["slide"]  # the joint with limits
    path.write_text(SLIDER.replace('effort="9"', 'effort="0"'))  # which is none of a motor
    assert json.loads(call("new", path, "--out", tmp_path / "passive.yaml", "--json").stdout)["actuated"] == ["pin"]
    # exporters give marks a little mass, and round
    text = SLIDER.replace('<link name="end"/>', f'<link name="end">{MASS.replace("1", "1e-9")}</link>')
    path.write_text(text.replace("0.4 -0.3 0", "0.400003 -0.3 0"))
    assert json.loads(call("new", path, "--out", tmp_path / "light.yaml", "--json").stdout)["closures"]
    path.write_text(SLIDER.replace("0.4 -0.3 0", "0.4 -0.2 0"))  # closes, but not at zero
    printed = call("new", path, "--out", tmp_path / "far.yaml").stdout
    assert "no two frames coincide" in printed
    assert "which are one point: end, mark" in printed


def mechanism(path, right_end=0.4, more=""):
    """A five-bar with marks at the ends of both chains, the left one by chance on the last link of the right."""
    weight = (
        '<inertial><mass value="0.5"/><inertia ixx="1e-4" iyy="5e-3" izz="5e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = "".join(f'<link name="{side}_{part}">{weight}</link>' for side in "lr" for part in ("near", "far"))
    limit = '<axis xyz="0 0 1"/><limit lower="-7" upper="7" velocity="20" effort="100"/>'

    def joint(name, kind, parent, x, end=""):
        of = f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{name}"/>'
        return f'{of}<origin xyz="{x} 0 0"/>{end}</joint>'

    joints = [
        *(joint(f"{side}_near", "revolute", "base", x, limit) for side, x in (("l", 0.0), ("r", 0.4))),
        *(joint(f"{side}_far", "revolute", f"{side}_near", 0.3, limit) for side in "lr"),
        joint("l_tip", "fixed", "l_far", 0.4),
        joint("r_tip", "fixed", "r_far", right_end),
    ]
    tips = '<link name="base"/><link name="l_tip"/><link name="r_tip"/>'
    path.write_text(f'<robot name="mech">{tips}{links}{"".join(joints)}{more}</robot>')
    return path


@pytest.mark.parametrize("marks", [("r_tip",), ("r_tip", "third")])
def test_a_mark_that_may_be_on_a_link_by_chance_is_doubted(tmp_path, marks):
    """Drawn with its loop closed it is a pin; of chains that only lie so at zero the other mark may be meant."""
    third = (
        '<link name="third"/><joint name="third_joint" type="fixed"><parent link="r_near"/><child link="third"/>'
        '<origin xyz="0.1 0 0"/></joint>'
    )
    more = third if "third" in marks else ""
    facts = json.loads(call("new", mechanism(tmp_path / "mech.urdf", more=more), "--json").stdout)
    assert [set(closure["frames"]) for closure in facts["closures"]] == [{"l_tip", "r_far"}]
    (doubt,) = (doubt for doubt in facts["doubts"] if "by chance" in doubt)
    assert all(name in doubt for name in ("l_tip", "r_far", *marks))


def test_loops_that_lie_in_a_line_at_zero_have_their_reference_beside_it(tmp_path):
    """A four-bar of 0.2, 0.5, 0.2 and 0.5: flat at zero its two branches meet, and one row of its pin is redundant."""
    links = "".join(f'<link name="{name}">{MASS}</link>' for name in ("crank", "coupler", "rocker"))
    turns = '<axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="{}" velocity="9"/>'
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
        f"{turns.format(effort) if kind == 'revolute' else ''}</joint>"
        for name, kind, parent, child, x, effort in (
            ("drive", "revolute", "base", "crank", 0.0, 9),
            ("knee", "revolute", "crank", "coupler", 0.2, 0),
            ("foot", "revolute", "base", "rocker", 0.5, 0),
            ("a", "fixed", "coupler", "tip_a", 0.5, 0),
            ("b", "fixed", "rocker", "tip_b", 0.2, 0),
        )
    )
    path = tmp_path / "flat.urdf"
    path.write_text(
        f'<robot name="flat"><link name="base"/>{links}<link name="tip_a"/><link name="tip_b"/>{joints}</robot>'
    )
    result = call("new", path)
    assert "n = 1, m = 1, 1 closure(s)" in result.stdout
    assert "lie in a line" in result.stderr
    assert "Doubtful: Where all joints start, loops lie in a line" in (tmp_path / "robot.yaml").read_text()
    robot = rp.load_robot(tmp_path)
    drive, knee, foot = robot.q_reference
    assert abs(drive) > 0.1
    tip = 0.2 * np.exp(1j * drive) + 0.5 * np.exp(1j * (drive + knee))
    assert tip == pytest.approx(0.5 + 0.2 * np.exp(1j * foot), abs=1e-10)


@pytest.mark.parametrize("declared", [False, True])
def test_continuous_joints_that_mimic_count_their_turns(tmp_path, declared):
    """A dial that turns twice as fast as the crank, by the URDF's ``mimic`` or by the declaration's couplings."""
    path, out = tmp_path / "slider.urdf", tmp_path / "robot.yaml"
    mimic = "" if declared else '<mimic joint="crank" multiplier="2" offset="0.1"/>'
    dial = '<link name="dial"/><joint name="dial" type="continuous"><parent link="base"/><child link="dial"/>'
    dial = dial.replace('"dial"/><j', f'"dial">{MASS}</link><j') + f'<axis xyz="0 0 1"/>{mimic}</joint></robot>'
    path.write_text(SLIDER.replace("</robot>", dial))
    if declared:
        out.write_text(
            "urdf: slider.urdf\nclosures: [{frames: [end, slider], axes: [x, y]}]\nactuated: [crank]\n"
            "couplings: [{joint: dial, of: crank, polynomial: [0.1, 2.0]}]\n"
            "independent: {joints: [crank]}\nreference: {joints: {crank: 0.3}}\n"
        )
    else:
        facts = json.loads(call("new", path, "--out", out, "--json").stdout)
        assert [each["polynomial"] for each in facts["couplings"]] == [[0.1, 2.0]]
    robot = rp.load_robot(out)
    crank, dial = (robot.model.joints[robot.model.getJointId(name)].idx_q for name in ("crank", "dial"))
    if declared:
        turns = np.linspace(0.3, 7.0, 60)[:, None]  # the crank is short enough to go round
        q = rp.forward_kinematics(robot, turns).q
        np.testing.assert_allclose(q[:, crank], turns[:, 0], atol=1e-12)
    else:
        q = np.array(robot.q_reference)[None]
    np.testing.assert_allclose(q[:, dial], 0.1 + 2.0 * q[:, crank], atol=1e-12)
    assert robot.with_parameters(masses={"dial": 2.0}).model.nq == robot.model.nq


def test_what_only_rounding_keeps_from_spinning_freely_is_no_dependent_joint(tmp_path):
    """A rod on three hinges for a ball, its end 1e-6 m off the first one's axis, as exporters write it."""
    joints = [
        ("crank", "base", "0 0 0", "0 1 0", '<limit lower="-1" upper="1" effort="9" velocity="9"/>'),
        ("rod_x", "crank", "0 0 0.1", "1 0 0", ""),
        ("rod_y", "rod_x", "0 0 0", "0 1 0", ""),
        ("rod_z", "rod_y", "0 0 0", "0 0 1", ""),
        ("rocker", "base", "0.5 0 0.3", "0 1 0", ""),
    ]
    text = "".join(
        f'<link name="{name}">{MASS}</link><joint name="{name}" type="{"revolute" if limit else "continuous"}">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{at}"/><axis xyz="{axis}"/>{limit}</joint>'
        for name, parent, at, axis, limit in joints
    )
    for name, on, at in (("tip", "rod_z", "0.4 0.000001 0"), ("end", "rocker", "-0.1 0.000001 -0.2")):
        text += f'<link name="{name}"/><joint name="at_{name}" type="fixed"><parent link="{on}"/><child link="{name}"/>'
        text += f'<origin xyz="{at}"/></joint>'
    path = tmp_path / "rod.urdf"
    path.write_text(f'<robot name="rod"><link name="base"/>{text}</robot>')
    facts = json.loads(call("new", path, "--json").stdout)
    (closure,) = facts["closures"]
    assert set(closure["frames"]) == {"tip", "end"}
    assert facts["independent"] == ["crank", "rod_x"]


def test_refusals(urdf, tmp_path):
    assert "no URDF" in refused("new", tmp_path / "model.xml")
    assert "nothing.urdf" in refused("new", tmp_path / "nothing.urdf")
    urdf.write_text('<robot name="still"><link name="base"/></robot>')
    assert "no joint of one freedom" in refused("new", urdf)
