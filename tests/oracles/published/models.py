"""The machines of published problems, built from joints and masses: what their descriptions say, and no more."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.robot import Robot

EYE = np.eye(3)


def at(x, y=0.0, z=0.0, rotation=EYE):
    return pin.SE3(rotation, np.array([x, y, z], dtype=float))


def link(model, parent, place, name, joint=None, mass=0.0, centre=(0.0, 0.0, 0.0), inertia=(0.0, 0.0, 0.0), tip=None):
    """Add a joint (a hinge about z if not said) with a body, ``inertia`` about its centre; ``tip``: frame NAME_tip."""
    index = model.addJoint(parent, joint or pin.JointModelRZ(), place, name)
    model.appendBodyToJoint(index, pin.Inertia(mass, np.array(centre, dtype=float), np.diag(inertia)), at(0.0))
    model.addFrame(pin.Frame(f"{name}_link", index, 0, at(0.0), pin.FrameType.BODY))
    if tip is not None:
        model.addFrame(pin.Frame(f"{name}_tip", index, 0, at(*tip), pin.FrameType.BODY))
    return index


ANDREWS = {
    "m1": 0.04325, "m2": 0.00365, "m3": 0.02373, "m4": 0.00706, "m5": 0.07050, "m6": 0.00706, "m7": 0.05498,
    "i1": 2.194e-6, "i2": 4.410e-7, "i3": 5.255e-6, "i4": 5.667e-7, "i5": 1.169e-5, "i6": 5.667e-7, "i7": 1.912e-5,
    "d": 0.028, "da": 0.0115, "e": 0.02, "ea": 0.01421, "rr": 0.007, "ra": 0.00092, "ss": 0.035, "sa": 0.01874,
    "sb": 0.01043, "sc": 0.018, "sd": 0.02, "ta": 0.02308, "tb": 0.00916, "u": 0.04, "ua": 0.01228, "ub": 0.00449,
    "zf": 0.02, "zt": 0.04, "fa": 0.01421,
}  # fmt: skip
"""kg, kg·m² and m, by the names of Hairer and Wanner (Solving ordinary differential equations II, section VII.7)."""

ANDREWS_START = (
    -0.0617138900142764496, 0.0, 0.4552798191630703802, 0.2226683901658858846, 0.4873649795438425502,
    -0.2226683901658858846, 1.230547444549821192,
)  # fmt: skip
"""β, Θ, γ, Φ, δ, Ω, ε, rad."""


@functools.cache
def andrews() -> Robot:
    """Return Andrews' squeezing mechanism; its joints are the seven angles of the description, its spring is loaded."""
    p, model = ANDREWS, pin.Model()
    model.name, model.gravity.linear = "andrews", np.zeros(3)

    def flat(mass, inertia, x, y=0.0):
        return {"mass": p[mass], "inertia": (0.0, 0.0, p[inertia]), "centre": (x, y, 0.0)}

    # K1 from O to F, K2 from F back to E; K3 about B; K5 with K4 and K7 with K6 about A
    k1 = link(model, 0, at(0.0), "beta", **flat("m1", "i1", p["ra"]))
    link(model, k1, at(p["rr"]), "theta", tip=(-p["d"],), **flat("m2", "i2", -p["da"]))
    link(model, 0, at(-0.03635, 0.03273), "gamma", tip=(0.0, -p["ss"]), **flat("m3", "i3", p["sb"], -p["sa"]))
    k5 = link(model, 0, at(-0.06934, -0.00227), "delta", **flat("m5", "i5", p["ta"], -p["tb"]))
    link(model, k5, at(p["zt"]), "phi", tip=(0.0, -p["e"]), **flat("m4", "i4", 0.0, p["ea"] - p["e"]))
    k7 = link(model, 0, at(-0.06934, -0.00227), "epsilon", **flat("m7", "i7", p["ub"], -p["ua"]))
    link(model, k7, at(0.0, -p["u"]), "omega", tip=(p["zf"],), **flat("m6", "i6", p["zf"] - p["fa"]))
    guess = dict(zip(("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon"), ANDREWS_START, strict=True))
    model.addFrame(pin.Frame("ground", 0, 0, at(0.0), pin.FrameType.BODY))
    return rp.robot_from_model(
        model,
        closures=[("theta_tip", f"{other}_tip", ["x", "y"]) for other in ("gamma", "phi", "omega")],
        actuated=["beta"],
        reference={"joints": {"beta": guess.pop("beta")}, "guess": guess},
        independent=["beta"],
    ).loaded(
        rp.Spring("gamma_link", "ground", 4530.0, 0.0, 0.07785, (p["sd"], -p["sc"], 0.0), (0.014, 0.072, 0.0)),
    )


