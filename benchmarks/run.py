"""Benchmarks, as ratios within one run: ``make bench``.

Every pair is timed in turn, several times, and the median of the paired ratios is printed: a machine whose speed drifts
moves both sides.
"""

import json
import statistics
import sys
import tracemalloc
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import compiled
import control_rate
import engine_table
import planners_future
import planners_stepwise
import planners_switch_off
import planners_whole
import published_table
import simulation
import stack
import start_up
from plain_loop import PlainLoop, seconds, smooth_motion

import redundancy_pin as rp

SAMPLES = 10_000
ONE_BY_ONE = 1000
"""Samples of those asked for one by one: the same steps in time."""
REPEATS = 5
FAST_CALLS = 10
"""Calls of the faster side in each pair: one of them takes milliseconds, less than a processor needs to settle."""


def compare(title, slow, fast, least):
    ratios, slow_times, fast_times = [], [], []
    fast()  # warm up: thread pools, caches
    for _ in range(REPEATS):
        a, expected = seconds(slow)
        b, got = seconds(lambda: [fast() for _ in range(FAST_CALLS)][-1])
        b /= FAST_CALLS
        ratios.append(a / b)
        slow_times.append(a)
        fast_times.append(b)
    error = np.abs(expected - got).max() / np.abs(expected).max()
    row = {
        "what": title,
        "ratio": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
        "target": least,
        "slow_us_per_sample": 1e6 * statistics.median(slow_times) / SAMPLES,
        "fast_us_per_sample": 1e6 * statistics.median(fast_times) / SAMPLES,
        "relative_difference": error,
    }
    print(
        f"{title}: {row['ratio']:.1f} times faster (target {least}, range {row['ratio_min']:.1f} to "
        f"{row['ratio_max']:.1f}); {row['slow_us_per_sample']:.1f} -> {row['fast_us_per_sample']:.2f} us a sample; "
        f"efforts differ by {error:.1e}"
    )
    return row


def one_by_one(loop, dynamics, motion, carriers):
    """Sample after sample, each from the one before: W, f and carrier forces against efforts by the plain loop."""

    def ask():
        start, efforts = None, []
        for k in range(len(motion)):
            tracks = carriers.s[k], carriers.sd[k], carriers.sdd[k]
            start = dynamics.sample(motion.x[k], motion.xd[k], motion.xdd[k], *tracks, start=start)
            efforts.append(start.f)
        return np.array(efforts), np.array(start.W)

    ratios, times = [], []
    ask()
    for _ in range(REPEATS):
        plain, tau = seconds(lambda: loop.from_platform_motion(motion, carriers))
        own, (f, W) = seconds(ask)
        ratios.append(own / plain)
        times.append((1e6 * plain / len(motion), 1e6 * own / len(motion)))
    plain, own = (statistics.median(part) for part in zip(*times, strict=True))
    row = {
        "what": "RNEA backend, sample after sample, against the plain loop",
        "ratio": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
        "target": 1.0,
        "plain_us_per_sample": plain,
        "own_us_per_sample": own,
        "relative_difference": np.abs(W @ tau[-1] - f[-1]).max() / np.abs(f[-1]).max(),
    }
    print(
        f"{row['what']}: {row['ratio']:.2f} of its time (target at most {row['target']:g}, range "
        f"{row['ratio_min']:.2f} to {row['ratio_max']:.2f}); {plain:.0f} -> {own:.0f} us a sample; W tau and f "
        f"differ by {row['relative_difference']:.1e}"
    )
    return row


def memory(action):
    tracemalloc.start()
    action()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main():
    robot = rp.load_robot("3rrr")
    motion, carriers = smooth_motion(SAMPLES)
    loop = PlainLoop(robot)
    rnea, manual = rp.RneaDynamics(robot), rp.VirtualWork(robot)
    rows = [
        compare(
            "virtual work against the plain loop, from platform motion",
            lambda: loop.from_platform_motion(motion, carriers),
            lambda: rp.distribute(manual.reduce(motion, carriers)).tau,
            50,
        ),
        compare(
            "RNEA backend against the plain loop, from platform motion",
            lambda: loop.from_platform_motion(motion, carriers),
            lambda: rp.distribute(rnea.reduce(motion, carriers)).tau,
            1,
        ),
    ]
    rows.append(one_by_one(loop, rnea, motion[:ONE_BY_ONE], carriers[:ONE_BY_ONE]))
    along = rnea.along(motion)
    q, v, a = along.tree_motion(carriers)
    rows.append(
        compare(
            "RNEA backend, new carrier motion, against the loop given q, v, a",
            lambda: loop.from_tree_motion(q, v, a),
            lambda: rp.distribute(along.reduce(carriers)).tau,
            10,
        )
    )
    for name, dynamics in (("RNEA backend", rnea), ("virtual work", manual)):
        one, its_carriers = motion[:1], carriers[:1]
        times = [seconds(lambda d=dynamics, m=one, c=its_carriers: rp.distribute(d.reduce(m, c)))[0] for _ in range(50)]
        bound = dynamics.along(one)
        again = [seconds(lambda b=bound, c=its_carriers: rp.distribute(b.reduce(c)))[0] for _ in range(50)]
        row = {
            "what": f"latency of one sample, {name}",
            "from_platform_motion_us": 1e6 * statistics.median(times),
            "new_carriers_us": 1e6 * statistics.median(again),
        }
        print(
            f"{row['what']}: {row['from_platform_motion_us']:.0f} us from platform motion, "
            f"{row['new_carriers_us']:.0f} us for new carriers"
        )
        rows.append(row)
        peaks = []
        for samples in (SAMPLES, 4 * SAMPLES):
            m, c = smooth_motion(samples)
            peaks.append(memory(lambda d=dynamics, m=m, c=c: d.reduce(m, c)) / samples)
        row = {"what": f"peak memory, {name}", "bytes_a_sample": peaks, "growth": peaks[1] / peaks[0]}
        print(f"{row['what']}: {peaks[0]:.0f} bytes a sample at {SAMPLES}, {peaks[1]:.0f} at {4 * SAMPLES}")
        rows.append(row)
    rows += compiled.rows()
    rows += control_rate.rows()
    rows += planners_stepwise.rows()
    rows += planners_switch_off.rows()
    rows += planners_whole.rows()
    rows += planners_future.rows()
    rows += simulation.rows()
    rows += engine_table.rows()
    rows += start_up.rows()
    rows += published_table.rows()
    stack.rows()
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
