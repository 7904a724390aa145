"""The README's Python example runs as it is written."""

import re
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


def test_the_example_runs_as_written(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    peaks = capsys.readouterr().out
    assert re.search(r"\[ *\d+\.\d+ +\d+\.\d+ +\d+\.\d+ *\] 0\.\d+", peaks)


def test_every_command_the_readme_names_exists():
    from redundancy_pin.cli import main

    named = set(re.findall(r"redundancy-pin ([a-z-]+)", README.read_text(encoding="utf-8")))
    assert named
    assert named <= set(main.commands)


def test_every_make_target_the_readme_names_exists():
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"`?make ([a-z]+)", README.read_text(encoding="utf-8"))) - {"and"}:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
