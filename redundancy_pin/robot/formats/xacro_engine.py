"""Expand xacro files by xacro itself, with expressions that are data, files of the model only, and bounded work.

Everything that ties the package to the insides of xacro is here. A copy of its modules is loaded under a name of our
own; in the copy, what evaluates, opens files or looks at the machine is replaced. A user's xacro stays as it is. The
copy has no ``eval``, ``exec``, ``compile`` or ``open`` of Python: a later xacro that calls them elsewhere fails.
"""

from __future__ import annotations

import contextlib
import functools
import glob
import importlib
import importlib.util
import io
import json
import logging
import os
import re
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.dom import minidom
from xml.parsers import expat

from redundancy_pin.errors import ModelFileError, RedundancyPinError, shortened
from redundancy_pin.io.limited import answer, run_limited
from redundancy_pin.io.reading import is_file
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.robot.formats.expressions import FUNCTIONS, Evaluator, ExpressionError, Namespace
from redundancy_pin.robot.formats.packages import find_package, is_within, may_include, own_folders
from redundancy_pin.robot.formats.xml_files import parsed_text, read_model

_DEEPEST_INCLUDES = 30
_LONGEST_TEXT = 200_000
"""Characters of a text in a model, after evaluation."""

_LOCK = threading.Lock()
"""xacro keeps its stacks in globals of its modules: two threads at once would empty each other's."""

_MODULE = "redundancy_pin.robot.formats.xacro_engine"
_log = logging.getLogger("redundancy_pin.xacro")


def expand(
    path: Path, given: Mapping[str, str], *, trust: bool = False, untrusted: bool = False
) -> tuple[str, dict[str, str]]:
    """Return the URDF that a xacro file gives, and its arguments, as texts, those that were left out included.

    Arguments that the file neither declares nor reads on the way are left out of the answer.

    Args:
        path: the file.
        given: arguments, as texts.
        trust: evaluate expressions as Python, by xacro itself and without limits.
        untrusted: expand in a child process with limits of time and memory.

    Raises:
        ModelFileError: an expression that fails or that models may not use, files of other folders, or more work than a
            model may take.
    """
    if untrusted:
        text, resolved = json.loads(run_limited(_MODULE, [str(path), json.dumps(dict(given))], str(path)))
        return text, resolved
    arguments = _Arguments(given)  # xacro adds those that were left out, their defaults evaluated
    with _LOCK:
        engine = _engine(trust)
        try:
            text = engine.expand(path, arguments)
        except RedundancyPinError:
            raise
        except Exception as error:  # expressions raise anything
            raise engine.refusal(path, error) from error
    return text, {name: str(value) for name, value in arguments.items() if name in arguments.known}


