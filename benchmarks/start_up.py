"""What it takes to start, as ratios of processor time to that of ``import pinocchio``.

From byte code, as an installed package has it: a checkout that may not write any compiles every file at every start.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile

REPEATS = 9
PINOCCHIO = "import pinocchio"
COMMAND = "from redundancy_pin.cli import main; main({}, standalone_mode=False)"
PROGRAMS = {
    "import redundancy_pin": "import redundancy_pin",
    "load_robot": "import redundancy_pin; redundancy_pin.load_robot",
    "load_robot('3rrr')": "import redundancy_pin; redundancy_pin.load_robot('3rrr')",
    "load_robot('gough')": "import redundancy_pin; redundancy_pin.load_robot('gough')",
    "redundancy-pin --version": COMMAND.format(["--version"]),
    "redundancy-pin --help": COMMAND.format(["--help"]),
    "redundancy-pin info": COMMAND.format(["info"]),
    "redundancy-pin info --robot 3rrr": COMMAND.format(["info", "--robot", "3rrr"]),
}


def processor_seconds(program, folder):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = folder
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", program], stdout=subprocess.DEVNULL, check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def rows():
    """Time every program and Pinocchio's import in turn."""
    with tempfile.TemporaryDirectory() as folder:
        return _rows(folder)


def _rows(folder):
    result = []
    for name, program in PROGRAMS.items():
        processor_seconds(program, folder)  # which writes the byte code
        pairs = [(processor_seconds(PINOCCHIO, folder), processor_seconds(program, folder)) for _ in range(REPEATS)]
        row = {
            "what": f"start-up, {name}",
            "ratio_to_import_pinocchio": statistics.median(own / other for other, own in pairs),
            "seconds_beyond": statistics.median(own - other for other, own in pairs),
        }
        print(
            f"{row['what']}: {row['ratio_to_import_pinocchio']:.2f} times the import of pinocchio, "
            f"{row['seconds_beyond']:+.2f} s"
        )
        result.append(row)
    return result


if __name__ == "__main__":
    rows()
