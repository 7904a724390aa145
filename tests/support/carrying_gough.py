"""A Gough platform with a sliding mass on three of its cylinders: a machine of poses that has carriers to plan for."""

from pathlib import Path

from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Robot
from redundancy_pin.robot.urdf import models_root

LEGS = (1, 3, 5)

_CARRIER = """
  <joint name="carrier_{i}" type="prismatic">
    <parent link="cylinder_{i}"/><child link="mass_{i}"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="-0.15" upper="0.15" velocity="2.0" effort="200"/>
  </joint>
  <link name="mass_{i}"><inertial><mass value="2.0"/>
    <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/></inertial></link>
"""


def carrying_gough(folder: Path) -> Robot:
    """Write its files into a folder and load it."""
    root = models_root() / "gough"
    urdf = (root / "gough.urdf.xacro").read_text(encoding="utf-8")
    masses = "".join(_CARRIER.format(i=i) for i in LEGS)
    (folder / "gough.urdf.xacro").write_text(urdf.replace("</robot>", f"{masses}</robot>"), encoding="utf-8")
    declared = (root / "robot.yaml").read_text(encoding="utf-8").replace("name: gough", "name: carrying_gough")
    carriers = "".join(f"  - {{joint: carrier_{i}, acceleration: 20.0}}\n" for i in LEGS)
    (folder / "robot.yaml").write_text(f"{declared}\ncarriers:\n{carriers}", encoding="utf-8")
    return load_robot(folder)
