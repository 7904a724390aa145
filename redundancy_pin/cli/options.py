"""Options that commands share: the robot, its motion, loads, and the keywords of a function of the package as flags.

A keyword has one spelling: ``ramp_down`` in Python and in a problem file is ``--ramp-down`` here. The form of its
values, its default and its help are those of the signature and of the docstring.
"""

from __future__ import annotations

import functools
import inspect
import re
import typing
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click
import numpy as np
from click.shell_completion import CompletionItem
from numpy.typing import ArrayLike

from redundancy_pin.arrays import LARGEST, decimal, frozen
from redundancy_pin.cli.errors import print_line
from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.io.reading import is_file

if TYPE_CHECKING:
    from redundancy_pin.dynamics.base import Dynamics
    from redundancy_pin.motion import CarrierMotion, PlatformMotion
    from redundancy_pin.planners.plan import Plan
    from redundancy_pin.robot import Robot
    from redundancy_pin.simulation import Simulation
    from redundancy_pin.trajectory import Trajectory

_Command = TypeVar("_Command", bound=Callable[..., Any])
Reader = Callable[[str, Any], Any]
"""From a name and a value as flags and files write it to the value that a function takes; InputError for others."""


# --- values ----------------------------------------------------------------------------------------------------------


def refusal(name: str, value: object, expected: str, example: str) -> InputError:
    """Return the error for a value that is not what is expected."""
    return InputError(f"{name} is {shown(value)}, {expected}.", remedy=f"Write {example}.", name=name)


def number(name: str, value: object) -> float:
    """Return a number; text with one is accepted (YAML reads ``1e-3`` as text)."""
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float, str)):
            return decimal(value) if isinstance(value, str) else float(value)
    except (ValueError, OverflowError):
        pass
    raise refusal(name, value, "not a number", "a number, such as 0.5 (SI units)")


def numbers(name: str, value: object) -> Any:
    """Return a number, or an array of the numbers of nested lists or of text: ``0.1,-0.1``, or rows ``0,1;2,3``."""
    if isinstance(value, str) and ";" in value:
        value = value.split(";")
    if isinstance(value, str) and "," in value:
        value = [part.strip() for part in value.split(",")]
    if not isinstance(value, list):
        return number(name, value)
    rows = [numbers(name, entry) for entry in value]
    if len({np.shape(row) for row in rows}) != 1:
        raise refusal(name, value, "not a row of numbers", "[0.1, -0.1]")
    return frozen(rows)


def whole(name: str, value: object) -> int:
    """Return a whole number."""
    result = number(name, value)
    if not result.is_integer():
        raise refusal(name, value, "not a whole number", "a number such as 4")
    return int(result)


def word(name: str, value: object) -> str:
    """Return a word as it stands: the function that takes it knows which there are."""
    if not isinstance(value, str):
        raise refusal(name, value, "not a word", "text")
    return value


def number_or_word(name: str, value: object) -> float | str:
    """Return a number, or else a word."""
    try:
        return number(name, value)
    except InputError:
        return word(name, value)


def truth(name: str, value: object) -> bool:
    """Return a truth value."""
    if not isinstance(value, bool):
        raise refusal(name, value, "neither true nor false", "true or false")
    return value


def bounds(name: str, value: object) -> dict[str, float]:
    """Return numbers by name: from a mapping, or from words such as ``peak=2``."""
    words = [value] if isinstance(value, str) else value
    for entry in words if isinstance(words, (list, tuple)) else ():
        if isinstance(entry, str) and "=" not in entry:
            raise refusal(name, entry, "without a number", f"{entry}=NUMBER")
    result = weights(name, words)
    return {} if isinstance(result, str) else result


