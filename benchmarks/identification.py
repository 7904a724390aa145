"""How often intervals of identified parameters hold the truth, of machines that outside engines have moved: one table.

python benchmarks/identification.py --draws 400
python benchmarks/identification.py --machines five_bar delta --engine exudyn --draws 20

One motion a machine (``tests/support/engine_records.py``), then noise of 5 % of the efforts and encoders of 17 bits
with new zeros in each draw. Columns: pooled coverage of 95 % intervals, least and largest of single parameters, largest
|error| over standard deviation, how many parameters are known to 1 % in the median draw and how far they are off, and
the largest error of predicted efforts of another motion over the noise.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS / "support"), str(TESTS / "oracles")]

from engine_records import MACHINES, efforts_of, engine_records, with_noise  # noqa: E402
from measured import true_values  # noqa: E402

from redundancy_pin.identification import identify  # noqa: E402

HEAD = (
    "| machine | engine | samples | parameters | draws | pooled | least | largest | max z | known to 1 % | off | "
    "prediction | s a fit |\n" + "|---|---|" + "---:|" * 11
)


def row(name, engine, draws, seconds):
    """Return the row of a machine."""
    measured = engine_records(name, engine, seconds)
    start, offs, known, off, prediction = time.process_time(), [], [], [], []
    for seed in range(draws):
        fit = identify(measured.given, with_noise(measured, seed), cut_off=12.0)
        true = true_values(fit, measured.true)
        offs.append(np.abs(fit.values - true) / fit.standard_deviation)
        narrow = 1.96 * fit.standard_deviation < 0.01 * np.abs(true)
        known.append(int(narrow.sum()))
        off.append((np.abs(fit.values - true)[narrow] / np.abs(true)[narrow]).max(initial=0.0))
        error = efforts_of(measured.given, fit) - efforts_of(measured.true)
        noise = 0.05 * measured.exact.effort.std(axis=0)
        prediction.append((np.sqrt((error**2).mean(axis=0)) / noise).max())
    spent = (time.process_time() - start) / draws
    inside = np.array(offs) < 1.959964
    each = inside.mean(axis=0)
    cells = [name, engine, len(measured.exact), inside.shape[1], draws]
    cells += [f"{share:.1%}" for share in (inside.mean(), each.min(), each.max())]
    cells += [f"{np.max(offs):.1f}", f"{np.median(known):.0f}", f"{np.max(off):.2%}", f"{np.max(prediction):.2f}"]
    return f"| {' | '.join(map(str, cells))} | {spent:.1f} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=MACHINES)
    parser.add_argument("--engine", choices=("mujoco", "exudyn"), default="mujoco")
    parser.add_argument("--draws", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=3.0)
    chosen = parser.parse_args()
    print(HEAD)
    for name in chosen.machines:
        print(row(name, chosen.engine, chosen.draws, chosen.seconds), flush=True)
