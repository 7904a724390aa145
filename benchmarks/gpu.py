"""Samples a second on a GPU beside what they should be, agreement with the processor, and what limits: as tables.

python benchmarks/gpu.py [--device cpu] [--samples N] [ROBOT ...]     (extra `gpu`; less than five minutes)

Cold: every sample starts from the reference. Warm: many motions in step, each sample from the state of the one before,
a hundredth of the spread away. Forward: accelerations at closed states, carriers in motion. ``--device cpu`` tries the
script without a GPU.
"""

import argparse
import time

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.dynamics.compiled.build import define
from redundancy_pin.dynamics.compiled.gpu import _ManyEfforts
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot.checks import is_pose

ROBOTS = ("3rrr", "gough", "delta", "five_bar", "2rpr")
TARGETS = {("3rrr", "cold"): 250.0, ("3rrr", "warm"): 300.0, ("gough", "cold"): 10.0}
"""Million samples a second on one H100, double precision."""

NEAR, FAR = 0.05, 1.0
"""How far poses are from the reference, characteristic lengths: those that are timed, and those of many statuses."""

CHECKED, REPEATS, STEPS = 20_000, 5, 10
FP64_UNITS = {"8.0": 32, "9.0": 64}
"""Fused multiply-adds of a multiprocessor in a cycle, double precision, by compute capability."""


class Device:
    """A GPU by cupy, or the processor in its place."""

    def __init__(self, name):
        self.name, self.xp = name, np
        if name == "gpu":
            import cupy

            self.xp = cupy

    def wait(self):
        """Return when the device is done."""
        if self.name == "gpu":
            self.xp.cuda.Device().synchronize()

    def host(self, array):
        """Return an array as one of numpy."""
        return self.xp.asnumpy(array) if self.name == "gpu" else np.asarray(array)

    def seconds(self, work, repeats=REPEATS):
        """Return the least time of a few, after one that compiles."""
        work()
        best = np.inf
        for _ in range(repeats):
            self.wait()
            begin = time.perf_counter()
            work()
            self.wait()
            best = min(best, time.perf_counter() - begin)
        return best


def states(robot, samples, reach):
    """Return random arguments of ``torque``."""
    rng, n, k = np.random.default_rng(1), robot.n, robot.k
    home, size = follower(robot).state_at(robot.q_reference).x, reach * robot.characteristic_length
    steps = size * rng.uniform(-1.0, 1.0, (samples, n))
    if is_pose(robot):
        few = np.array([home @ pin.exp6(step).homogeneous for step in steps[:4096]])
        x = few[np.arange(samples) % len(few)]
    else:
        x = home + steps
    carried = size * rng.uniform(-1.0, 1.0, (3, samples, k))
    return [x, rng.normal(size=(samples, n)), rng.normal(size=(samples, n)), *carried]


def agreement(dynamics, on_cpu, given):
    """Return the largest deviation from the processor, of the largest effort, and how many statuses are the same."""
    wanted = on_cpu.torque(*given)
    found = dynamics.torque(*given)
    solved = np.isfinite(wanted.tau).all(axis=1) & np.isfinite(found.tau).all(axis=1)
    error = np.abs(found.tau - wanted.tau)[solved].max() / np.abs(wanted.tau[solved]).max()
    return error, int((found.status == wanted.status).sum())


def closed_states(device, robot, dynamics, given):
    """Return q, v, tau and carrier forces at samples: the loops at rest, carriers as they move."""
    xp, found = device.xp, dynamics.torque(*given)
    q, v = xp.ascontiguousarray(found.state[:, :-1]), xp.zeros((len(found.tau), robot.model.nv))
    q[:, xp.asarray(robot.carrier_position)] = given[3]
    v[:, xp.asarray(robot.carrier_velocity)] = given[4]
    return q, v, xp.ascontiguousarray(found.tau), xp.ascontiguousarray(found.carrier_force)


def measured(device, name, samples):
    """Return times (s a sample) by kind of work, and columns of the two tables."""
    robot = rp.load_robot(name)
    given, far = states(robot, samples, NEAR), states(robot, CHECKED, FAR)
    begin = time.perf_counter()
    dynamics = rp.GpuDynamics(robot, device=device.name)
    dynamics.torque(*(part[:1000] for part in given))
    compiling = time.perf_counter() - begin
    on_cpu, few = rp.GpuDynamics(robot, device="cpu"), [part[:CHECKED] for part in given]
    on_cpu.torque(*(part[:10] for part in few))
    begin = time.perf_counter()
    on_cpu.torque(*few)
    core = (time.perf_counter() - begin) / len(few[0])

    arrays = [device.xp.asarray(part) for part in given]
    step = 0.01 * NEAR * robot.characteristic_length
    nearby = pin.exp6(np.full(6, step)).homogeneous if is_pose(robot) else step
    stream = [arrays[0]]
    for _ in range(STEPS):
        stream.append(stream[-1] @ device.xp.asarray(nearby) if is_pose(robot) else stream[-1] + nearby)
    home = dynamics.torque(*arrays).state

    def motions():
        state = home
        for x in stream[1:]:
            state = dynamics.torque(x, *arrays[1:], start=state).state

    times = {"cold": device.seconds(lambda: dynamics.torque(*arrays)) / samples}
    times["warm"] = device.seconds(motions, 2) / samples / STEPS
    still = closed_states(device, robot, dynamics, arrays)
    times["forward"] = device.seconds(lambda: dynamics.acceleration(*still)) / samples
    through = device.seconds(lambda: dynamics.torque(*given), 2) / samples
    a = device.host(dynamics.acceleration(*(part[:CHECKED] for part in still)).a)
    wanted = on_cpu.acceleration(*(device.host(part[:CHECKED]) for part in still)).a
    good = np.isfinite(wanted).all(axis=1)
    forward = np.abs(a - wanted)[good].max() / np.abs(wanted[good]).max()
    checks = []
    for part in (few, far):
        error, alike = agreement(dynamics, on_cpu, part)
        checks.append(f"{error:.1g} | {alike:,} of {len(part[0]):,}")
    others = [f"{core / times['cold']:.0f}", f"{1e9 * through:.3g} ns", f"{compiling:.0f} s"]
    return times, others, [*checks, f"{forward:.1g}"]


