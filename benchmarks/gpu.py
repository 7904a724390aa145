"""Samples a second on a GPU, beside one core of the processor, and whether they agree: a table on the terminal.

python benchmarks/gpu.py [SAMPLES] [ROBOT ...]     (extra `gpu`; a few minutes on one device, most of them NVRTC's)

Cold: every sample starts from the reference. Warm: from the state of a pose a hundredth of the spread away.
Forward: accelerations at the closed states of these samples, each its own, carriers in motion.
"""

import sys
import time

import cupy
import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot.checks import is_pose

ROBOTS = {"3rrr": 0.05, "gough": 0.05, "delta": 0.05, "five_bar": 0.05, "2rpr": 0.05}
"""How far poses are from the reference, characteristic lengths."""

CHECKED = 20_000
REPEATS = 5


def states(robot, samples, reach):
    """Return random arguments of ``torque``."""
    rng, n, k = np.random.default_rng(1), robot.n, robot.k
    home, size = follower(robot).state_at(robot.q_reference).x, reach * robot.characteristic_length
    steps = size * rng.uniform(-1.0, 1.0, (samples, n))
    if is_pose(robot):
        few = np.array([home @ pin.exp6(step).homogeneous for step in steps[:4096]])
        x = few[np.arange(samples) % 4096]
    else:
        x = home + steps
    carried = size * rng.uniform(-1.0, 1.0, (3, samples, k))
    return [x, rng.normal(size=(samples, n)), rng.normal(size=(samples, n)), *carried]


def nearby(robot, x, reach):
    """Return poses a hundredth of the spread away."""
    step = 0.01 * reach * robot.characteristic_length
    return x @ pin.exp6(np.full(6, step)).homogeneous if is_pose(robot) else x + step


def seconds(work):
    """Return the least time of a few, after one that compiles."""
    best = np.inf
    for _ in range(REPEATS):
        cupy.cuda.Device().synchronize()
        begin = time.perf_counter()
        work()
        cupy.cuda.Device().synchronize()
        best = min(best, time.perf_counter() - begin)
    return best


def measured(name, reach, samples):
    """Return a row of the table."""
    robot = rp.load_robot(name)
    given = states(robot, samples, reach)
    begin = time.perf_counter()
    dynamics = rp.GpuDynamics(robot)
    dynamics.torque(*(part[:1000] for part in given))
    compiling = time.perf_counter() - begin
    on_cpu = rp.GpuDynamics(robot, device="cpu")
    few = [part[:CHECKED] for part in given]
    on_cpu.torque(*(part[:10] for part in few))
    begin = time.perf_counter()
    wanted = on_cpu.torque(*few)
    core = (time.perf_counter() - begin) / len(few[0])
    found = dynamics.torque(*few)
    alike = int((found.status == wanted.status).sum())
    solved = np.isfinite(wanted.tau).all(axis=1) & np.isfinite(found.tau).all(axis=1)
    error = np.abs(found.tau - wanted.tau)[solved].max() / np.abs(wanted.tau[solved]).max()
    device = [cupy.asarray(part) for part in given]
    cold = seconds(lambda: dynamics.torque(*device)) / samples
    near = dynamics.torque(cupy.asarray(nearby(robot, given[0], reach)), *device[1:]).state
    warm = seconds(lambda: dynamics.torque(*device, start=near)) / samples
    q = cupy.ascontiguousarray(near[:, :-1])
    q[:, cupy.asarray(robot.carrier_position)] = device[3]
    v = cupy.zeros((samples, robot.model.nv))  # carriers move as they like; the loops are at rest
    v[:, cupy.asarray(robot.carrier_velocity)] = device[4]
    tau = cupy.ascontiguousarray(dynamics.torque(*device).tau)
    dynamics.acceleration(q[:1000], v[:1000], tau[:1000])
    forward = seconds(lambda: dynamics.acceleration(q, v, tau)) / samples
    times = (f"{1e9 * one:.3g} ns | {1e-6 / one:.4g}" for one in (cold, warm, forward))
    checks = f"{core / cold:.0f} | {error:.1g} | {alike:,} of {len(few[0]):,} | {compiling:.0f} s"
    return f"| {name} | {samples:,} | {' | '.join(times)} | {checks} |"


def attributes(name):
    """Return what limits the kernel: registers, local memory of a thread, and threads that a multiprocessor holds."""
    dynamics = rp.GpuDynamics(name)
    kernel = dynamics._efforts.get_function("rp_many_efforts")
    kernel.compile()
    # registers are given to warps by the 256
    registers = cupy.cuda.Device().attributes["MaxRegistersPerMultiprocessor"]
    held = min(2048, registers // (-(-32 * kernel.num_regs // 256) * 256 * 4) * 128)
    return f"| {name} | {kernel.num_regs} | {kernel.local_size_bytes:,} B | {held} of 2,048 |"


def main():
    """Print the tables."""
    samples = int(float(sys.argv[1])) if len(sys.argv) > 1 else 4_000_000
    chosen = sys.argv[2:] or list(ROBOTS)
    properties = cupy.cuda.runtime.getDeviceProperties(0)
    print(f"{properties['name'].decode()}, double precision, cupy {cupy.__version__}\n")
    rates = " | ".join(f"{work} | million/s" for work in ("cold", "warm", "forward"))
    print(f"| robot | samples | {rates} | of one core | off by | statuses alike | compiling |\n|---|{'---:|' * 11}")
    for name in chosen:
        print(measured(name, ROBOTS.get(name, 0.05), samples), flush=True)
    print("\n| robot | registers | local memory a thread | threads held |\n|---|---:|---:|---:|")
    for name in chosen:
        print(attributes(name), flush=True)


if __name__ == "__main__":
    main()