def weights(name: str, value: object) -> str | dict[str, float]:
    """Return one word, or the weights of several: from a mapping, or from words such as ``effort`` and ``peak=2``."""
    if isinstance(value, Mapping):
        return {str(key): _number_of(name, str(key), weight) for key, weight in value.items()}
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, Sequence) or not all(isinstance(entry, str) for entry in words):
        raise refusal(name, value, "neither a word nor weights", "effort, or {effort: 1, peak: 2}")
    if len(words) == 1 and "=" not in words[0]:
        return str(words[0])
    result: dict[str, float] = {}
    for entry in words:
        key, separator, weight = (part.strip() for part in entry.partition("="))
        if key in result:
            raise InputError(f"{name} has {shown(key)} twice.", remedy="Leave one of them out.", name=name)
        result[key] = _number_of(name, key, weight) if separator else 1.0
    return result


def _number_of(name: str, key: str, value: object) -> float:
    """Return the number of one of several words."""
    try:
        return number(name, value)
    except InputError as error:
        raise InputError(f"{key} in {name} is {shown(value)}, not a number.", remedy=error.remedy, name=name) from None


def require_known(given: Mapping[str, object], known: Sequence[str], where: str) -> None:
    """Check that every key is known to what takes them, such as "the circle"."""
    for key in given:
        if key not in known:
            takes = f"It takes {', '.join(known)}." if known else "It takes none."
            message = f"{where[:1].upper()}{where[1:]} has no key {shown(str(key))}."
            raise InputError(message, remedy=f"{did_you_mean(key, known)}{takes}", key=str(key))


def require_choice(value: object, known: Sequence[str], where: str) -> str:
    """Return a value that must be one of a few words."""
    if isinstance(value, str) and value in known:
        return value
    remedy = f"{did_you_mean(value, known)}Choose one of {', '.join(known)}."
    raise InputError(f"{where[:1].upper()}{where[1:]} is {shown(value)}.", remedy=remedy, value=value)


# --- keywords of a function as flags ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Keyword:
    """A keyword of a function: how its value is read and written, its default, and what its docstring says of it."""

    name: str
    read: Reader
    metavar: str
    default: object
    text: str
    words: Sequence[str] = ()

    def option(self, command: _Command) -> _Command:
        """Add its flag to a command, which gets None where the flag is left out."""
        flag = f"--{self.name.replace('_', '-')}"
        if self.read is truth:
            off = f"--no-{flag[2:]}"
            text = f"{self.text}  [default: {flag if self.default else off}]"
            return click.option(f"{flag}/{off}", default=None, help=text)(command)
        default = "" if self.default in (None, inspect.Parameter.empty) else f"  [default: {self.default}]"
        is_repeated = self.read in (weights, bounds)
        return click.option(
            flag,
            metavar=self.metavar,
            multiple=is_repeated,
            shell_complete=completed(self.words),
            help=f"{self.text}{' May be repeated.' if is_repeated else ''}{default}",
            callback=lambda _context, _option, value: None if value in (None, ()) else self.read(self.name, value),
        )(command)


_NOT_WRITTEN = ("progress", "baseline", "further")
"""Keywords that take functions or robots, or what only Python can define: a command has the baseline as parameters."""


def keywords_of(function: Callable[..., Any]) -> dict[str, Keyword]:
    """Return the keywords of a function by name; of a group of options its fields, except refused ones."""
    from redundancy_pin.planners.options import GROUPS

    call = function.__init__ if isinstance(function, type) else inspect.unwrap(function)  # type: ignore[misc]
    hints, texts, refused = typing.get_type_hints(call), documented(function), getattr(function, "refused", ())
    result: dict[str, Keyword] = {}
    for each in inspect.signature(function).parameters.values():
        group = GROUPS.get(each.name)
        if each.kind is not each.KEYWORD_ONLY:
            continue
        if group is None or not {group, group | None} & {hints[each.name], *typing.get_args(hints[each.name])}:
            result[each.name] = _keyword(each.name, hints[each.name], each.default, texts)
            continue
        inner, notes = typing.get_type_hints(group), documented(group)
        for one in fields(group):
            notes[each.name] = notes.get("weights", "")
            name = each.name if one.name == "weights" else one.name
            result[name] = _keyword(name, inner[one.name], one.default, notes)
    return {name: one for name, one in result.items() if name not in (*_NOT_WRITTEN, *refused)}


