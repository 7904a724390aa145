"""What a model of MuJoCo leaves out of force, judged by MuJoCo: flags, defaults, empty ranges, zero quaternions."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from mjcf_models import FOUR_BAR, write

import redundancy_pin as rp
from redundancy_pin import load_robot
from redundancy_pin.errors import DeclarationError, ModelFileError, UnsupportedRobotError
from redundancy_pin.robot.formats import mjcf_file
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE
from redundancy_pin.robot.formats.mjcf import read_mjcf
from redundancy_pin.robot.formats.mjcf_file import MOST_INCLUDED
from redundancy_pin.robot.formats.urdf_tree import MOST_FREEDOMS

mujoco = pytest.importorskip("mujoco")

MODEL = """<mujoco><compiler angle="radian" {compiler}/>{first}
<worldbody>
  <body name="a"><joint name="j" axis="0 1 0" {joint}/><geom size="0.1" pos="0.2 0 0"/></body>
  <body name="b" pos="1 0 0"><joint name="k" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>
</worldbody>{last}
<actuator><motor joint="k" {motor}/></actuator></mujoco>"""

FORCES = 'stiffness="10" damping="3" frictionloss="2" springref="0.3"'
CONNECT = '<equality><connect {} body1="a" body2="b" anchor="0.5 0 0"/></equality>'


def _model(first="", *, joint="", last="", motor="", compiler=""):
    return MODEL.format(first=first, joint=joint, last=last, motor=motor, compiler=compiler)


def _refused(text):
    """Whether MuJoCo refuses a model."""
    try:
        mujoco.MjModel.from_xml_string(text)
    except ValueError:
        return True
    return False


def test_a_model_that_does_not_move_is_refused(tmp_path):
    # two hinges, and a pin that takes both freedoms
    text = FOUR_BAR.replace('<joint name="elbow" class="main"/>', "")
    with pytest.raises(
        DeclarationError, match="four_bar does not move: 2 joint velocities less 2 closure rows leave 0"
    ):
        load_robot(write(tmp_path, text))


@pytest.mark.parametrize("kind", ["pin", "gear"])
def test_equalities_are_no_more_than_freedoms_can_be(kind, tmp_path):
    """Each took time, and thousands took ten seconds before the file was refused."""
    one = {
        "pin": '<connect name="pin" site1="tip" site2="end"/>',
        "gear": '<joint joint1="crank" joint2="rocker" polycoef="0 0.5"/>',
    }[kind]
    more = one.replace('name="pin" ', "") * (MOST_FREEDOMS - 1)
    text = FOUR_BAR.replace("</equality>", f"{more}</equality>")
    assert len(read_mjcf(write(tmp_path, text)).closures) == {"pin": MOST_FREEDOMS, "gear": 1}[kind]
    with pytest.raises(ModelFileError, match=f"a {one[1:].split()[0]} is one more than the {MOST_FREEDOMS}"):
        read_mjcf(
            write(tmp_path, text.replace("</equality>", f"{more[: len(more) // (MOST_FREEDOMS - 1)]}</equality>"))
        )


def _spring_and_damper(text, q, v):
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = q, v
    mujoco.mj_forward(model, data)
    friction = data.efc_frictionloss[data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF]
    return data.qfrc_passive[0], friction.sum()


@pytest.mark.parametrize(
    "options",
    [
        "",
        '<option><flag spring="disable"/></option>',
        '<option><flag damper="disable"/></option>',
        '<option><flag frictionloss="disable"/></option>',
        '<option><flag spring="disable" damper="disable" frictionloss="disable"/></option>',
        '<option><flag spring="disable"/></option><option><flag spring="enable" energy="enable"/></option>',
        '<option><flag spring="disable"/></option><option><flag damper="disable"/></option>',
    ],
)
def test_flags_disable_springs_dampers_and_friction(options, tmp_path):
    text = _model(options, joint=FORCES)
    mechanism = read_mjcf(write(tmp_path, text))
    for q, v in ((0.7, 0.0), (0.3, 0.4), (-0.2, -1.1)):
        passive, friction = _spring_and_damper(text, q, v)
        ours = sum(-load.stiffness * (q - load.rest) - load.damping * v for load in mechanism.forces)
        assert ours == pytest.approx(passive)
        assert sum(load.friction for load in mechanism.forces) == pytest.approx(friction)
    assert any("Disabled by flags" in note for note in mechanism.notes) == (
        "disable" in options and "enable" not in options
    )


@pytest.mark.parametrize("options", ['gravity="disable"', 'gravity="enable"', 'gravity="disable" spring="disable"'])
def test_of_several_flags_the_last_counts(options, tmp_path):
    text = _model(f'<option gravity="0 0 -3"><flag gravity="disable"/></option><option><flag {options}/></option>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    own = read_mjcf(write(tmp_path, text)).model("x")
    np.testing.assert_allclose(pin.rnea(own, own.createData(), np.zeros(2), np.zeros(2), np.zeros(2)), data.qfrc_bias)


def test_flags_are_those_of_mujoco(tmp_path):
    named = {"enable": mujoco.mjtDisableBit.__members__, "disable": mujoco.mjtEnableBit.__members__}
    flags = [f'{bit.split("_")[1].lower()}="{word}"' for word, bits in named.items() for bit in bits if "_" in bit]
    assert len(flags) > 20
    for flag in flags:  # as they are when nothing is said
        text = _model(f"<option><flag {flag}/></option>")
        assert not _refused(text)
        read_mjcf(write(tmp_path, text))


DEFAULT = "<default>{}</default>"
REFUSED = {
    "flag": (_model('<option><flag sprig="disable"/></option>'), "no flag 'sprig'.*mean 'spring'"),
    "word": (_model('<option><flag spring="off"/></option>'), "spring='off'.*enable, disable"),
    "option": (_model("<option><flags/></option>"), "<flags> is not covered"),
    "default": (_model(DEFAULT.format('<connect active="false"/>')), "<connect> has no defaults"),
    "joint": (_model(joint='range="0 0" limited="true"'), "the joint 'j' has limited and the empty range 0 0"),
    "range": (_model(joint='range="1 0" limited="true"'), "empty range 1 0"),
    "no range": (_model(joint='limited="true"'), "empty range"),
    "force": (_model(motor='forcerange="0 0" forcelimited="true"'), "empty forcerange"),
    "autolimits": (_model(joint='range="1 0"', compiler='autolimits="false"'), "Say limited"),
    "springdamper": (_model(joint='springdamper="0.1 0"'), "springdamper='0.1 0'.*positive"),
    "one springdamper": (_model(joint='springdamper="0.1"'), "not 2 finite"),
    "body": (_model().replace('pos="1 0 0"', 'quat="0 0 0 0"'), "quat of length zero"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_mujoco_refuses_is_refused_by_name(case, tmp_path):
    text, message = REFUSED[case]
    assert _refused(text)
    with pytest.raises(ModelFileError, match=message):
        read_mjcf(write(tmp_path, text))


@pytest.mark.parametrize("flag", ["equality", "constraint"])
def test_loops_that_a_flag_opens_are_refused(flag, tmp_path):
    text = _model(f'<option><flag {flag}="disable"/></option>', last=CONNECT.format(""))
    with pytest.raises(ModelFileError, match=f"line 1: the flag {flag}=disable.*loops would be open"):
        read_mjcf(write(tmp_path, text))


@pytest.mark.parametrize(
    ("defaults", "said"),
    [
        ("", ""),
        ('<equality active="false"/>', ""),
        ('<equality active="false"/>', 'active="true"'),
        ('<default class="open"><equality active="false"/></default>', 'class="open"'),
        ('<default class="open"><equality active="false"/></default>', ""),
        ('<equality active="false"/><default class="shut"><equality active="true"/></default>', 'class="shut"'),
    ],
)
def test_defaults_of_equalities(defaults, said, tmp_path):
    text = _model(DEFAULT.format(defaults), last=CONNECT.format(said))
    active = mujoco.MjModel.from_xml_string(text).eq_active0
    mechanism = read_mjcf(write(tmp_path, text))
    assert len(mechanism.closures) == active.sum()
    assert any("is not active" in note for note in mechanism.notes) == (not active.all())


@pytest.mark.parametrize("contype", [None, 0, 2])
@pytest.mark.parametrize("conaffinity", [None, 0, 2])
def test_contacts_are_named_where_geoms_may_collide(contype, conaffinity, tmp_path):
    given = {"contype": contype, "conaffinity": conaffinity}
    said = " ".join(f'{name}="{value}"' for name, value in given.items() if value is not None)
    text = _model().replace("<geom ", f"<geom {said} ")
    loaded = mujoco.MjModel.from_xml_string(text)
    may = (loaded.geom_contype | loaded.geom_conaffinity).any()
    assert any("Contacts" in note for note in read_mjcf(write(tmp_path, text)).notes) == may


def test_defaults_of_tendons_are_named(tmp_path):
    tendon = '<tendon><fixed name="rope"><joint joint="j" coef="1"/></fixed></tendon>'
    text = _model(DEFAULT.format('<tendon stiffness="5"/>'), last=tendon)
    assert mujoco.MjModel.from_xml_string(text).tendon_stiffness[0] == 5.0
    assert f"{NOT_IN_FORCE} tendons of rope." in read_mjcf(write(tmp_path, text)).notes


@pytest.mark.parametrize("kind", ["motor", "general"])
def test_actuators_have_one_default(kind, tmp_path):
    text = _model(DEFAULT.format(f'<{kind} forcerange="-2 2"/>'))
    (joint,) = (joint for joint in read_mjcf(write(tmp_path, text)).joints if joint.name == "k")
    assert joint.limits["effort"] == mujoco.MjModel.from_xml_string(text).actuator_forcerange[0, 1] == 2.0


@pytest.mark.parametrize("length", ["0 0 0 0", "1e-16 0 1e-16 0", "0 1e-14 1e-14 0", "0 0 0 3"])
@pytest.mark.parametrize("joint", ["<freejoint/>", '<joint type="ball"/>'])
def test_quaternions_of_keyframes(joint, length, tmp_path):
    at = "1 2 3 " if "free" in joint else ""
    text = (
        f'<mujoco><worldbody><body name="a">{joint}<geom size="0.1" pos="0.1 0 0"/></body></worldbody>'
        f'<keyframe><key name="k" qpos="{at}{length}"/></keyframe></mujoco>'
    )
    path = write(tmp_path, text)
    engine = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(engine)
    mujoco.mj_resetDataKeyframe(engine, data, 0)
    mujoco.mj_forward(engine, data)
    mechanism = read_mjcf(path, keyframe="k")
    lengths = [np.linalg.norm(value) for value in mechanism.start.values() if isinstance(value, np.ndarray)]
    np.testing.assert_allclose(lengths, 1.0, rtol=1e-15)
    own = mechanism.model("x")
    place = own.createData()
    pin.framesForwardKinematics(own, place, mechanism.configuration(own))
    frame = place.oMf[own.getFrameId("a", pin.FrameType.BODY)]
    np.testing.assert_allclose(frame.translation, data.body("a").xpos, atol=1e-12)
    np.testing.assert_allclose(frame.rotation, data.body("a").xmat.reshape(3, 3), atol=1e-12)


@pytest.mark.parametrize(
    ("numbers", "compiler"), [("0 0", ""), ("1 1", ""), ("1 0", ""), ("-2 3", ""), ("0 0", 'autolimits="false"')]
)
def test_empty_ranges_count_as_none(numbers, compiler, tmp_path):
    text = _model(
        joint=f'range="{numbers}" actuatorfrcrange="{numbers}"',
        motor=f'forcerange="{numbers}" ctrlrange="{numbers}"',
        compiler=compiler,
    )
    model = mujoco.MjModel.from_xml_string(text)
    limits = {joint.name: joint.limits for joint in read_mjcf(write(tmp_path, text)).joints}
    assert np.isfinite(limits["j"]["upper"]) == np.isfinite(limits["j"]["lower"]) == model.jnt_limited[0]
    assert np.isfinite(limits["j"]["effort"]) == model.jnt_actfrclimited[0]
    assert np.isfinite(limits["k"]["effort"]) == model.actuator_forcelimited[0] == model.actuator_ctrllimited[0]


@pytest.mark.parametrize(
    ("motors", "driven"),
    [
        ([(2, "-1 3", "")], ""),
        ([(-2, "-1 3", "")], ""),
        ([(2, "-5 5", "-3 1")], ""),
        ([(2, "-5 5", "")], "-4 3"),
        ([(2, "0 3", "")], ""),
        ([(2, "-3 3", "1 2")], ""),
        ([(-2, "-3 3", "1 2")], ""),
        ([(2, "0 3", ""), (-2, "0 3", "")], ""),  # one pulls, the other pushes
    ],
)
def test_limits_of_efforts_are_what_mujoco_reaches(motors, driven, tmp_path):
    text = _model().replace('name="k"', f'name="k" actuatorfrcrange="{driven}"' if driven else 'name="k"')
    lines = [
        f'<motor joint="k" gear="{gear}" ctrlrange="{control}"' + (f' forcerange="{force}"/>' if force else "/>")
        for gear, control, force in motors
    ]
    text = text.replace('<motor joint="k" />', "".join(lines))
    engine = mujoco.MjModel.from_xml_string(text)
    data, reached = mujoco.MjData(engine), []
    for control in ((-9.0, 9.0), (9.0, -9.0)):
        data.ctrl[:] = control[: engine.nu]
        mujoco.mj_forward(engine, data)
        reached.append(data.qfrc_actuator[1])
    path = write(tmp_path, text)
    robot = rp.load_robot(path)
    assert robot.effort_limits[:, robot.actuated.index("k")].tolist() == sorted(reached)
    notes = [note for note in robot.notes if note.startswith("Efforts of k")]
    assert len(notes) == (sum(reached) != 0.0)
    again = rp.load_robot(robot.to_mjcf(tmp_path / "again.xml"))
    assert again.effort_limits[:, again.actuated.index("k")].tolist() == sorted(reached)
    if sum(reached) != 0.0:
        with pytest.raises(UnsupportedRobotError, match=r"one limit of effort, the same both ways.*'k'"):
            robot.to_urdf(tmp_path / "k.urdf")
        robot.with_limits({"k": {"effort": 2.0}}).to_urdf(tmp_path / "k.urdf")


def test_an_empty_range_replaces_one_by_default(tmp_path):
    text = _model(DEFAULT.format('<joint range="-1 1"/>'), joint='range="0 0"')
    limits = {joint.name: joint.limits for joint in read_mjcf(write(tmp_path, text)).joints}
    limited = mujoco.MjModel.from_xml_string(text).jnt_limited
    assert [bool(np.isfinite(limits[name]["upper"])) for name in "jk"] == limited.tolist() == [False, True]


@pytest.mark.parametrize("law", ["0.1 1", "0 0"])
@pytest.mark.parametrize("flags", ["", 'spring="disable"', 'spring="disable" damper="disable"'])
def test_springdamper_takes_the_place_of_both(law, flags, tmp_path):
    """Of the inertia of the model: not in force here, and said so; those that it replaces are not either."""
    text = _model(f"<option><flag {flags}/></option>", joint=f'{FORCES} springdamper="{law}"')
    model = mujoco.MjModel.from_xml_string(text)
    replaced = model.jnt_stiffness[0] != 10.0
    assert replaced == (law == "0.1 1") == (model.dof_damping[0] != 3.0)
    mechanism = read_mjcf(write(tmp_path, text))
    (load,) = mechanism.forces
    assert load.friction == 2.0
    assert load.stiffness == (0.0 if replaced or "spring" in flags else 10.0)
    assert load.damping == (0.0 if replaced or "damper" in flags else 3.0)
    noted = f"{NOT_IN_FORCE} springdamper of j." in mechanism.notes
    assert noted == (replaced and _spring_and_damper(text, 0.9, 1.0)[0] != 0.0)


def _general(law):
    return _model('<option timestep="0.01"/>').replace('<motor joint="k" />', f'<general joint="k" {law}/>')


@pytest.mark.parametrize(
    "law",
    [
        'gear="2" gainprm="3" ctrlrange="-1 2"',
        'gear="2" gainprm="3" gaintype="affine" biasprm="0.5" biastype="affine" ctrlrange="-1 2"',
        'gainprm="-3" biasprm="0.5 -7 -8" ctrlrange="-1 2"',  # biastype none: no bias
        'gainprm="3 5 6" ctrlrange="-1 2"',  # gaintype fixed: one gain
        'gear="2" gainprm="3" dyntype="filter" dynprm="0.01" ctrlrange="-1 2"',
        'gainprm="3" dyntype="filterexact" dynprm="0.01" ctrlrange="-1 2" actrange="-0.5 4" forcerange="-9 4"',
        'gainprm="3" dyntype="integrator" ctrlrange="-99 99" actrange="-0.2 0.3"',
        'gainprm="0" biasprm="2" biastype="affine"',
    ],
)
def test_limits_of_general_actuators_are_what_mujoco_reaches(law, tmp_path):
    """At the end of forty time constants of the activation, without a law of position or speed."""
    engine = mujoco.MjModel.from_xml_string(_general(law))
    reached = []
    for control in (-9.0, 9.0):
        data = mujoco.MjData(engine)
        data.ctrl[:] = control
        for _ in range(40):
            mujoco.mj_step(engine, data)
        mujoco.mj_forward(engine, data)
        reached.append(data.qfrc_actuator[1])
    robot = rp.load_robot(write(tmp_path, _general(law)))
    np.testing.assert_allclose(robot.effort_limits[:, robot.actuated.index("k")], sorted(reached), rtol=1e-12)
    assert not any(note.startswith("Servos") for note in robot.notes)


@pytest.mark.parametrize(
    ("law", "servo"),
    [
        ('gainprm="90" biasprm="0 -90 -9" biastype="affine" ctrlrange="-1 1"', True),
        ('gainprm="9 0 -1" gaintype="affine" ctrlrange="-1 1"', True),
        ('gainprm="9" dyntype="integrator" ctrlrange="-1 1"', False),
        ('gainprm="9" ctrlrange="-1 1" ctrllimited="false"', False),
    ],
)
def test_general_actuators_whose_controls_bound_no_force(law, servo, tmp_path):
    """Servos are named; an activation without range is bounded by no control."""
    robot = rp.load_robot(write(tmp_path, _general(law)))
    assert np.isinf(robot.effort_limits[:, robot.actuated.index("k")]).all()
    assert any(note.startswith("Servos count") and note.endswith(" k.") for note in robot.notes) is servo


@pytest.mark.parametrize("law", ['dyntype="muscle"', 'gaintype="muscle"', 'biastype="muscle"', 'dyntype="user"'])
def test_general_muscles_are_refused(law, tmp_path):
    with pytest.raises(ModelFileError, match="which is not covered"):
        rp.load_robot(write(tmp_path, _general(law)))


def test_included_files_are_counted_and_weighed(tmp_path, monkeypatch):
    """A hundred beside the model itself, and no more bytes of them than three models may have."""
    parts = [f'<include file="part_{i}.xml"/>' for i in range(MOST_INCLUDED + 1)]
    for i in range(len(parts)):
        (tmp_path / f"part_{i}.xml").write_text(f'<mujoco><site name="at_{i}"/></mujoco>')
    text = FOUR_BAR.replace("<worldbody>", "<worldbody>{}")
    most = read_mjcf(write(tmp_path, text.replace("{}", "".join(parts[:-1]))))
    assert {f"at_{i}" for i in range(MOST_INCLUDED)} <= set(most.links)
    with pytest.raises(ModelFileError, match=f"more than {MOST_INCLUDED} files"):
        read_mjcf(write(tmp_path, text.replace("{}", "".join(parts))))
    path = write(tmp_path, text.replace("{}", "".join(parts[:2])))
    total = sum(file.stat().st_size for file in (path, tmp_path / "part_0.xml", tmp_path / "part_1.xml"))
    monkeypatch.setattr(mjcf_file, "MOST_BYTES", -(-total // 3))
    read_mjcf(path)
    monkeypatch.setattr(mjcf_file, "MOST_BYTES", (total - 1) // 3)
    with pytest.raises(ModelFileError, match=f"{3 * ((total - 1) // 3)} bytes of them"):
        read_mjcf(path)