def operations(name):
    """Return the operations of generated code in a sample of three steps of Newton's method."""
    functions = define(rp.load_robot(name)).functions
    often = {"turns": 3, "rows": 3, "moved": 2, "bias": 1, "project": 1}
    return sum(count * functions[f"rp_{each}"].n_instructions() for each, count in often.items())


def attributes(device, name, cold):
    """Return what limits a kernel: registers, local memory, threads that are held, memory in use, and arithmetic."""
    cupy, row = device.xp, f"| {name} | {operations(name):,} |"
    if device.name != "gpu":
        return f"{row} | | | | |"
    dynamics = rp.GpuDynamics(name)
    kernel = dynamics._code(_ManyEfforts).get_function(_ManyEfforts.name)
    kernel.compile()
    # registers are given to warps by the 256
    chip = cupy.cuda.Device()
    held = chip.attributes["MaxRegistersPerMultiprocessor"] // (-(-32 * kernel.num_regs // 256) * 256 * 4) * 128
    units = FP64_UNITS.get(f"{chip.compute_capability[0]}.{chip.compute_capability[1:]}", 0)
    peak = 1e3 * units * chip.attributes["MultiProcessorCount"] * chip.attributes.get("ClockRate", 0)
    share = f"{100.0 * operations(name) / cold / peak:.0f} %" if peak else ""
    used = cupy.get_default_memory_pool().total_bytes() / 2**30
    local, held = f"{kernel.local_size_bytes:,} B", f"{min(2048, held)} of 2,048"
    return f"{row} {kernel.num_regs} | {local} | {held} | {share} | {used:.1f} GiB |"


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("gpu", "cpu"), default="gpu")
    parser.add_argument("--samples", type=lambda text: int(float(text)), help="4e6, on the processor 20,000")
    parser.add_argument("robots", nargs="*", default=ROBOTS)
    given = parser.parse_args()
    device, begin = Device(given.device), time.perf_counter()
    samples = given.samples or (4_000_000 if given.device == "gpu" else 20_000)
    if given.device == "gpu":
        chip = device.xp.cuda.runtime.getDeviceProperties(0)["name"].decode()
        print(f"{chip}, cupy {device.xp.__version__}, ", end="")
    print(f"double precision, {samples:,} samples\n")
    rows, limits, verdicts = [], [], []
    kinds = "cold | million/s | warm | million/s | forward | million/s"
    print(f"| robot | {kinds} | of one core | with transfers | compiling |\n|---|{'---:|' * 9}", flush=True)
    for name in given.robots:
        times, others, checks = measured(device, name, samples)
        columns = [f"{1e9 * one:.3g} ns | {1e-6 / one:.4g}" for one in times.values()]
        print(f"| {name} | {' | '.join([*columns, *others])} |", flush=True)
        rows.append(f"| {name} | {' | '.join(checks)} |")
        limits.append(attributes(device, name, times["cold"]))
        for (robot, kind), least in TARGETS.items():
            if robot == name:
                rate = 1e-6 / times[kind]
                verdicts.append(f"{name} {kind} {rate:.4g} of {least:g}, {'met' if rate >= least else 'MISSED'}")
    print("\n| robot | near: off by | statuses alike | far: off by | statuses alike | forward: off by |")
    print(f"|---|{'---:|' * 5}")
    print("\n".join(rows))
    print("\n| robot | operations | registers | local memory | threads held | of peak arithmetic | pool |")
    print(f"|---|{'---:|' * 6}")
    print("\n".join(limits))
    print(f"\nTargets of an H100, million/s: {'; '.join(verdicts)}")
    for name in given.robots[:2]:
        arrays = [device.xp.asarray(part) for part in states(rp.load_robot(name), samples, NEAR)]
        sizes = (64, 128, 256) if given.device == "gpu" else (128,)
        several = {size: rp.GpuDynamics(name, device=device.name, threads=size) for size in sizes}
        by_size = {size: device.seconds(lambda one=one: one.torque(*arrays)) for size, one in several.items()}  # noqa: B023
        listed = ", ".join(f"{size}: {1e9 * one / samples:.3g} ns" for size, one in by_size.items())
        print(f"{name}, cold, by threads of a block: {listed}")
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
