"""Stack of generated C, measured, into docs/tables/stack.md (``make bench`` does it too).

python benchmarks/stack.py
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import redundancy_pin as rp
from redundancy_pin.codegen import write_c
from redundancy_pin.codegen.stack import stack_bytes
from redundancy_pin.robot.shipped import shipped_robots

PROGRAM = Path(__file__).with_name("stack.c")
PAGE = Path(__file__).parents[1] / "docs" / "tables" / "stack.md"
BEGIN, END = "<!-- table: `python benchmarks/stack.py` writes it -->\n", "<!-- end of table -->"
LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")
LOOPS = 40
"""Of the last row: four-bars side by side, one behind the other."""


def program(folder, prefix, level, target):
    """Compile what measures: stack.c, the code and its test program; return its path."""
    header = (folder / f"{prefix}.h").read_text(encoding="utf-8")
    definitions = [f"ROBOT={prefix}", f'ROBOT_TEST="test_{prefix}.c"', f"RECORDED={prefix.upper()}_OWN_RECORDED"]
    definitions += ["FORWARD"] if f"{prefix}_forward_kinematics(" in header else []
    sources = [str(PROGRAM), str(folder / f"{prefix}.c")]
    command = ["cc", "-std=gnu99", "-w", f"-I{folder}", *(f"-D{text}" for text in definitions), level, *sources]
    subprocess.run([*command, "-o", str(target), "-lm", "-lpthread"], check=True)
    return target


def measured(path):
    """Return bytes of stack by function."""
    told = subprocess.run([str(path)], capture_output=True, text=True, check=True).stdout
    return {name: int(size) for name, size in (line.split() for line in told.splitlines())}


def row(name, robot):
    """Return a row of the table: name, sizes, what is promised, the most that is used at -O2 and at any level."""
    with tempfile.TemporaryDirectory() as place:
        folder, most = Path(place) / "code", {}
        write_c(robot, folder, prefix="robot")
        for level in LEVELS:
            most[level] = max(measured(program(folder, "robot", level, Path(place) / "stack")).values())
    level = max(most, key=most.get)
    loops, promised = len(robot.closures), stack_bytes(robot)
    return f"| {name} | {loops} | {robot.model.nv} | {promised:,} | {most['-O2']:,} | {most[level]:,} (`{level}`) |"


def rows():
    """Write the table."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
    from flat_linkages import row_of_four_bars

    robots = {name: rp.load_robot(name) for name in shipped_robots(gallery=True)}
    robots[f"row of {LOOPS} four-bars"] = row_of_four_bars(LOOPS)
    head = "| machine | closures | nv | `…_STACK_BYTES` | used, `-O2` | used, worst level |"
    table = "\n".join([head, "| --- " + "| ---: " * 5 + "|", *(row(name, robot) for name, robot in robots.items())])
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{table}\n\n{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    rows()
