"""Options that several commands share, and how they become a robot and a trajectory."""

from __future__ import annotations

import functools
import inspect
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar

import click

from redundancy_pin.arrays import LARGEST, checked, decimal
from redundancy_pin.cli import output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.errors import InputError, did_you_mean, shown

if TYPE_CHECKING:
    from redundancy_pin.dynamics.base import Dynamics
    from redundancy_pin.motion import CarrierMotion, PlatformMotion
    from redundancy_pin.robot import Robot
    from redundancy_pin.robot.loads import Load
    from redundancy_pin.trajectory import Trajectory

_Command = TypeVar("_Command", bound=Callable[..., Any])


@dataclass(frozen=True)
class RobotOptions:
    """Which robot: the arguments of ``load_robot``, from flags or from a problem file."""

    source: str
    settings: Mapping[str, float | bool | str] = field(default_factory=dict)
    mode: tuple[int, ...] | None = None
    gravity: tuple[float, ...] | None = None
    trust: bool = False
    untrusted: bool = False

    def load(self) -> Robot:
        """Load the robot."""
        from redundancy_pin.loading import idle_gravity, load_with
        from redundancy_pin.robot.checks import too_few_motors

        gravity, files = self.gravity, {"trust": self.trust, "untrusted": self.untrusted}
        robot = load_with(self.source, self.settings, gravity=gravity, working_mode=self.mode, **files)
        for note in filter(None, (idle_gravity(robot, gravity), too_few_motors(robot))):
            click.echo(f"warning: {note}", err=True)
        return robot

    @property
    def is_robot_only(self) -> bool:
        """Whether nothing but the robot itself was given."""
        return not self.settings and self.mode is None and self.gravity is None


def _by(parse: Callable[[str], Any]) -> Callable[..., Any]:
    """Return a callback of click that parses what is given, so that commands get values and no text."""
    return lambda _context, _option, text: None if text is None else parse(text)


def robot_flags(command: _Command, *, required: bool = True) -> _Command:
    """Add ``--robot``, ``--set``, ``--mode``, ``--gravity`` and ``--trust`` to a command."""
    # decorators apply from the inside out: the help lists the last one first
    for option in (
        trust_option,
        click.option(
            "--gravity",
            metavar="X,Y,Z",
            callback=_by(parse_vector),
            help="Acceleration of gravity, m/s², such as 0,-9.81,0.",
        ),
        click.option(
            "--mode", metavar="SIGNS", callback=_by(parse_mode), help="Working mode, one sign a leg, such as +-+."
        ),
        settings_option("--set", "settings", "Parameter of the robot, such as carrier_mass=2.0; may be repeated."),
        click.option(
            "--robot",
            required=required,
            metavar="NAME|PATH",
            help="Shipped robot (see `info`), robot.yaml, its folder, or a model file (URDF, xacro, MJCF, SDF).",
        ),
    ):
        command = option(command)
    return command


def robot_options(*, required: bool = True) -> Callable[[_Command], Callable[..., Any]]:
    """Add the flags of the robot to a command that takes them as one ``RobotOptions``, its argument ``robot``."""

    def decorate(command: _Command) -> Callable[..., Any]:
        @functools.wraps(command)
        def called(robot: str | None, settings: Any, mode: Any, gravity: Any, trust: bool, **given: Any) -> Any:
            return command(robot=RobotOptions(robot or "", settings, mode, gravity, trust), **given)

        return robot_flags(called, required=required)

    return decorate


def trust_option(command: _Command) -> _Command:
    """Add ``--trust`` to a command; no file can say it."""
    text = "Let the robot's xacro run any Python, with your rights: for files whose author you trust."
    return click.option("--trust", is_flag=True, help=text)(command)


def untrusted_option(command: _Command) -> _Command:
    """Add ``--untrusted`` to a command."""
    text = "Let xacro and MuJoCo read the robot's files in a process with limits of time and memory."
    return click.option("--untrusted", is_flag=True, help=text)(command)


def recorded_robot_options(command: _Command) -> _Command:
    """Add ``--robot`` (argument ``source``) and ``--trust`` to a command that reads a saved plan."""
    text = "The plan's robot, where it is neither shipped nor in its folder."
    return click.option("--robot", "source", metavar="NAME|PATH", help=text)(trust_option(command))


def settings_option(flag: str, name: str, text: str) -> Callable[[_Command], _Command]:
    """Return an option of ``NAME=VALUE`` pairs, which the command gets as a mapping."""
    return click.option(
        flag,
        name,
        multiple=True,
        metavar="NAME=VALUE",
        help=text,
        callback=lambda _context, _option, texts: dict(parse_setting(each) for each in texts),
    )