class Constant(rp.simulation.Controller):
    """Efforts that do not change."""

    def __init__(self, *tau):
        self.tau = np.array(tau)

    def effort(self, t, state):
        return self.tau, np.zeros(0)


def rod(mass, length, thickness=0.0, height=0.0):
    """Body of a straight rod along x from its joint: a box, or a line."""
    a, b = thickness**2, height**2
    inertia = mass / 12.0 * np.array([a + b, length**2 + b, length**2 + a])
    return {"mass": mass, "centre": (0.5 * length, 0.0, 0.0), "inertia": inertia, "tip": (length,)}


@functools.cache
def four_bars(count, crank=1.0, coupler=1.0, mass=(1.0, 1.0), height=0.0) -> Robot:
    """Return N parallelograms side by side in the x-y plane, upright, cranks first in the order of joints."""
    model = pin.Model()
    model.name, model.gravity.linear = f"four_bars_{count}", np.array([0.0, -9.81, 0.0])
    cranks = [link(model, 0, at(i * coupler), f"crank_{i}", **rod(mass[0], crank, height)) for i in range(count + 1)]
    for i in range(1, count + 1):
        link(model, cranks[i - 1], at(crank), f"coupler_{i}", **rod(mass[1], coupler, height))
    guess = {f"crank_{i}": 0.5 * np.pi for i in range(1, count + 1)}
    guess |= {f"coupler_{i}": -0.5 * np.pi for i in range(1, count + 1)}
    return rp.robot_from_model(
        model,
        closures=[(f"coupler_{i}_tip", f"crank_{i}_tip", ["x", "y"]) for i in range(1, count + 1)],
        actuated=["crank_0"],
        independent=["crank_0"],
        reference={"joints": {"crank_0": 0.5 * np.pi}, "guess": guess},
    )


DRAKE_START = np.arctan(np.sqrt(15.0))


@functools.cache
def drake() -> Robot:
    """Return Drake's four-bar: links A, B, C of 4 m, 2 m apart, in the x-z plane, z up, hinges about y."""
    model = pin.Model()
    model.name = "drake_four_bar"
    body = {"mass": 20.0, "centre": (2.0, 0.0, 0.0), "tip": (4.0,)}
    body["inertia"] = (0.08333333333333334, 29.46666666666666, 29.416666666666668)
    a = link(model, 0, at(0.0), "joint_WA", pin.JointModelRY(), **body)
    link(model, a, at(4.0), "joint_AB", pin.JointModelRY(), **body)
    link(model, 0, at(-2.0), "joint_WC", pin.JointModelRY(), **body)
    return rp.robot_from_model(
        model,
        closures=[("joint_AB_tip", "joint_WC_tip", ["x", "z"])],
        actuated=["joint_WA"],
        independent=["joint_WA"],
        reference={
            "joints": {"joint_WA": DRAKE_START},
            "guess": {"joint_AB": np.pi - DRAKE_START, "joint_WC": np.pi - DRAKE_START},
        },
    )