class _Arguments(dict[str, str]):
    """Arguments that remember which of their names a file declares or reads."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.known = set[str]()

    def __contains__(self, name: object) -> bool:
        self.known.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known.add(name)
        return super().__getitem__(name)


@functools.lru_cache(maxsize=2)
def _engine(trust: bool) -> _Engine:
    return _Engine(trust)


class _Engine:
    """A copy of xacro. The expressions of files that are not trusted are data."""

    def __init__(self, trust: bool) -> None:
        self.xacro, self._write = _copy_of_xacro("_trusted" if trust else "_closed")
        self.xacro.substitution_args._eval_find = self._find
        self._path = Path()
        self._folders: tuple[Path, ...] = ()
        self._evaluator = Evaluator({})
        self._failure: tuple[str, Exception] | None = None
        if not trust:
            self._close()

    def expand(self, path: Path, resolved: dict[str, str]) -> str:
        """Return what a file expands to; arguments that were left out are added to ``resolved``."""
        self._path, self._folders = path, own_folders(path)
        self._evaluator, self._failure = Evaluator({}), None
        document = self.xacro.process_file(str(path.resolve()), mappings=resolved)
        for element in document.getElementsByTagName("*"):  # in the layout of xacro, for these elements alone
            element.writexml = self._write.__get__(element)
        return str(document.toprettyxml(indent="  "))

    def _close(self) -> None:
        """Replace the functions of xacro that evaluate, open files, or look at the machine."""
        module, substitutions = self.xacro, self.xacro.substitution_args
        for each in (module, substitutions):
            vars(each).update(dict.fromkeys(("eval", "exec", "compile", "open", "__import__"), _closed))
        module.safe_eval = self._evaluate
        module.open = self._open
        module.load_yaml = self._load_yaml
        module.glob = SimpleNamespace(glob=self._glob)
        # xacro's own pattern takes forever over an open quote: each character is matched in many ways
        default = r"""\$\{.*?\}|\$\(.*?\)|(?:'[^'\n]*'|"[^"\n]*"|[^\s'"])+|"""
        module.re_macro_arg = re.compile(r"^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(" + default + r")(?:\s+|$)(.*)")
        vars(module).update(_REPORTS, print_location=lambda *_: "")
        module._global_symbols = {**FUNCTIONS, "math": Namespace(FUNCTIONS), "python": Namespace(FUNCTIONS)}
        tools = {"load_yaml": self._load_yaml, "abs_filename": module.abs_filename_spec}
        module._global_symbols |= {**tools, "xacro": Namespace({**tools, **_REPORTS, **self._more_tools()})}
        substitutions.eval = lambda text, _, names: self._evaluate(text, names)
        substitutions._eval_dict = {**FUNCTIONS, "true": True, "false": False, "find": self._find}
        substitutions.os = SimpleNamespace(path=os.path, environ=_Environment())
        for name, cost in _COSTS.items():
            setattr(module, name, self._counted(getattr(module, name), cost))

    def _more_tools(self) -> dict[str, Any]:
        module = self.xacro

        def fatal(*values: object) -> None:
            raise ExpressionError(shortened(" ".join(map(str, values)), 1000))

        return {
            "arg": lambda name: module.substitution_args_context["arg"][name],
            "dotify": module.YamlDictWrapper,
            "tokenize": _tokenize,
            "print_location": lambda: "",
            "fatal": fatal,
        }

    def _evaluate(self, expression: str, names: Any, _: object = None) -> Any:
        try:
            return self._evaluator.eval(expression, names)
        except Exception as error:
            self._failure = self._failure or (expression, error)  # the innermost comes first
            raise

    def _counted(self, function: Callable[..., Any], cost: Callable[..., int]) -> Callable[..., Any]:
        """Return a function of xacro whose calls are counted as work of the model."""

        def counted(*arguments: Any, **named: Any) -> Any:
            self._evaluator.spend(cost(*arguments, **named))
            value = function(*arguments, **named)
            if isinstance(value, str):
                self._evaluator.spend(len(value) // 256)
                if len(value) > _LONGEST_TEXT:
                    raise ExpressionError(f"a text has more than {_LONGEST_TEXT} characters")
            return value

        return counted

    def _open(self, name: str) -> io.StringIO:
        """Return the text of a file of the model, which is XML within limits."""
        path, stack = Path(name), [Path(each) for each in self.xacro.filestack]
        if not is_file(path):
            raise FileNotFoundError(2, "There is no file", str(path))  # which an optional include may miss
        if not may_include(path, self._folders):
            raise self._foreign(path)
        if len(stack) > _DEEPEST_INCLUDES:
            circle = " > ".join(each.name for each in stack[-3:])
            raise ModelFileError(
                f"{self._path}: files include files {len(stack)} levels deep: ... > {circle}.",
                remedy="Take the circle out.",
                path=str(self._path),
            )
        text = read_model(path)
        self._evaluator.spend(len(text) // 16)
        parsed_text(text, str(path))
        return io.StringIO(text)

    def _load_yaml(self, filename: str) -> Any:
        """Read YAML, with xacro's units, whose numbers may be expressions."""
        module = self.xacro
        path = Path(module.abs_filename_spec(str(filename)))
        if not is_within(path, self._folders):
            raise self._foreign(path)

        def unit(factor: float) -> Callable[[str], float]:
            return lambda text: float(self._evaluate(text, module._global_symbols)) * factor

        units = {each.value.tag: unit(each.value.conversion_constant) for each in module.ConstructUnits}
        content = read_yaml(path, ModelFileError, "The YAML of a model ", tags=units)
        self._evaluator.spend(2 * len(content.lines))
        return module.YamlListWrapper.wrap(content.data)

    def _glob(self, pattern: str) -> list[str]:
        path = Path(pattern)
        if glob.has_magic(str(path.parent)):
            raise ExpressionError(f"models may use wildcards in the name of a file only, not in {path.parent}")
        if not is_within(path.parent, self._folders):
            raise self._foreign(path)
        return glob.glob(pattern)

    def _find(self, name: str) -> str:
        folder = find_package(name, self._path)
        self._folders += (folder.resolve(),)
        return str(folder)

    def _foreign(self, path: Path) -> ModelFileError:
        """Return the error for a file from elsewhere: its content could end up in a plan that is passed on."""
        return ModelFileError(
            f"{self._path} reads {path}, which is neither in its folder or package nor in one that $(find) gives.",
            remedy="Put the file there, or load the robot with trust=True (--trust) if you trust who wrote it.",
            path=str(path),
        )

    def refusal(self, path: Path, error: Exception) -> ModelFileError:
        """Return the error for what went wrong in a file: the innermost expression, its file and line."""
        expression, cause = self._failure or ("", error)
        chain: list[Any] = [cause]
        while (inner := getattr(chain[-1], "exc", None)) is not None:
            chain.append(inner)  # errors of xacro hold others
        remedy = "Check the expression and the arguments it uses."
        match chain[-1]:
            case RedundancyPinError() as own:
                return ModelFileError(own.message, remedy=own.remedy, **own.details)
            case RecursionError() | MemoryError():
                reason = "its macros, properties or files are nested too deeply, or without end"
            case ExpressionError() as reason:
                remedy = "Change the model, or load it with trust=True (--trust) if you trust who wrote it."
            case expat.ExpatError() as reason:
                remedy = "Repair the file at that place: xacro reads what the standard of XML allows."
            case OSError(strerror=what, filename=name):
                reason = f"{what} {name}"
            case self.xacro.substitution_args.SubstitutionException() | self.xacro.XacroException() as last:
                reason = f"{cause}" if isinstance(last, self.xacro.substitution_args.ArgException) else f"{last}"
            case other:
                reason = f"{type(other).__name__}: {other}"
        file, line = self._place(f"${{{expression}}}" if expression else "")
        place = f"{path}{f', in {file}' if file != path.resolve() else ''}{f', line {line}' if line else ''}"
        shown = f"`{shortened(expression.strip(), 200)}`: " if expression else ""
        message = f"xacro cannot render {place}: {shown}{shortened(' '.join(f'{reason}'.split()), 500)}"
        details = {"path": str(path), "file": str(file), "line": line, "expression": expression}
        return ModelFileError(message if message.endswith(".") else f"{message}.", remedy=remedy, **details)

    def _place(self, text: str) -> tuple[Path, int]:
        """Return file and line of a text of a model; line 0 if xacro has put it together of several parts."""
        defined = [macro.history[-1][-1] for macro in reversed(self.xacro.macrostack or [])]
        files = [Path(each) for each in (*defined, *reversed(self.xacro.filestack or [])) if each]
        for file in dict.fromkeys(files) if text else ():
            with contextlib.suppress(ModelFileError):
                before, found, _ = read_model(file).partition(text)
                if found:
                    return file, before.count("\n") + 1
        return (files[len(defined)] if len(files) > len(defined) else self._path.resolve()), 0


def _copy_of_xacro(suffix: str) -> tuple[Any, Any]:
    """Load the modules of xacro once more, under a name of our own, with its function that writes an element.

    xacro puts that function into the standard library, for everybody; here it is taken out again.
    """
    name = f"redundancy_pin.robot.formats._xacro{suffix}"
    spec = None
    if theirs := importlib.util.find_spec("xacro"):
        folders = theirs.submodule_search_locations
        spec = importlib.util.spec_from_file_location(name, theirs.origin, submodule_search_locations=folders)
    if spec is None or spec.loader is None:
        raise ModelFileError("xacro is not installed.", remedy="Install it with `pip install xacro`.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # its functions import its other modules when they are called
    writes = minidom.Element.writexml
    spec.loader.exec_module(module)
    write, minidom.Element.writexml = minidom.Element.writexml, writes  # type: ignore[method-assign]
    module.__dict__["substitution_args"] = importlib.import_module(f"{name}.substitution_args")
    return module, write


def _cost_of_tree(node: Any) -> int:
    """Return the work that an element takes, with its content if it was copied for this or read from a file."""
    copied = node.parentNode is None or node.parentNode.nodeType == minidom.Node.DOCUMENT_NODE
    return 10 + (_tree_size(node) if copied else 0)


def _tree_size(node: Any) -> int:
    """Return how many nodes and attributes a node has, itself included."""
    size, waiting = 0, [node]
    while waiting:
        part = waiting.pop()
        # the public `attributes` makes a mapping for each element, which takes longer than the rest
        size += 1 + len(getattr(part, "_attrs", None) or ())
        waiting += part.childNodes
    return size


def _cost_of_replacing(node: Any, by: Any = None, content_only: bool = False) -> int:
    # minidom looks for each node that it moves or removes among its siblings, one by one
    sources = by if isinstance(by, list) else [] if by is None else [by]
    moved = sum(len(each.childNodes) if content_only else 1 for each in sources)
    return 1 + (1 + moved) * (len(node.parentNode.childNodes) + moved) // 200


_COSTS: Mapping[str, Callable[..., int]] = {
    "eval_all": lambda node, *_: _cost_of_tree(node),
    # xacro cuts a text at each dollar, and copies the rest
    "eval_text": lambda text, symbols: 1 + len(text) // 256 + text.count("$") * len(text) // 4096,
    "parse_macro_arg": lambda text: 2 + len(text) // 64,
    "replace_node": _cost_of_replacing,
}
"""Work of the functions of xacro by whose calls a model is expanded, in steps of ``Evaluator``."""


def _closed(*_: object, **__: object) -> None:
    raise ExpressionError("this release of xacro is not known: install xacro 2.1")


class _Environment(dict[str, str]):
    """An environment that models may not read; xacro may take the default of a variable that is not set."""

    def __contains__(self, name: object) -> bool:
        return name in os.environ and bool(self[str(name)])

    def __getitem__(self, name: str) -> str:
        raise ExpressionError(
            f"models may not read the environment ({name}), which may hold secrets: pass it as an argument of the robot"
        )


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    pieces = re.split(f"[{re.escape(sep)}]", text)
    return [piece for piece in pieces if piece or not skip_empty]


def _report(level: int, *values: object, **_: object) -> str:
    """Log a message of a xacro file, without what would steer a terminal."""
    text = " ".join(map(str, values))
    _log.log(level, "%s", "".join(each if each.isprintable() else " " for each in shortened(text, 1000)))
    return ""


_REPORTS: Mapping[str, Callable[..., str]] = {
    name: functools.partial(_report, level)
    for name, level in {"message": logging.INFO, "warning": logging.WARNING, "error": logging.WARNING}.items()
}


if __name__ == "__main__":
    answer(lambda path, given: json.dumps(expand(Path(path), json.loads(given))).encode())