def load_options(command: _Command) -> Callable[..., Any]:
    """Add ``--payload`` and ``--wrench``; the command gets both as its argument ``loads``."""

    @functools.wraps(command)
    def called(*args: Any, payload: Sequence[Load], wrench: Sequence[Load], **given: Any) -> Any:
        return command(*args, loads=(*payload, *wrench), **given)

    for name, make, numbers, text in (
        ("--wrench", _wrench, "FX,FY,FZ[,MX,MY,MZ]", "Force, N, and moment, N·m, on a link, in axes of the world"),
        ("--payload", _payload, "MASS[,X,Y,Z]", "Mass, kg, that a link carries, and where in its frame, m"),
    ):
        called = click.option(
            name,
            multiple=True,
            metavar=f"LINK={numbers}",
            help=f"{text}; may be repeated.",
            callback=lambda _context, option, texts, make=make: [
                make(*_link_and_numbers(f"--{option.name}", each, option.metavar)) for each in texts
            ],
        )(called)
    return called


def _link_and_numbers(name: str, text: str, form: str) -> tuple[str, list[float]]:
    """Return link and numbers of ``LINK=NUMBER,...``."""
    link, _, values = text.rpartition("=")
    allowed = {values.count(",") + 1 for values in (form.replace("[", "").replace("]", ""), form.partition("[")[0])}
    try:
        given = [decimal(value) for value in values.split(",")]
    except ValueError:
        given = []
    if not link.strip() or len(given) not in allowed:
        raise InputError(f"{name} {shown(text)} is not {form}.", remedy=f"Write {name} {form}.", value=text)
    return link.strip(), given


def _payload(link: str, values: list[float]) -> Load:
    from redundancy_pin.robot.loads import Payload

    return Payload(link, values[0], values[1:] or (0.0, 0.0, 0.0))


def _wrench(link: str, values: list[float]) -> Load:
    from redundancy_pin.robot.loads import Wrench

    return Wrench(link, [*values, *[0.0] * (6 - len(values))])


def json_option(command: _Command) -> _Command:
    """Add ``--json`` to a command (argument ``as_json``)."""
    option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout instead of text.")
    return option(command)


DEFAULT_BACKEND = "compiled; rnea without a C compiler"
"""What the default of ``--backend`` is; see ``dynamics.default``."""


def backend_option(text: str = "How to compute.", default: str = DEFAULT_BACKEND) -> Callable[[_Command], _Command]:
    """Return the option ``--backend``, None where the user names none; ``default`` is what the help says of that."""
    from redundancy_pin.dynamics.backends import BACKENDS

    return click.option("--backend", type=click.Choice(list(BACKENDS)), show_default=default, help=text)


def dynamics_of(robot: Robot, backend: str | None) -> Dynamics:
    """Return the dynamics that ``--backend`` names, the default ones for None; what they warn of goes to stderr."""
    from redundancy_pin.dynamics.backends import BACKENDS
    from redundancy_pin.dynamics.default import as_dynamics

    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        dynamics = as_dynamics(robot) if backend is None else BACKENDS[backend](robot)
    for note in notes:
        output.warning(str(note.message))
    return dynamics


def jobs_option(default: int) -> Callable[[_Command], _Command]:
    """Return the option ``--jobs``: how many processes share the work."""
    return click.option(
        "--jobs", default=default, show_default=True, metavar="N", help="Processes; -1: one for each core."
    )


def parse_setting(text: str) -> tuple[str, float | bool | str]:
    """Return name and value of ``NAME=VALUE``."""
    name, separator, value = text.partition("=")
    name, value = name.strip(), value.strip()
    if not (separator and name and value):
        raise InputError(f"--set {shown(text)} is not NAME=VALUE.", remedy="Write --set carrier_mass=2.0.", value=text)
    if name in ("gravity", "working_mode", "source"):
        instead = {"gravity": "--gravity", "working_mode": "--mode", "source": "--robot"}[name]
        raise InputError(f"--set cannot change {name}.", remedy=f"Use {instead}.", value=text)
    if value.lower() in ("true", "false"):
        return name, value.lower() == "true"  # before numbers: xacro tells a truth value from 1
    try:
        return name, decimal(value)
    except ValueError:
        return name, value