def _keyword(name: str, hint: Any, default: object, texts: Mapping[str, str]) -> Keyword:
    kinds = {kind for kind in typing.get_args(hint) or (hint,) if kind is not type(None)}
    literals = [kind for kind in (hint, *kinds) if typing.get_origin(kind) is Literal]
    words = [str(each) for literal in literals for each in typing.get_args(literal)]
    listed, text = "|".join(words), texts.get(name, "")
    maps = any(typing.get_origin(kind) is Mapping for kind in (hint, *kinds))
    row = f"NUMBER[,NUMBER...]{'[;...]' if re.search(r'[(]+[^,()]+, [^()]+[)]', text) else ''}"
    forms: tuple[tuple[bool, Reader, str], ...] = (
        (maps and str in kinds, weights, "NAME[=NUMBER]"),
        (maps, bounds, "NAME=NUMBER"),
        (set(typing.get_args(ArrayLike)) <= kinds, numbers, row),
        (bool(words), number_or_word if float in kinds else word, f"{listed}|NUMBER" if float in kinds else listed),
        (kinds == {bool}, truth, ""),
        (kinds == {int}, whole, "N"),
        (kinds == {float}, number, "NUMBER"),
        (True, word, "WORD"),
    )
    read, metavar = next((read, metavar) for fits, read, metavar in forms if fits)
    if maps:
        from redundancy_pin.planners.optimal import OBJECTIVES

        words = list(OBJECTIVES)
        text = f"{text} Names: {', '.join(words)}; rp.plan_whole_trajectory has their formulas."
    return Keyword(name, read, metavar, default, text, words)


def completed(words: Sequence[str] = (), *, files: bool = False) -> Callable[..., list[CompletionItem]]:
    """Return what completes a value in a shell: words, and names of files."""

    def items(_context: click.Context, _option: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(each) for each in words if each.startswith(incomplete)]
        return [*found, CompletionItem(incomplete, type="file")] if files else found

    return items


def documented(function: Any) -> dict[str, str]:
    """Return what the docstring of a function or a class says of each argument or attribute: the first sentence."""
    entries = re.findall(r"^    (\w+): (.+(?:\n {8}.+)*)", inspect.getdoc(function) or "", flags=re.MULTILINE)
    texts = {name: " ".join(text.replace("``", "").split()) for name, text in entries}
    sentences = {name: re.split(r"[.:](?: |$)", text)[0] for name, text in texts.items()}
    return {
        name: f"{one}." if re.match(r"(s|m|rad|N)\b|[^\x00-\x7f]", one) else f"{one[:1].upper()}{one[1:]}."
        for name, one in sentences.items()
    }


def keyword_options(*functions: Callable[..., Any], only: Sequence[str] = ()) -> Callable[[_Command], _Command]:
    """Add the keywords of functions as flags to a command, or ``only`` some of them."""

    def decorate(command: _Command) -> _Command:
        known = {name: one for function in functions for name, one in keywords_of(function).items()}
        for name in reversed(only or tuple(known)):  # the last one that is added is listed first
            command = known[name].option(command)
        return command

    return decorate


def read_keywords(function: Callable[..., Any], given: Mapping[str, object], who: str) -> dict[str, Any]:
    """Return the values of keywords of a function, as a file writes them, as it takes them."""
    known = keywords_of(function)
    require_known(given, tuple(known), who)
    return {name: known[name].read(name, value) for name, value in given.items() if value is not None}


