"""The README's Python examples run as they are written, and what it names exists."""

import re
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_examples_run_as_written(capsys, tmp_path, monkeypatch):
    """The reader's own file is the four-bar of docs/model_files.md, its loop stated as in URDF+."""
    monkeypatch.chdir(tmp_path)
    page = (README.parent / "docs" / "model_files.md").read_text(encoding="utf-8")
    (tree,) = re.findall(r"<!-- file: tree.urdf -->\n```xml\n(.*?)```", page, flags=re.DOTALL)
    (pin,) = re.findall(r'"URDF\+": """(.*?)"""', page, flags=re.DOTALL)
    Path("linkage.urdf").write_text(tree.replace("</robot>", pin + "</robot>"), encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert Path("torques.png").stat().st_size > 10_000
    assert Path("plan.html").exists()
    printed = capsys.readouterr().out
    assert "singular_inconsistent" in printed
    assert "LIMIT_VIOLATED" in printed


def test_every_command_the_readme_names_exists():
    from redundancy_pin.cli import COMMANDS

    named = set(re.findall(r"redundancy-pin ([a-z-]+)", README.read_text(encoding="utf-8")))
    assert named
    assert named <= set(COMMANDS)


def test_every_make_target_the_readme_names_exists():
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`?make ([a-z]+)", README.read_text(encoding="utf-8"))) - {"and"}:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
