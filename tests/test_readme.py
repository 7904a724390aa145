"""The README's Python example runs as it is written."""

import re
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


LINKS = (
    ("left_1", "base", "left_base", "revolute", "0 0 0"),
    ("left_2", "left_1", "left_elbow", "revolute", "0.4 0 0"),
    ("left_tip", "left_2", "left_mount", "fixed", "0.5 0 0"),
    ("right_1", "base", "right_base", "revolute", "0.5 0 0"),
    ("right_2", "right_1", "right_elbow", "revolute", "0.4 0 0"),
    ("right_tip", "right_2", "right_mount", "fixed", "0.5 0 0"),
)


def write_own_robot(folder, declaration):
    """The five-bar of the README: its declaration as printed, with a URDF that has its names."""
    parts = ['<robot name="my_five_bar"><link name="base"/>']
    for link, parent, joint, kind, origin in LINKS:
        parts.append(
            f'<link name="{link}"><inertial><origin xyz="0.2 0 0"/><mass value="0.5"/>'
            '<inertia ixx="0" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>'
            f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>'
            f'<origin xyz="{origin}"/><axis xyz="0 0 1"/>'
            '<limit lower="-9" upper="9" velocity="9" effort="9"/></joint>'
        )
    folder.mkdir()
    (folder / "my_five_bar.urdf").write_text("".join(parts) + "</robot>")
    (folder / "robot.yaml").write_text(declaration)


def test_the_examples_run_as_written(capsys, tmp_path, monkeypatch):
    text = README.read_text(encoding="utf-8")
    (declaration,) = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    write_own_robot(tmp_path / "my_five_bar", declaration)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    peaks = capsys.readouterr().out
    assert re.search(r"\[ *\d+\.\d+ +\d+\.\d+ +\d+\.\d+ *\] 0\.\d+", peaks)


def test_every_command_the_readme_names_exists():
    from redundancy_pin.cli import COMMANDS

    named = set(re.findall(r"redundancy-pin ([a-z-]+)", README.read_text(encoding="utf-8")))
    assert named
    assert named <= set(COMMANDS)


def test_every_make_target_the_readme_names_exists():
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`?make ([a-z]+)", README.read_text(encoding="utf-8"))) - {"and"}:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