# --- the robot -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RobotOptions:
    """Which robot: the arguments of ``load_robot``, from flags or from a problem file."""

    source: str
    settings: Mapping[str, float | bool | str] = field(default_factory=dict)
    working_mode: tuple[int, ...] | None = None
    gravity: tuple[float, ...] | None = None
    trust: bool = False
    untrusted: bool = False

    def load(self) -> Robot:
        """Load the robot."""
        from redundancy_pin.loading import idle_gravity, load_with
        from redundancy_pin.robot.checks import too_few_motors

        robot = load_with(
            self.source,
            self.settings,
            gravity=self.gravity,
            working_mode=self.working_mode,
            trust=self.trust,
            untrusted=self.untrusted,
        )
        for note in filter(None, (idle_gravity(robot, self.gravity), too_few_motors(robot))):
            print_line("warning", note)
        return robot

    def recorded(self, subject: Plan | Simulation) -> Robot:
        """Return the robot of a plan or a simulation; ``source`` says where its files are now."""
        from redundancy_pin.planners.robot_record import load_recorded

        if not self.is_robot_only:
            message = (
                f"--set, --working-mode and --gravity cannot change the robot of a {type(subject).__name__.lower()}."
            )
            raise InputError(message, remedy="Leave them out, or plan again.")
        return load_recorded(subject.robot, self.source or None, trust=self.trust)

    @property
    def is_robot_only(self) -> bool:
        """Whether nothing but the robot itself was given."""
        return not self.settings and self.working_mode is None and self.gravity is None


def parse_setting(text: str, example: str = "carrier_mass=2.0") -> tuple[str, float | bool | str]:
    """Return name and value of ``NAME=VALUE``."""
    name, separator, value = (part.strip() for part in text.partition("="))
    if not (separator and name and value):
        raise InputError(f"{shown(text)} is not NAME=VALUE.", remedy=f"Write {example}.", value=text)
    instead = {"gravity": "gravity", "working_mode": "working_mode", "source": "robot"}.get(name)
    if instead:
        remedy = f"It has a flag, --{instead.replace('_', '-')}, and a key, {instead}."
        raise InputError(f"{name} is no parameter of the robot.", remedy=remedy, value=text)
    if value.lower() in ("true", "false"):
        return name, value.lower() == "true"  # before numbers: xacro tells a truth value from 1
    try:
        return name, decimal(value)
    except ValueError:
        return name, value


def parse_mode(_: str, text: str) -> tuple[int, ...]:
    """Return the working mode that a row of signs stands for, ±1 a leg."""
    signs = {"+": 1, "-": -1}
    if not text or not set(text) <= set(signs):
        raise refusal("working_mode", text, "not a row of + and -", "+-+, one sign per leg")
    return tuple(signs[sign] for sign in text)


def parse_vector(_: str, given: Any) -> tuple[float, ...]:
    """Return gravity, m/s², from ``X,Y,Z`` or a list."""
    try:
        parts = given.split(",") if isinstance(given, str) else given
        vector = tuple(number("gravity", part) for part in parts)
    except (TypeError, InputError):
        vector = ()
    if len(vector) != 3 or not all(abs(part) <= LARGEST for part in vector):
        raise refusal("gravity", given, "not three numbers", "0,-9.81,0 (m/s²)")
    return vector


def by(read: Reader) -> Callable[..., Any]:
    """Return a callback of click: a command gets the value that is read, None where its flag is left out."""
    return lambda _context, option, text: None if text is None else read(option.name, text)


def settings_option(
    flag: str, name: str, text: str, example: str = "carrier_mass=2.0"
) -> Callable[[_Command], _Command]:
    """Return an option of ``NAME=VALUE`` pairs, which the command gets as a mapping."""

    def parse(_context: click.Context, _option: click.Parameter, texts: Sequence[str]) -> dict[str, Any]:
        given: dict[str, Any] = {}
        for key, value in (parse_setting(each, example) for each in texts):
            if key in given:
                raise InputError(f"{flag} has {shown(key)} twice.", remedy="Leave one of them out.", key=key)
            given[key] = value
        return given

    return click.option(flag, name, multiple=True, metavar="NAME=VALUE", help=text, callback=parse)


trust_option = click.option(
    "--trust", is_flag=True, help="Let the robot's xacro run any Python, with your rights: for files you trust."
)
untrusted_option = click.option(
    "--untrusted",
    is_flag=True,
    help="Let xacro and MuJoCo read the robot's files in a process with limits of time and memory.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead of text.")


def jobs_option(default: int) -> Callable[[_Command], _Command]:
    """Return the option ``--jobs``: how many processes share the work."""
    return click.option("--jobs", default=default, show_default=True, metavar="N", help="Processes; -1: one per core.")


