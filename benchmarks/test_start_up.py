"""What it takes to start, beside the import of Pinocchio; from byte code, as an installed package has it."""

import os
import subprocess
import sys

import pytest

COMMAND = "from redundancy_pin.cli import main; main({}, standalone_mode=False)"
PROGRAMS = {
    "import pinocchio": "import pinocchio",
    "import redundancy_pin": "import redundancy_pin",
    "load_robot('3rrr')": "import redundancy_pin; redundancy_pin.load_robot('3rrr')",
    "redundancy-pin --help": COMMAND.format(["--help"]),
    "redundancy-pin info --robot 3rrr": COMMAND.format(["info", "--robot", "3rrr"]),
}


@pytest.mark.benchmark(group="start of a program")
@pytest.mark.parametrize("who", PROGRAMS)
def test_start(benchmark, who, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(tmp_path)

    def start():
        subprocess.run([sys.executable, "-c", PROGRAMS[who]], stdout=subprocess.DEVNULL, check=True, env=environment)

    start()  # which writes the byte code
    benchmark.pedantic(start, rounds=5)
