"""Files and arguments of a robot: each mistake gets one clear error that names it."""

import pytest

from redundancy_pin.errors import InputError, ModelFileError
from redundancy_pin.robot.description import declaration_path, render, resolve_arguments, shipped_robots

XACRO = """<?xml version="1.0"?>
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="2.0"/>
  <xacro:arg name="heavy" default="true"/>
  <xacro:arg name="label" default="auto"/>
  <link name="base"/>
  <xacro:if value="$(arg heavy)">
    <link name="bob"><inertial><mass value="${3 * $(arg length)}"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="fixed"><parent link="base"/><child link="bob"/></joint>
  </xacro:if>
</robot>
"""


@pytest.fixture
def xacro(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text(XACRO)
    return path


def test_arguments_keep_their_defaults_and_kinds(xacro):
    values = resolve_arguments(xacro, {"length": 1})
    assert values == {"length": 1.0, "heavy": True, "label": "auto"}
    assert isinstance(values["length"], float)
    assert resolve_arguments(xacro, {"heavy": "False"})["heavy"] is False
    assert resolve_arguments(xacro, {"label": 0.5})["label"] == 0.5


def test_rendering_uses_the_values(xacro):
    assert 'mass value="4.5"' in render(xacro, resolve_arguments(xacro, {"length": 1.5}))
    assert "bob" not in render(xacro, resolve_arguments(xacro, {"heavy": False}))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"lenght": 1.0}, r"no argument 'lenght'\. Did you mean 'length'\?"),
        ({"length": "long"}, "'length' is 'long'. It must be a finite number"),
        ({"length": "inf"}, "'length' is 'inf'. It must be a finite number"),
        ({"length": float("nan")}, "'length' is nan"),
        ({"length": True}, "'length' is True"),
        ({"length": [1.0, 2.0]}, r"'length' cannot be \[1.0, 2.0\]"),
        ({"heavy": 1.0}, "'heavy' is 1.0. It must be true or false"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(xacro, arguments, message):
    with pytest.raises(InputError, match=message):
        resolve_arguments(xacro, arguments)


def test_an_argument_without_default_must_be_given(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text(XACRO.replace(' default="2.0"', ""))
    with pytest.raises(InputError, match="needs a value for the argument 'length'"):
        resolve_arguments(path, {})
    assert resolve_arguments(path, {"length": 3})["length"] == 3.0


def test_missing_and_broken_files(tmp_path, xacro):
    with pytest.raises(ModelFileError, match="does not exist"):
        resolve_arguments(tmp_path / "no.urdf", {})
    xacro.write_text(XACRO.replace("</robot>", ""))
    with pytest.raises(ModelFileError, match="not well-formed XML"):
        resolve_arguments(xacro, {})
    xacro.write_text(XACRO.replace("3 * $(arg length)", "3 * undefined_name"))
    with pytest.raises(ModelFileError, match=r"xacro cannot render .*undefined_name"):
        render(xacro, resolve_arguments(xacro, {}))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="${3 * $(arg length)}"', 'value="heavy"', "'bob' of r.urdf.xacro has the mass 'heavy'"),
        ('value="${3 * $(arg length)}"', 'value="-1"', "a negative mass, -1 kg"),
        ('izz="1"', 'izz="5"', "principal moments of inertia"),
        ('ixx="1"', 'ixx="nan"', "ixx 'nan', which is not a finite number"),
        ('ixx="1" ', "", "the ixx None"),
    ],
)
def test_masses_and_inertias_that_are_none(xacro, old, new, message):
    xacro.write_text(XACRO.replace(old, new))
    with pytest.raises(ModelFileError, match=message):
        render(xacro, resolve_arguments(xacro, {}))


def test_robots_are_found_by_name_file_and_folder(tmp_path):
    assert {"2rpr", "3rrr", "five_bar", "four_bar", "gough"} <= set(shipped_robots())
    inside = declaration_path("3rrr")
    assert inside.name == "robot.yaml"
    assert declaration_path(inside) == inside
    assert declaration_path(inside.parent) == inside
    with pytest.raises(ModelFileError, match=r"no robot '3rr'\. Did you mean '3rrr'\?"):
        declaration_path("3rr")
    with pytest.raises(ModelFileError, match=r"holds no robot\.yaml"):
        declaration_path(tmp_path)