def in_one(name: str, kind: Callable[..., Any], *own: Callable[..., Any]) -> Callable[[_Command], Callable[..., Any]]:
    """Add options, in this order, to a command that takes them as one object of a dataclass, its argument ``name``.

    The options have the names of its fields, as may further ones of the command (``untrusted_option``).
    """
    names = tuple(inspect.signature(kind).parameters)

    def decorate(command: _Command) -> Callable[..., Any]:
        @functools.wraps(command)
        def called(**given: Any) -> Any:
            values = {each: given.pop(each) for each in names if each in given}
            return command(**{name: kind(**values)}, **given)

        for option in reversed(own):  # the last one that is added is listed first
            called = option(called)
        return called

    return decorate


def robot_options(*, required: bool = True) -> Callable[[_Command], Callable[..., Any]]:
    """Add the flags of the robot to a command that takes them as one ``RobotOptions``, its argument ``robot``."""
    text = "Shipped robot (see `info`), robot.yaml, its folder, or a model file (URDF, xacro, MJCF, SDF)."
    mode = "Working mode, one sign per leg, such as +-+."
    default = {"required": True} if required else {"default": ""}
    return in_one(
        "robot",
        RobotOptions,
        click.option("--robot", "source", metavar="NAME|PATH", help=text, shell_complete=robots(), **default),
        settings_option("--set", "settings", "Parameter of the robot, such as carrier_mass=2.0. May be repeated."),
        click.option("--working-mode", metavar="SIGNS", callback=by(parse_mode), help=mode),
        click.option("--gravity", metavar="X,Y,Z", callback=by(parse_vector), help="Gravity, m/s²."),
        trust_option,
    )


def robots() -> Callable[..., list[CompletionItem]]:
    """Return what completes the name or path of a robot."""
    from redundancy_pin.robot.shipped import shipped_robots

    return completed(shipped_robots(), files=True)


def recorded_robot_options(command: _Command) -> _Command:
    """Add ``--robot`` (argument ``source``) and ``--trust`` to a command that reads a saved plan."""
    text = "The plan's robot, where it is neither shipped nor in its folder."
    option = click.option("--robot", "source", metavar="NAME|PATH", help=text, shell_complete=robots())
    return option(trust_option(command))


def backend_option(text: str = "How to compute.", names: Iterable[str] = ()) -> Callable[[_Command], _Command]:
    """Return the option ``--backend``, None where the user names none; by default it takes all backends."""
    from redundancy_pin.dynamics.backends import BACKENDS

    choice, default = click.Choice([*names] or list(BACKENDS)), "compiled; rnea without a C compiler"
    return click.option("--backend", type=choice, show_default=default, help=text)


def dynamics_of(robot: Robot, backend: str | None) -> Dynamics:
    """Return the dynamics that ``--backend`` names, the default ones for None; what they warn of goes to stderr."""
    from redundancy_pin.dynamics.backends import BACKENDS
    from redundancy_pin.dynamics.default import as_dynamics

    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        dynamics = as_dynamics(robot) if backend is None else BACKENDS[backend](robot)
    for note in notes:
        print_line("warning", str(note.message))
    return dynamics


def baseline_option(planner: Callable[..., Any]) -> Callable[[_Command], _Command]:
    """Return the option ``--baseline`` of a planner that can aim at a fraction of the efforts of another robot."""
    text = "Parameters that make the robot its own baseline: carriers=false. May be repeated."
    option = settings_option("--baseline", "baseline", text, "carriers=false")
    return option if "objective" in inspect.signature(planner).parameters else lambda command: command


# --- the motion ------------------------------------------------------------------------------------------------------

STEP = 5e-3
"""Default time between samples of a trajectory, s."""