@functools.cache
def slider_crank() -> Robot:
    """Return Haug's spatial slider-crank: crank about x, rod on a ball, its end on a universal joint of the slider."""
    model = pin.Model()
    model.name = "slider_crank"
    link(
        model, 0, at(0.0, 0.1, 0.12), "crank", pin.JointModelRX(), 0.12, (0, 0, 0.04), (1e-4, 1e-4, 1e-5), (0, 0, 0.08)
    )
    slider = link(model, 0, at(0.0), "slider", pin.JointModelPX(), 2.0, inertia=(1e-4, 1e-4, 1e-4))
    cross = link(model, slider, at(0.0), "roll", pin.JointModelRX())
    link(model, cross, at(0.0), "swing", pin.JointModelRY(), 0.5, (-0.15, 0, 0), (4e-4, 4e-3, 4e-3), (-0.3,))
    guess = {"slider": 0.2, "roll": np.arctan2(-0.1, 0.2), "swing": np.arcsin(np.sqrt(0.05) / 0.3)}
    return rp.robot_from_model(
        model,
        closures=[("swing_tip", "crank_tip", ["x", "y", "z"])],
        actuated=["crank"],
        independent=["crank"],
        reference={"joints": {"crank": 0.0}, "guess": guess},
    )


@functools.cache
def bricard() -> Robot:
    """Return Bricard's six hinges along the edges of a cube: five rods of 1 m and 1 kg, 0.1 m thick, one in halves."""
    model, parent, place = pin.Model(), 0, at(0.0)
    model.name, model.gravity.linear = "bricard", np.array([0.0, -9.81, 0.0])
    axes = {"x": pin.JointModelRX(), "y": pin.JointModelRY(), "z": pin.JointModelRZ()}
    steps = [("y", (1, 0, 0)), ("z", (0, -1, 0)), ("x", (0, 0, 1)), ("y", (-1, 0, 0)), ("z", (0, 0.5, 0))]
    for i, (axis, step) in enumerate([*steps, ("x", (0, -0.5, 0))], 1):
        along = np.abs(step)
        length = float(along.max())
        inertia = length / 12.0 * (length**2 * (1.0 - along / length) + 0.01 * (1.0 + along / length))
        if i == 6:  # from the ground to the middle of the fifth
            parent, place = 0, at(0, 0, 1)
        parent = link(model, parent, place, f"hinge_{i}", axes[axis], length, 0.5 * np.array(step), inertia)
        place = at(*step)
    weld = pin.FrameAnchorConstraintModel(model, parent - 1, at(0, 0.5, 0), parent, place)
    return rp.robot_from_model(model, closures=[weld], actuated=["hinge_1"], reference=np.zeros(6))


@functools.cache
def governor() -> Robot:
    """Return the stiff fly-ball governor: a shaft about z, a slider on it, two rods with balls, springs between."""
    model = pin.Model()
    model.name = "governor"
    bar = 0.025 * np.array([1.0001, 1.0001, 2e-4])
    shaft = link(model, 0, at(0.0), "shaft", mass=0.3, centre=(0, 0, 0.5), inertia=bar)
    link(model, shaft, at(0.0), "slider", pin.JointModelPZ(), 3.0, inertia=0.005 * np.ones(3))
    springs = []
    for i, side in enumerate((1.0, -1.0), 1):
        arm = link(
            model, shaft, at(0.05 * side, 0, 1), f"arm_{i}", pin.JointModelRY(), 0.3, (0, 0, -0.5), bar,
        )  # fmt: skip
        model.appendBodyToJoint(arm, pin.Inertia(5.0, np.zeros(3), np.zeros((3, 3))), at(0, 0, -1))
        springs.append(rp.Spring("slider_link", f"arm_{i}_link", 8e5, 4e4, 0.5, (0.05 * side, 0, 0), (0, 0, -0.5)))
    home = {"shaft": 0.0, "slider": 0.5, "arm_1": -np.pi / 3, "arm_2": np.pi / 3}
    free = list(home)
    return rp.robot_from_model(model, actuated=["shaft"], independent=free, reference={"joints": home}).loaded(*springs)