def parse_mode(text: str) -> tuple[int, ...]:
    """Return the working mode that a row of signs stands for, ±1 a leg."""
    signs = {"+": 1, "-": -1}
    if not text or not set(text) <= set(signs):
        raise InputError(f"--mode {shown(text)} is not a row of + and -.", remedy="Write --mode +-+, one sign a leg.")
    return tuple(signs[sign] for sign in text)


def parse_vector(given: Any) -> tuple[float, ...]:
    """Return gravity, m/s², from ``X,Y,Z`` or a list."""
    try:
        text = isinstance(given, str)
        numbers = tuple(map(decimal, given.split(","))) if text else tuple(float(part) for part in given)
    except (TypeError, ValueError, OverflowError):
        numbers = ()
    if len(numbers) != 3 or not all(abs(number) <= LARGEST for number in numbers):
        raise InputError(f"gravity is {shown(given)}, not three numbers.", remedy="Write 0,-9.81,0 (m/s²).")
    return numbers


STEP = 5e-3
"""Default time between samples of a trajectory, s."""

MOTION_CSV = "a CSV of samples (t,x,y,xd,yd,xdd,ydd) or of points (t,x,y)."
"""What ``--motion`` takes, for help."""

FLAGS = {
    "speed": "Cruising speed of the trajectory, m/s.",
    "radius": "Corner radius, m.",
    "ramp_time": "Duration of each speed ramp, s.",
    "ramp_length": "Arc length of the ramp, m.",
    "straight": "Length of each straight of the corner, m.",
    "side": "Side of the square, m.",
    "alpha": "Constant orientation of the platform, rad.",
}
"""Keys of trajectories that are flags of their own; the rest can be written as ``name:key=value``."""


def flag(name: str) -> str:
    """Return the flag of a parameter: ``--ramp-time``."""
    return f"--{name.replace('_', '-')}"


def require_known(given: Iterable[object], known: Sequence[str], where: str) -> None:
    """Check that every key is known to what takes them, such as "the circle"."""
    for key in given:
        if key not in known:
            takes = f"It takes {', '.join(known)}." if known else "It takes none."
            raise InputError(
                f"{_capital(where)} has no key {shown(str(key))}.",
                remedy=f"{did_you_mean(key, known)}{takes}",
                key=str(key),
            )


def require_choice(value: object, known: Sequence[str], where: str) -> str:
    """Return a value that must be one of a few words."""
    if isinstance(value, str) and value in known:
        return value
    remedy = f"{did_you_mean(value, known)}Choose one of {', '.join(known)}."
    raise InputError(f"{_capital(where)} is {shown(value)}.", remedy=remedy, value=value)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _trajectories() -> Mapping[str, Callable[..., Trajectory]]:
    from redundancy_pin.trajectory.reference import TRAJECTORIES  # `info` shares this file, and has no use for planners

    return TRAJECTORIES


def _maker(name: object, robot: Robot | None = None) -> Callable[..., Trajectory] | None:
    """Return what makes the trajectory of a name or of a file of points; None where there is no such name."""
    if is_points_file(name):
        from redundancy_pin.trajectory import from_points

        return functools.partial(from_points, name, robot=robot)
    return _trajectories().get(name) if isinstance(name, str) else None  # a file may say anything


def is_points_file(name: object) -> TypeGuard[str]:
    """Return whether the name of a trajectory is that of a file of points."""
    return isinstance(name, str) and name.lower().endswith((".csv", ".json"))


def make_trajectory(name: str, options: Mapping[str, Any], robot: Robot | None = None) -> Trajectory:
    """Return a trajectory by name, or through the points of a file, whose columns are those of the robot."""
    # the maker's signature is the schema: a new trajectory needs no table of its keys here
    make = _maker(name, robot) or _trajectories()[require_choice(name, tuple(_trajectories()), "the trajectory")]
    parameters = {key: one for key, one in inspect.signature(make).parameters.items() if key != "robot"}
    where = f"the trajectory {name}"
    require_known(options, tuple(parameters), where)
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and key not in options:
            raise InputError(f"The trajectory {name} lacks the key {key!r}.", remedy=f"Add {key}.", key=key)
    return make(**{key: _value(key, value, where) for key, value in options.items()})


