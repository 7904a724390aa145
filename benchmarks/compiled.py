"""Compiled dynamics against the plain loop of Pinocchio calls that does the same work, as ratios within one run."""

import statistics

import numpy as np
from plain_loop import PlainLoop, seconds, smooth_motion

import redundancy_pin as rp

SAMPLES = 10_000
SINGLE = 2_000
REPEATS = 5
TARGETS = {"from platform motion": 25, "new carriers": 50, "one sample from Python": 3, "one sample in C": 20}


def samples_of(dynamics, motion, carriers):
    rows = zip(motion.x, motion.xd, motion.xdd, carriers.s, carriers.sd, carriers.sdd, strict=True)
    return np.array([dynamics.sample(*row).f for row in rows])


def rows():
    """Return the rows of the report."""
    robot = rp.load_robot("3rrr")
    loop, compiled, one = PlainLoop(robot), rp.CompiledDynamics(robot), rp.CompiledDynamics(robot, threads=1)
    motion, carriers = smooth_motion(SAMPLES)
    few, its_carriers = motion[:SINGLE], carriers[:SINGLE]
    along = rp.RneaDynamics(robot).along(motion)
    q, v, a = along.tree_motion(carriers)
    again = compiled.along(motion)
    pairs = {
        "from platform motion": (
            lambda: loop.from_platform_motion(motion, carriers),
            lambda: rp.distribute(compiled.reduce(motion, carriers)).tau,
            SAMPLES,
            SAMPLES,
        ),
        "new carriers": (lambda: loop.from_tree_motion(q, v, a), lambda: again.reduce(carriers).f, SAMPLES, SAMPLES),
        "one sample from Python": (
            lambda: loop.from_platform_motion(few, its_carriers),
            lambda: samples_of(compiled, few, its_carriers),
            SINGLE,
            SINGLE,
        ),
        # closing the loop included: one thread, and the time that Python takes to call it once
        "one sample in C": (
            lambda: loop.from_platform_motion(few, its_carriers),
            lambda: one.reduce(motion, carriers).f,
            SINGLE,
            SAMPLES,
        ),
    }
    result = []
    for what, (slow, fast, slow_samples, fast_samples) in pairs.items():
        fast()
        timed = []
        for _ in range(REPEATS):
            plain, mine = seconds(slow)[0] / slow_samples, seconds(fast)[0] / fast_samples
            timed.append((plain / mine, plain, mine))
        ratios = [ratio for ratio, _, _ in timed]
        row = {
            "what": f"compiled dynamics against the plain loop, {what}",
            "ratio": statistics.median(ratios),
            "ratio_min": min(ratios),
            "ratio_max": max(ratios),
            "target": TARGETS[what],
            "slow_us_per_sample": 1e6 * statistics.median(plain for _, plain, _ in timed),
            "fast_us_per_sample": 1e6 * statistics.median(mine for _, _, mine in timed),
        }
        print(
            f"{row['what']}: {row['ratio']:.0f} times faster (target {row['target']}, range {row['ratio_min']:.0f} to "
            f"{row['ratio_max']:.0f}); {row['slow_us_per_sample']:.1f} -> {row['fast_us_per_sample']:.2f} us a sample"
        )
        result.append(row)
    return result


if __name__ == "__main__":
    rows()
