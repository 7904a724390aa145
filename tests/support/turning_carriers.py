"""The shipped machines with carriers on turning arms in place of tracks."""

from pathlib import Path

import yaml

MODELS = Path(__file__).parents[2] / "models"
ARM = 0.15
REACH = 1.2
LIMITS = {"speed": 8.0, "track": REACH, "acceleration": 60.0}


def two_rpr(folder, joint="revolute", axis='"0 0 ${across}"'):
    """Write the 2-RPR with a mass on an arm on each leg; return its declaration."""
    track = 'lower="${-track_half_length}" upper="${track_half_length}" velocity="2.5"'
    return _declared(
        folder,
        "2rpr",
        ('<joint name="carrier_${name}" type="prismatic">', f'<joint name="carrier_${{name}}" type="{joint}">'),
        ('<axis xyz="${along} ${across} 0"/>', f"<axis xyz={axis}/>"),
        track,
        '<origin xyz="0 0 0"/>\n        <mass value="${carrier_mass}"/>',
    )


def three_rrr(folder):
    """Write the 3-RRR with a mass on an arm at each elbow; return its declaration."""
    return _declared(
        folder,
        "3rrr",
        ('<joint name="carrier_${i}" type="prismatic">', '<joint name="carrier_${i}" type="revolute">'),
        ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 1"/>'),
        'lower="${-tail_length}" upper="${distal_length}" velocity="1.0"',
        '<origin xyz="0 0 0"/>\n          <mass value="${carrier_mass}"/>',
    )


def _declared(folder, name, joint, axis, track, mass):
    urdf = (MODELS / name / f"{name}.urdf.xacro").read_text()
    turned = f'lower="-{REACH}" upper="{REACH}" velocity="{LIMITS["speed"]}"'
    for old, new in (joint, axis, (track, turned), (mass, mass.replace("0 0 0", f"0 {ARM} 0"))):
        assert urdf.count(old) == 1, old
        urdf = urdf.replace(old, new)
    (folder / "arms.urdf.xacro").write_text(urdf)
    declaration = yaml.safe_load((MODELS / name / "robot.yaml").read_text())
    declaration.pop("closed_form")
    declaration |= {"name": "arms", "urdf": "arms.urdf.xacro"}
    for carrier in declaration["carriers"]:
        carrier["acceleration"] = LIMITS["acceleration"]
    (folder / "robot.yaml").write_text(yaml.safe_dump(declaration))
    return folder / "robot.yaml"