def parse_trajectory(text: str, flags: Mapping[str, float | str | None], robot: Robot | None = None) -> Trajectory:
    """Return the trajectory that ``name`` or ``name:key=value,...`` and flags describe together."""
    name, texts = split_trajectory(text)
    options = trajectory_values(name, texts)
    given = {key: value for key, value in flags.items() if value is not None}
    maker = _maker(name)
    known = inspect.signature(maker).parameters if maker else given
    for key in given:
        if key in options:
            remedy = f"Leave {flag(key)} or {key}= out."
            raise InputError(f"{key} of the {name} is given twice.", remedy=remedy, key=key)
        if key not in known:
            remedy = f"It takes {', '.join(known)}."
            raise InputError(f"The trajectory {name} takes no {flag(key)}.", remedy=remedy, key=key)
    with in_words(OPTIONS.knowing({key: flag(key) for key in given})):
        return make_trajectory(name, {**options, **given}, robot)


@dataclass(frozen=True)
class MotionOptions:
    """Which motion: a trajectory with its flags, or a file, of points or of samples with rates.

    Both options take both kinds of files: what is in a file decides.
    """

    path: str | None
    check_rates: bool
    trajectory: str | None = None
    flags: Mapping[str, float | str | None] = field(default_factory=dict)

    @property
    def given(self) -> str | None:
        """What either option was given."""
        return self.path if self.trajectory is None else self.trajectory

    @property
    def file(self) -> str | None:
        """The file that the motion is read from; None for a trajectory by name."""
        if self.trajectory is None:
            return self.path
        name = split_trajectory(self.trajectory)[0]
        return name if is_points_file(name) else None

    @functools.cached_property
    def is_sampled(self) -> bool:
        """Whether the file holds samples with rates."""
        from redundancy_pin.trajectory.csv_file import has_rates

        return self.file is not None and not self.file.lower().endswith(".json") and has_rates(self.file)

    @property
    def described(self) -> str:
        """What the motion is, for reports."""
        if self.file is None:
            return str(self.trajectory)
        return f"{'samples' if self.is_sampled else 'a trajectory through the points'} of {self.given}"

    def follow(self, who: str, robot: Robot, **settings: float | None) -> PlatformMotion | Trajectory:
        """Return the motion of a robot; ``who`` needs it, such as "A plan". Samples take neither flags nor settings."""
        if (self.trajectory is None) == (self.path is None):
            raise InputError(f"{who} needs either --trajectory or --motion.", remedy="Give one of them.")
        if not self.is_sampled:
            return parse_trajectory(str(self.given), self.flags, robot)
        from redundancy_pin.trajectory import from_csv

        # refused rather than ignored: --speed beside samples would seem to have an effect
        own = {} if self.trajectory is None else split_trajectory(self.trajectory)[1]
        for name, value in {**self.flags, **settings, **own}.items():
            if value is not None:
                raise InputError(
                    f"{flag(name)} does not apply to a motion from a file that has rates.",
                    remedy="Leave it out, or the rates.",
                )
        return from_csv(str(self.file), robot, check_rates=self.check_rates)

    def sampled(self, who: str, robot: Robot) -> PlatformMotion:
        """Return the motion as ``follow``, a trajectory sampled every ``STEP``, s."""
        motion = self.follow(who, robot)
        return motion.sample(STEP) if hasattr(motion, "sample") else motion

    def carriers(self, robot: Robot) -> CarrierMotion | None:
        """Return the motion of the carriers that the file has; None without, or without a file."""
        from redundancy_pin.trajectory import carriers_from_csv

        return carriers_from_csv(str(self.file), robot, check_rates=self.check_rates) if self.is_sampled else None


def split_trajectory(text: str) -> tuple[str, dict[str, str]]:
    """Return the name, or the file, and the options, as text, of ``name:key=value,...``."""
    file = re.match(r"(.*?\.(?:csv|json))(?::(.*))?$", text, re.IGNORECASE)
    name, rest = (file[1], file[2] or "") if file else text.partition(":")[::2]
    options: dict[str, str] = {}
    for pair in filter(None, rest.split(",")):
        key, separator, value = pair.partition("=")
        if not separator:
            raise InputError(f"{shown(pair)} of the trajectory is not KEY=VALUE.", remedy="Write circle:speed=0.5.")
        options[key.strip()] = value.strip()
    return name, options


