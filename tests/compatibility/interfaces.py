"""What programs rely on, as plain data: names and signatures, imports that the documentation shows, keys of JSON."""

from __future__ import annotations

import ast
import enum
import importlib
import inspect
import json
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import redundancy_pin as rp

ROOT = Path(__file__).resolve().parents[2]

PLACES = {
    "rp": "redundancy_pin",
    "rp.trajectory": "redundancy_pin.trajectory",
    "rp.trajectory.reference": "redundancy_pin.trajectory.reference",
    "rp.simulation": "redundancy_pin.simulation",
    "rp.plot": "rp.plot",
    "controllers": "redundancy_pin.simulation.controllers",
    "feasibility": "redundancy_pin.experiments.feasibility",
    "errors": "redundancy_pin.errors",
}
"""Where users find what is public: paths of imports, and ``rp.plot``, whose module has another name."""

BUILDING = {"docs/pictures/draw.py", "docs/conf.py", "docs/api_pages.py"}
"""Programs beside the documentation that build it: nothing that a reader is shown."""


def place(name: str) -> Any:
    """Return the module of that name in ``PLACES``; a deprecated one may say so."""
    path = PLACES[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return rp.plot if path == "rp.plot" else importlib.import_module(path)


def thing(module: Any, name: str) -> Any:
    """Return what a module calls so; a deprecated name may say so."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return getattr(module, name)


# ----------------------------------------------------------------------------------------------- names and signatures


def public_names(module: Any) -> list[str]:
    """Return what is public in a module: ``__all__``, or what it defines itself."""
    listed = getattr(module, "__all__", None)
    if listed is not None:
        return sorted(listed)
    return sorted(
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and getattr(value, "__module__", None) == module.__name__
    )


def describe(value: Any) -> dict[str, Any]:
    """Return what a name stands for: signature, members, or the type of a constant."""
    if isinstance(value, ModuleType):
        return {"kind": "module"}
    if isinstance(value, type):
        return _class(value)
    if inspect.isroutine(value):
        return {"kind": "function", "parameters": parameters(value)}
    if isinstance(value, str):
        return {"kind": "constant", "value": value}
    if isinstance(value, (tuple, Mapping)):  # of a mapping the keys: its values may be prose
        return {"kind": "constant", "value": [str(entry) for entry in value]}
    return {"kind": "constant"}


def parameters(function: Any) -> list[str]:
    """Return the parameters that ``inspect.signature`` sees, as ``KIND name = default``."""
    names = []
    for parameter in inspect.signature(function).parameters.values():
        given = parameter.default is inspect.Parameter.empty
        names.append(f"{parameter.kind.name} {parameter.name}" + ("" if given else f" = {_default(parameter.default)}"))
    return names


def _default(value: Any) -> str:
    text = repr(value)
    return getattr(value, "__qualname__", type(value).__qualname__) if " at 0x" in text else text


def _class(kind: type) -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": "class"}
    if issubclass(kind, enum.Enum):
        return {**entry, "kind": "enum", "members": {member.name: member.value for member in kind}}
    if issubclass(kind, Exception):
        entry["bases"] = sorted(base.__name__ for base in kind.__mro__[1:] if base is not object)
    if not getattr(kind, "_is_protocol", False):
        entry["parameters"] = parameters(kind)
    entry["attributes"], entry["methods"] = [], {}
    for name in sorted(members(kind)):
        value = inspect.getattr_static(kind, name, None)
        if isinstance(value, (staticmethod, classmethod)) or inspect.isfunction(value):
            entry["methods"][name] = parameters(getattr(kind, name))
        else:
            entry["attributes"].append(name)
    return entry


def members(kind: type, *, undocumented: bool = False) -> set[str]:
    """Return the public attributes and methods of a class.

    Args:
        kind: the class.
        undocumented: whether attributes that methods set, and of which no docstring speaks, are among them.
    """
    own = [base for base in kind.__mro__ if base.__module__.startswith("redundancy_pin")]
    names = {name for base in own for name in (*vars(base), *vars(base).get("__annotations__", ()))}
    text = " ".join(base.__doc__ or "" for base in own)
    names |= {name for base in own for name in _assigned(base) if undocumented or re.search(rf"\b{name}\b", text)}
    return {name for name in names if not name.startswith("_")}


def _assigned(kind: type) -> Iterator[str]:
    """Give the attributes that methods of a class assign to ``self``."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    except (OSError, TypeError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self":
            yield node.attr


def results() -> dict[str, list[str]]:
    """Return the public attributes of what functions give back: their types are found by calling, not by importing."""
    robot = rp.load_robot("2rpr")
    trajectory = rp.trajectory.reference.circle(speed=0.5)
    motion = trajectory.sample(dt=0.05)
    dynamics = rp.RneaDynamics(robot)
    reduced = dynamics.reduce(motion)
    plan = rp.plan_switch_off(rp.VirtualWork(robot), trajectory, dt=0.02, threshold=5.0)
    corner = rp.load_robot("3rrr")
    along = rp.RneaDynamics(corner).along(rp.trajectory.reference.corner().sample(dt=0.1))
    lifted = rp.lift(robot, motion)
    run = rp.simulate(corner, duration=0.02)
    (crossing, *_) = rp.find_crossings(robot, trajectory)
    made = {
        "load_robot": robot,
        "load_robot().carrier_limits[0]": robot.carrier_limits[0],
        "load_robot().closures[0]": robot.closures[0],
        "reduce": reduced,
        "along": along,
        "VirtualWork.along": rp.VirtualWork(robot).along(motion),
        "distribute": rp.distribute(reduced),
        "lift": lifted,
        "classify_motion": rp.classify_motion(lifted),
        "find_crossings()[0]": crossing,
        "joint_reactions": rp.joint_reactions(along, rp.distribute(along.reduce()).tau),
        "plan": plan,
        "plan.limits": plan.limits,
        "plan.limits.violated[0]": plan.limits.violated[0],
        "plan.robot": plan.robot,
        "plan_reference": rp.simulation.plan_reference(plan),
        "simulate": run,
        "simulate().statistics": run.statistics,
        "show": rp.show(robot),
    }
    return {name: sorted(members(type(value))) for name, value in made.items()}


# ------------------------------------------------------------------------------------------------- documented imports


def documented_imports() -> list[str]:
    """Return the imports from this package that README, pages, examples and notebooks show, without outside engines."""
    imports: set[str] = set()
    for path in (
        ROOT / "README.md",
        *sorted((ROOT / "docs").rglob("*")),
        *sorted((ROOT / "notebooks").glob("*.ipynb")),
    ):
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in (".md", ".py", ".ipynb") and name not in BUILDING and "/modules/" not in name:
            for code in _code(path):
                imports |= set(_imports(code))
    return sorted(entry for entry in imports if "engines" not in entry)


def _code(path: Path) -> Iterator[str]:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        for cell in json.loads(text)["cells"]:
            if cell["cell_type"] == "code":
                yield "".join(cell["source"])
    elif path.suffix == ".md":
        yield from re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    else:
        yield text


def _imports(code: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(re.sub(r"^[%!].*$", "", code, flags=re.MULTILINE))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "redundancy_pin":
            for alias in node.names:
                yield f"from {node.module} import {alias.name}"
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "redundancy_pin":
                    yield f"import {alias.name}"


# --------------------------------------------------------------------------------------------------- JSON and tables


def structure(value: Any) -> Any:
    """Return keys and types of JSON data; the entries of a list are merged into one."""
    if isinstance(value, dict):
        return {key: structure(entry) for key, entry in value.items()}
    if isinstance(value, list):
        merged: Any = None
        for entry in value:
            merged = structure(entry) if merged is None else _merge(merged, structure(entry))
        return [] if merged is None else [merged]
    if value is None:
        return "null"
    return {bool: "truth value", int: "integer", float: "number", str: "text"}[type(value)]


def _merge(one: Any, other: Any) -> Any:
    if isinstance(one, dict) and isinstance(other, dict):
        return {
            key: _merge(one[key], other[key]) if key in one and key in other else one.get(key, other.get(key))
            for key in (*one, *(key for key in other if key not in one))
        }
    if isinstance(one, list) and isinstance(other, list):
        return [_merge(one[0], other[0])] if one and other else one or other
    kinds = {*(_kinds(one)), *(_kinds(other))}
    return "|".join(sorted(kinds))


def _kinds(entry: Any) -> list[str]:
    if isinstance(entry, str):
        return entry.split("|")
    return ["object" if isinstance(entry, dict) else "list"]


def differences(pinned: Any, now: Any, where: str = "", *, types: bool = True) -> list[str]:
    """Return where JSON has lost a key or changed a type; further keys are allowed."""
    if isinstance(pinned, dict) and isinstance(now, dict):
        lost = [f"{where}.{key} is gone" for key in pinned if key not in now]
        return lost + [
            line
            for key in pinned
            if key in now
            for line in differences(pinned[key], now[key], f"{where}.{key}", types=types)
        ]
    if isinstance(pinned, list) and isinstance(now, list):
        return differences(pinned[0], now[0], f"{where}[]", types=types) if pinned and now else []
    if types and pinned != now:
        return [f"{where} is {now}, was {pinned}"]
    return []


def headline_table() -> list[list[str]]:
    """Return the rows of the README's table of largest efforts, headings first."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"results/headline\.md -->\n(.*?)<!-- end of headline -->", text, flags=re.DOTALL)
    rows = [[part.strip() for part in line.strip().strip("|").split("|")] for line in table.strip().splitlines()]
    return [rows[0], *rows[2:]]