@dataclass(frozen=True)
class MotionOptions:
    """Which motion: a trajectory by name, or a file of points or of samples with rates, as its columns say."""

    given: str | None
    check_rates: bool = True
    keys: Mapping[str, object] | None = None
    """Of the trajectory, by a problem file; else they are written behind its name."""
    folder: Path = Path()
    """Where the file is looked for."""

    @functools.cached_property
    def _parts(self) -> tuple[str, Mapping[str, object], bool]:
        """The trajectory or the path, its keys, and whether it is a path."""
        from redundancy_pin.trajectory.by_name import split_trajectory
        from redundancy_pin.trajectory.reference import TRAJECTORIES

        name, keys = split_trajectory(self.given or "") if self.keys is None else (self.given or "", self.keys)
        if not name or not isinstance(name, str) or name in TRAJECTORIES:
            return name, keys, False
        path = self.folder / name
        return (str(path), keys, True) if Path(name).suffix or is_file(path) else (name, keys, False)

    @property
    def file(self) -> str | None:
        """The file that the motion is read from; None for a trajectory by name."""
        name, _, is_path = self._parts
        return name if is_path else None

    @functools.cached_property
    def is_sampled(self) -> bool:
        """Whether the file holds samples with rates."""
        from redundancy_pin.trajectory.csv_file import has_rates

        return self.file is not None and not self.file.lower().endswith(".json") and has_rates(self.file)

    @property
    def described(self) -> str:
        """What the motion is, for reports."""
        if self.file is None:
            return str(self.given)
        return (
            f"{'samples' if self.is_sampled else 'a trajectory through the points'} of {self.folder / str(self.given)}"
        )

    def follow(self, who: str, robot: Robot, **settings: float | None) -> PlatformMotion | Trajectory:
        """Return the motion of a robot; ``who`` needs it, such as "A plan". Samples take neither keys nor settings."""
        if self.given is None:
            raise InputError(f"{who} needs a motion.", remedy="Name a trajectory or a file as its motion.")
        from redundancy_pin.trajectory import from_csv
        from redundancy_pin.trajectory.by_name import trajectory_by_name

        name, values, _ = self._parts
        if not self.is_sampled:
            try:
                return trajectory_by_name(name, values, robot)
            except InputError as error:
                details = {**error.details, "flag": "motion"}
                raise type(error)(error.message, remedy=error.remedy, **details) from error
        for key in (*values, *(key for key, value in settings.items() if value is not None)):
            message = f"{key} does not apply to a motion from a file that has rates."
            raise InputError(message, remedy="Leave it out, or the rates.", key=key)
        return from_csv(str(self.file), robot, check_rates=self.check_rates)

    def sampled(self, who: str, robot: Robot, dt: float = STEP) -> PlatformMotion:
        """Return the motion as ``follow``, a trajectory sampled every ``dt``, s."""
        motion = self.follow(who, robot)
        return motion.sample(dt) if hasattr(motion, "sample") else motion

    def carriers(self, robot: Robot) -> CarrierMotion | None:
        """Return the motion of the carriers that the file has; None without, or without a file."""
        from redundancy_pin.trajectory import carriers_from_csv

        return carriers_from_csv(str(self.file), robot, check_rates=self.check_rates) if self.is_sampled else None


def motion_options(what: str) -> Callable[[_Command], Callable[..., Any]]:
    """Add the options of a motion to a command that takes them as one ``MotionOptions``, its argument ``motion``.

    ``what`` says in their help what the motion is for, such as "to follow".
    """
    from redundancy_pin.trajectory.reference import TRAJECTORIES

    rates = "Refuse a motion whose rates are not those of its positions; poses to stand still in need --no-."
    words = (
        f"Motion {what}: a trajectory ({', '.join(TRAJECTORIES)}) with keys (docs/problem.yaml lists them), such as "
        "circle:speed=0.5 or 'points:points=1.0 0.4;1.0 0.5,speed=0.1,ramp_time=0.2,alpha=0'; a CSV of samples "
        "(t,x,y,xd,yd,xdd,ydd); or a CSV or JSON of points, such as way.csv:speed=0.1 (t,x,y; ends=rest: at rest at "
        "both ends)."
    )
    complete, metavar = completed(list(TRAJECTORIES), files=True), "NAME|FILE[:KEY=VALUE,...]"
    return in_one(
        "motion",
        MotionOptions,
        click.option("--motion", "given", metavar=metavar, help=words, shell_complete=complete),
        click.option("--check-rates/--no-check-rates", default=True, show_default=True, help=rates),
    )