def trajectory_values(name: str, texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the values of the keys of a trajectory; as ``trajectory_value``."""
    return {key: trajectory_value(key, text, f"the trajectory {name}") for key, text in texts.items()}


def trajectory_value(key: str, text: str, where: str) -> Any:
    """Return the value of a key: a number, true or false, a row as ``1.0 0.4``, or rows between ``;``, or words."""
    if text in ("true", "false"):
        return text == "true"
    if key == "ends":
        words = text.split()
        return words[0] if len(words) == 1 else words
    if (key, text) in (("times", "time-optimal"), ("shape", "3-4-5"), ("shape", "4-5-6-7")):
        return text
    try:
        # commas part the pairs of a trajectory already: rows have blanks and semicolons
        if ";" in text:
            return [[float(number) for number in row.split()] for row in text.split(";") if row.strip()]
        row = [float(number) for number in text.split()]
    except ValueError:
        row = []
    if not row:
        wanted = "Write a number, a row such as 1.0 0.4, or rows such as 1.0 0.4;1.0 0.5."
        raise InputError(f"{key} of {where} is {shown(text)}, neither a number nor rows.", remedy=wanted, key=key)
    return row[0] if len(row) == 1 else row


def trajectory_option(what: str) -> Callable[[_Command], _Command]:
    """Return the option ``--trajectory``; its help says what the trajectory is for."""
    return click.option(
        "--trajectory",
        metavar="NAME|FILE[:KEY=VALUE,...]",
        help=f"{what}: {', '.join(_trajectories())}; such as circle:speed=0.5, or "
        "'points:points=1.0 0.4;1.0 0.5,speed=0.1,ramp_time=0.2,alpha=0'. Or through the points of a CSV or JSON file: "
        "way.csv (columns t,x,y), way.csv:speed=0.1, way.csv:times=time-optimal,max_speed=0.5,max_acceleration=2. "
        "A CSV with rates is a motion, as of --motion.",
    )


def motion_options(
    text: str, trajectory: str | None = None, *, flags: Mapping[str, str] = {}
) -> Callable[[_Command], Callable[..., Any]]:
    """Add the options of a motion to a command that takes them as one ``MotionOptions``, its argument ``motion``.

    ``text`` is the help of ``--motion``, ``trajectory`` the beginning of that of ``--trajectory``, which is left out
    without; ``flags`` are keys of trajectories that have options of their own, with their help.
    """

    def decorate(command: _Command) -> Callable[..., Any]:
        @functools.wraps(command)
        def called(*args: Any, motion_path: Any, check_rates: Any, trajectory: Any = None, **given: Any) -> Any:
            own = {key: given.pop(key) for key in (*flags, *(["ends"] if "ends" in given else []))}
            return command(*args, motion=MotionOptions(motion_path, check_rates, trajectory, own), **given)

        added = number_options({flag(name): help_text for name, help_text in flags.items()})(called)
        added = click.option(
            "--check-rates/--no-check-rates",
            default=True,
            show_default=True,
            help="Refuse a motion whose rates are not those of its positions; poses to stand still in need --no-.",
        )(added)
        added = click.option("--motion", "motion_path", metavar="CSV", help=text)(added)
        return trajectory_option(trajectory)(_ends_option(added)) if trajectory else added

    return decorate


def _ends(text: str | None, words: Sequence[str]) -> str | list[str] | None:
    """Return the word, or the pair of words, of ``--ends``."""
    if text is None:
        return None
    given = re.split(r"[,\s]+", text.strip())
    for word in given:
        require_choice(word, tuple(words), "--ends")
    return given[0] if len(given) == 1 else given


def _ends_option(command: _Command) -> _Command:
    """Return the option ``--ends``, the argument of ``from_points``."""
    from redundancy_pin.trajectory.waypoints import ENDS  # as ``_trajectories``

    return click.option(
        "--ends",
        callback=lambda _, __, text: _ends(text, ENDS),
        metavar="|".join(ENDS),
        help="Of points with times: start and end at rest, or with the rates of the samples; auto: as the points show; "
        "a pair such as rest,samples for start and end.",
    )(command)


def trajectory_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--trajectory``, ``--motion`` and all flags of trajectories to a command."""
    text = f"Motion to follow instead: {MOTION_CSV}"
    return motion_options(text, "Trajectory to follow", flags=FLAGS)(command)


def number_options(texts: Mapping[str, str]) -> Callable[[_Command], _Command]:
    """Return options that take a number each, with their help."""

    def decorate(command: _Command) -> _Command:
        for name, text in reversed(list(texts.items())):  # the last one that is added is listed first
            command = click.option(name, type=float, metavar="NUMBER", help=text)(command)
        return command

    return decorate


def _value(key: str, value: object, where: str) -> Any:
    """Return a value as a number, a truth value or rows of numbers."""
    if isinstance(value, (bool, list)) or value is None:
        return value
    if isinstance(value, str):
        return trajectory_value(key, value, where)
    return float(checked(value, f"{key} of {where}", ()))  # type: ignore[arg-type]
