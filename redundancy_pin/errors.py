"""One tree of errors: each states the problem, the numbers and the remedy."""

from __future__ import annotations

import decimal
import difflib
import importlib
import reprlib
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

_LONGEST = 4000
"""Characters of a message or a remedy: a file that is refused must not fill the screen with what is in it."""

_SHOWN = 300
"""Characters of a value in a message."""

_ROUND_DOWN = decimal.Context(prec=3, rounding=decimal.ROUND_DOWN)


class RedundancyPinError(Exception):
    """Root of every error this package raises on purpose.

    Attributes:
        message: the problem, numbers included.
        remedy: what the user can do about it (may be empty).
        details: the numbers behind the message, by name, for programs that handle the error.
    """

    def __init__(self, message: str, *, remedy: str = "", **details: object) -> None:
        self.message = message = shortened(message, _LONGEST)
        self.remedy = remedy = shortened(remedy, _LONGEST)
        self.details: Mapping[str, object] = MappingProxyType(dict(details))
        super().__init__(f"{message} {remedy}".strip())

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling, so that an error of a worker process reaches the caller whole."""
        return _rebuild, (type(self), self.message, self.remedy, dict(self.details))


def _rebuild(
    kind: type[RedundancyPinError], message: str, remedy: str, details: dict[str, object]
) -> RedundancyPinError:
    return kind(message, remedy=remedy, **details)


def shown(value: object) -> str:
    """Return ``repr(value)`` for a message, shortened if it is long.

    Values come from untrusted files: a few aliases in YAML make one of any size, so it must not be written
    out before it is cut.
    """
    try:
        text = repr(value) if _is_small(value) else reprlib.repr(value)
        text = text if isinstance(value, str) else " ".join(text.split())  # arrays are written in many lines
    except ValueError:  # Python writes out no integer of more than 4300 digits
        text = f"a {type(value).__name__} of thousands of digits"
    return shortened(text)


def _is_small(value: object, most: int = 100) -> bool:
    """Whether a value has few parts, counted as often as they are met, and short texts."""
    waiting = [value]
    for _ in range(most):
        if not waiting:
            return True
        part = waiting.pop()
        if isinstance(part, (str, bytes)) and len(part) > _SHOWN:
            return False
        if isinstance(part, (list, tuple, dict, set, frozenset)):
            if len(part) > most:
                return False
            waiting += part
            waiting += part.values() if isinstance(part, dict) else ()
    return False


def shortened(text: str, most: int = _SHOWN) -> str:
    """Return a text for a message, without its middle if it is longer than ``most`` characters."""
    return text if len(text) <= most else f"{text[: most // 2]} … {text[-most // 4 :]}"


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the start of a remedy that names a known name: one that begins so, else the nearest; empty if none is."""
    text, names = str(name)[:_SHOWN], list(known)
    begun = [each for each in names if len(text) > 1 and each.startswith(text)]
    close = difflib.get_close_matches(text, begun, n=1, cutoff=0.0) or difflib.get_close_matches(text, names, n=1)
    return f"Did you mean {shown(close[0])}? " if close else ""


def one_of(name: object, known: Iterable[str], what: str = "It has") -> str:
    """Return the remedy for a name that is not among the known ones: the nearest, and all of them."""
    known = tuple(known)
    return f"{did_you_mean(name, known)}{what}: {', '.join(known) or 'none'}."


_TIMES_THE_SIZE, _LARGE = 20.0, 50.0
"""A length that is so many sizes of a machine, and a machine of so many metres, are probably in millimetres."""


def rounded_down(value: float) -> str:
    """Return a positive number with three digits, never above it: "at most" in a message is then accepted."""
    return f"{float(_ROUND_DOWN.create_decimal_from_float(value)):g}"


def millimetres(length: float, size: float) -> str:
    """Return a hint, for the end of a message, that lengths look like millimetres; empty where they do not.

    ``length``: m, by how much something that should be reached is missed; ``size``: m, of the machine, or of a track.
    """
    if length > _TIMES_THE_SIZE * size > 0.0:
        return f" That is {length / size:.3g} times its size, {size:.3g} m: it looks like millimetres; write metres."
    if size > _LARGE:
        return f" Its size is {size:.3g} m: it looks like millimetres; write metres."
    return ""


def optional(package: str, who: str, remedy: str) -> Any:
    """Import a package that not everybody has, which ``who`` needs ("Plots need"); RedundancyPinError without it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        name = "dask.distributed" if package == "distributed" else package
        raise RedundancyPinError(f"{who} {name}, which is not installed.", remedy=remedy) from error


class InputError(RedundancyPinError, ValueError):
    """An argument has the wrong shape, a value that is not finite, or is out of its domain."""


class ModelFileError(RedundancyPinError):
    """A robot's files are missing, unreadable, or not valid URDF, xacro or YAML."""


class DeclarationError(RedundancyPinError):
    """A robot's declaration contradicts itself, its URDF, or the mobility of the mechanism."""


class UnreachablePoseError(RedundancyPinError):
    """No configuration closes the chains at a pose; carries the closure residual and the sample."""


class SingularPoseError(RedundancyPinError):
    """The platform velocity does not determine the joint velocities (type I); carries sample and margin."""


class WorkingModeError(RedundancyPinError):
    """A motion leaves the working mode it started in; carries the leg and the sample."""


class CarrierLimitError(RedundancyPinError):
    """A carrier would leave its track or exceed a limit; carries carrier, sample and amount."""


class UnsupportedRobotError(RedundancyPinError):
    """A backend or closed form does not cover this robot."""


class CompilerError(RedundancyPinError):
    """Generated code cannot be compiled: no C compiler, or one that fails; carries the reason."""


class InfeasiblePlanError(RedundancyPinError):
    """No plan exists; names the constraint, the time and the amount."""


class PlanFileError(RedundancyPinError):
    """A saved plan is missing, damaged, of a newer format or another kind of file; or its robot has changed."""


class OutputError(RedundancyPinError):
    """A result cannot be written to the requested place; nothing was written."""


class CrossCheckError(RedundancyPinError):
    """Two independent computations of the same quantity disagree."""


class IllPosedModelError(RedundancyPinError):
    """Forces do not determine the motion: a free motion has no inertia; carries condition number and direction."""
