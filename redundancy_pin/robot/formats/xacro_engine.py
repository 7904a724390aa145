"""xacro without Python: the library expands macros, this module evaluates their expressions and bounds their work.

Everything that ties the package to the insides of xacro is here. A copy of its modules is loaded under a name of our
own, and what evaluates, reads files or looks at the machine is replaced in that copy; a user's xacro stays as it is.
"""

from __future__ import annotations

import functools
import glob
import importlib.metadata
import importlib.util
import inspect
import keyword
import logging
import os
import re
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.dom import minidom

from redundancy_pin.errors import ModelFileError, RedundancyPinError, shortened
from redundancy_pin.io.reading import is_file
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.robot.formats.expressions import (
    BUILTINS,
    MATHEMATICS,
    Budget,
    ExpressionError,
    Function,
    Namespace,
    evaluate,
)
from redundancy_pin.robot.formats.xml_files import parsed_text, read_model

_SUPPORTED = "2.1."
"""Versions whose insides this module knows."""

INSIDES = {
    "safe_eval": ("expr", "globals", "locals"),
    "eval_text": ("text", "symbols"),
    "parse": ("inp", "filename"),
    "load_yaml": ("filename",),
    "is_valid_name": ("name",),
    "parse_macro_arg": ("s",),
    "handle_macro_call": ("node", "macros", "symbols"),
    "eval_all": ("node", "macros", "symbols"),
    "eval_extension": ("s",),
    "replace_node": ("node", "by", "content_only"),
    "process_doc": ("doc", "mappings", "kwargs"),
    "Table._eval_literal": ("value",),
    "substitution_args._eval": ("s", "context"),
    "substitution_args._eval_env": ("name",),
    "substitution_args._eval_optenv": ("name", "default"),
    "substitution_args._eval_find": ("pkg",),
}
"""Functions of xacro that are replaced or called, and their parameters."""

_DEEPEST_MACROS = 150
_DEEPEST_INCLUDES = 30
_MOST_FILES = 500
_LONGEST_TEXT = 200_000
_LONGEST_PARAMETERS = 10_000

_LOCK = threading.Lock()
"""xacro keeps its stacks in globals: two threads at once empty each other's."""

_NAME = "redundancy_pin.robot._xacro"
_log = logging.getLogger("redundancy_pin.xacro")


def expand(path: Path, given: Mapping[str, str], *, trust: bool) -> tuple[str, dict[str, str]]:
    """Return the URDF that a xacro file gives, and its arguments, as texts, those that were left out included.

    Args:
        path: the file.
        given: arguments, as texts.
        trust: evaluate expressions as Python, by xacro itself and without limits.

    Raises:
        ModelFileError: an expression that fails or that models may not use, or more work than a model may make.
    """
    resolved = dict(given)  # xacro adds the arguments that were left out, their defaults evaluated
    with _LOCK:
        engine = None if trust else engine_for_models()
        try:
            document = _expanded_by_xacro(path, resolved) if engine is None else engine.expanded(path, resolved)
            text = _text_of(document, path.parent)
        except RedundancyPinError:
            raise
        except Exception as error:  # expressions raise anything
            raise _refusal(path, error, engine) from error
    return text, {name: str(value) for name, value in resolved.items()}


def _text_of(document: Any, folder: Path) -> str:
    """Return an expanded document as text, its files' names absolute."""
    parts = [*document.getElementsByTagName("mesh"), *document.getElementsByTagName("material")]
    if any(part.hasAttribute("filename") for part in parts):
        from xacrodoc import XacroDoc  # which takes long to import

        return str(XacroDoc(document, rootdir=folder).to_urdf_string())
    return str(minidom.parseString(document.toxml()).toprettyxml(indent="  "))


def own_folders(path: Path) -> tuple[Path, ...]:
    """Return the folders whose files a xacro file may read: its own, and the package of ROS that it is part of."""
    folder = path.resolve().parent
    package = next((each for each in (folder, *folder.parents) if is_file(each / "package.xml")), folder)
    return (folder, package)


def is_within(path: Path, folders: Iterable[Path]) -> bool:
    """Return whether a file is in one of some folders, symbolic links followed."""
    place = path.resolve()
    return any(place.is_relative_to(folder) for folder in folders)


def _refusal(path: Path, error: Exception, engine: _Engine | None) -> ModelFileError:
    """Return the error for what went wrong in a file, which names the innermost expression."""
    details: dict[str, object] = {"path": str(path)}
    remedy = "Check the expression and the arguments it uses."
    if engine is None or engine.failure is None:
        lines = " ".join(f"{type(error).__name__}: {error}".split())
        if isinstance(error, RecursionError):
            lines = "its macros or expressions are nested too deeply, or without end"
        message = f"xacro cannot render {path}: {shortened(lines, 1000)}"
    else:
        expression, file, cause = engine.failure
        reason = f"{cause}" if isinstance(cause, (ExpressionError, NameError)) else f"{type(cause).__name__}: {cause}"
        inside = f" in {file}" if file and Path(file).resolve() != path.resolve() else ""
        message = f"xacro cannot render {path}: {shortened(expression, 200)}{inside}: {shortened(reason, 500)}"
        details |= {"expression": expression, "file": file or str(path)}
        if isinstance(cause, ExpressionError):
            remedy = "Change the expression, or load the robot with trust=True (--trust) if you trust who wrote it."
    return ModelFileError(message if message.endswith(".") else f"{message}.", remedy=remedy, **details)


def _expanded_by_xacro(path: Path, resolved: dict[str, str]) -> Any:
    """Expand a file of someone who is trusted, by xacro as it comes."""
    import xacro

    document = xacro.process_file(str(path.resolve()), mappings=resolved)
    return _settled(xacro, document)


def _settled(module: Any, document: Any) -> Any:
    """Expand what the expansion made, until nothing changes."""
    before = document.toxml()
    document = module.parse(before)
    for _ in range(10):
        module.process_doc(document, mappings={})
        after = document.toxml()
        if before == after:
            return document
        before = after
    raise ValueError("the expansion does not come to an end")


class _Engine:
    """A copy of xacro whose expressions are data."""

    def __init__(self) -> None:
        self.xacro = copy_of_xacro()
        self._budget = Budget()
        self._files = 0
        self._depth = 0
        self._folders: tuple[Path, ...] = ()
        self.failure: tuple[str, str, Exception] | None = None
        """The innermost expression that failed, its file, and why."""
        self._replace()

    def expanded(self, path: Path, resolved: dict[str, str]) -> Any:
        """Return the document that a file expands to."""
        self._budget = Budget()
        self._files, self._depth, self.failure = 0, 0, None
        self._folders = own_folders(path)
        document = self.xacro.process_file(str(path.resolve()), mappings=resolved)
        self.failure = None  # xacro goes on after some failures
        return _settled(self.xacro, document)

    def _replace(self) -> None:
        """Put what is ours in the place of what evaluates, reads files, or looks at the machine."""
        module, arguments = self.xacro, self.xacro.substitution_args
        self._eval_text, self._handle_macro_call = module.eval_text, module.handle_macro_call
        self._eval_all, self._replace_node = module.eval_all, module.replace_node
        self._eval_extension, self._parse_macro_arg = module.eval_extension, module.parse_macro_arg
        module.safe_eval = self._evaluate
        module.eval_text = self._text
        module.eval_extension = self._extension
        module.parse = self._parse
        module.load_yaml = self._load_yaml
        module.is_valid_name = lambda name: name.isidentifier() and not keyword.iskeyword(name)
        module.handle_macro_call = self._macro_call
        module.eval_all = self._all
        module.parse_macro_arg = self._macro_parameter
        module.replace_node = self._node
        module.glob = SimpleNamespace(glob=_glob)
        # xacro's own pattern takes forever over an open quote: each character was matched in many ways
        default = r"""\$\{.*?\}|\$\(.*?\)|(?:'[^'\n]*'|"[^"\n]*"|[^\s'"])+|"""
        module.re_macro_arg = re.compile(r"^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(" + default + r")(?:\s+|$)(.*)")
        module._global_symbols = self._symbols()
        vars(module).update(_REPORTS)
        module.print_location = lambda *_: None
        arguments._eval = self._evaluate_substitution
        arguments._eval_env = _refuse_environment
        arguments._eval_optenv = _default_of_environment
        arguments._eval_find = self._package

    def _symbols(self) -> dict[str, Any]:
        """Return the names that xacro offers to expressions."""
        module = self.xacro

        def functions(**given: Callable[..., object]) -> dict[str, object]:
            return {name: Function(name, call) for name, call in given.items()}

        def fatal(*values: object) -> None:
            raise ExpressionError(" ".join(map(str, values)))

        own = functions(load_yaml=self._load_yaml, abs_filename=module.abs_filename_spec, dotify=module.YamlDictWrapper)
        more = functions(
            arg=lambda name: module.substitution_args_context["arg"][name],
            fatal=fatal,
            tokenize=_tokenize,
            print_location=lambda: "",
            **_REPORTS,
        )
        direct = ("list", "dict", "map", "len", "str", "float", "int", "bool", "min", "max", "round", "sorted", "range")
        return {
            **{name: BUILTINS[name] for name in direct},
            **MATHEMATICS,
            **own,
            "python": Namespace(BUILTINS),
            "math": Namespace(MATHEMATICS),
            "xacro": Namespace({**own, **more}),
        }

    def _evaluate(self, expression: str, names: Mapping[str, Any], local: object = None) -> Any:
        module = self.xacro
        try:
            return evaluate(expression, names, self._budget, (Namespace, module.YamlDictWrapper, module.NameSpace))
        except Exception as error:
            self._record(f"${{{expression.strip()}}}", error)
            raise

    def _extension(self, text: str) -> Any:
        try:
            return self._eval_extension(text)
        except Exception as error:
            self._record(text, error)
            raise

    def _record(self, expression: str, error: Exception) -> None:
        """Remember what failed, and why; what failed inside of it has been remembered before."""
        if self.failure is not None:
            return
        cause: Any = error
        while not isinstance(cause, (ExpressionError, RecursionError)) and getattr(cause, "exc", None) is not None:
            cause = cause.exc  # xacro's errors carry others
        if isinstance(cause, RecursionError):
            cause = ExpressionError("it is nested too deeply")
        stack = self.xacro.filestack or [""]
        self.failure = (expression, stack[-1] or "", cause if isinstance(cause, ExpressionError) else error)

    def _evaluate_substitution(self, text: str, context: Mapping[str, Any]) -> str:
        """Evaluate ``$(eval ...)``: the arguments by name, and what the substitutions are as functions."""
        convert = self.xacro.substitution_args.convert_value
        given = {name: convert(value, "auto") for name, value in context.get("arg", {}).items()}
        functions: dict[str, object] = {
            "arg": Function("arg", lambda name: convert(context["arg"][name], "auto")),
            "find": Function("find", self._package),
            "env": Function("env", _refuse_environment),
            "optenv": Function("optenv", _default_of_environment),
            **{name: BUILTINS[name] for name in ("list", "dict", "map", "str", "float", "int")},
            **MATHEMATICS,
            "true": True,
            "false": False,
        }
        return str(self._evaluate(text, {**given, **functions}))

    def _text(self, text: str, symbols: Any) -> Any:
        # xacro cuts a text at each dollar, and copies the rest
        self._budget.spend(1 + len(text) // 256 + text.count("$") * len(text) // 4096)
        if "$" in text and len(text) > _LONGEST_TEXT:
            raise ExpressionError(f"a text with expressions has {len(text)} characters, more than {_LONGEST_TEXT}")
        value = self._eval_text(text, symbols)
        if isinstance(value, str):
            self._budget.spend(len(value) // 256)
            if len(value) > max(_LONGEST_TEXT, len(text)):
                raise ExpressionError(f"a text has {len(value)} characters, more than {_LONGEST_TEXT}")
        return value

    def _parse(self, source: Any, filename: str | None = None) -> Any:
        """Parse text, or a file that is included."""
        module = self.xacro
        if source is not None:
            parsed_text(source, "what xacro made")
            return minidom.parseString(source)
        path = Path(module.root_dir, filename or "")
        if not is_file(path):
            module.filestack.pop()  # as xacro does, which knows optional includes by an IOError
            cause = FileNotFoundError(2, "No such file", str(path))
            raise module.XacroException(f"there is no file {path}", exc=cause)
        self._require_own(path)
        self._files += 1
        stack = [str(each) for each in module.filestack]
        if len(stack) > _DEEPEST_INCLUDES or self._files > _MOST_FILES:
            circle = " > ".join(Path(each).name for each in stack[-3:])
            what = "include files within files without end" if len(stack) > _DEEPEST_INCLUDES else "are too many"
            raise ModelFileError(
                f"The includes of {stack[0]} {what}: ... {circle}.", remedy="Take the circle out.", path=stack[0]
            )
        text = read_model(path)
        self._budget.spend(len(text) // 16)
        parsed_text(text, str(path))
        return minidom.parseString(text)

    def _load_yaml(self, filename: str) -> Any:
        """Read YAML, with xacro's units, whose numbers may be expressions."""
        module = self.xacro
        path = Path(module.abs_filename_spec(str(filename)))
        self._require_own(path)
        names = self._symbols()

        def unit(factor: float) -> Callable[[str], float]:
            return lambda text: float(self._evaluate(text, names)) * factor

        units = {each.value.tag: unit(each.value.conversion_constant) for each in module.ConstructUnits}
        module.filestack.append(str(path))
        try:
            content = read_yaml(path, ModelFileError, "The YAML of a model ", tags=units)
        finally:
            module.filestack.pop()
        self._budget.spend(2 * len(content.lines))
        return module.YamlListWrapper.wrap(content.data)

    def _package(self, name: str) -> str:
        from xacrodoc import packages

        folder = str(packages.get_path(name))
        self._folders += (Path(folder).resolve(),)
        return folder

    def _require_own(self, path: Path) -> None:
        """Refuse a file from elsewhere: what it holds could end up in a plan that is passed on."""
        if not is_within(path, self._folders):
            raise ModelFileError(
                f"{self.xacro.filestack[0]} reads {path}, which is neither in its folder or package nor in one that "
                "$(find) gives.",
                remedy="Put the file there, or load the robot with trust=True (--trust) if you trust who wrote it.",
                path=str(path),
            )

    def _macro_call(self, node: Any, macros: Any, symbols: Any) -> Any:
        if node.tagName.startswith("xacro:"):
            self._budget.spend(100)
            if self._depth >= _DEEPEST_MACROS:
                raise ExpressionError(f"macros call macros {self._depth} levels deep: {node.tagName}")
        self._depth += 1
        try:
            return self._handle_macro_call(node, macros, symbols)
        finally:
            self._depth -= 1

    def _macro_parameter(self, text: str) -> Any:
        if len(text) > _LONGEST_PARAMETERS:
            raise ExpressionError(f"the parameters of a macro have {len(text)} characters")
        self._budget.spend(5 + len(text) // 64)
        return self._parse_macro_arg(text)

    def _all(self, node: Any, macros: Any, symbols: Any) -> None:
        self._budget.spend(10 + len(node.childNodes) // 2)
        self._eval_all(node, macros, symbols)

    def _node(self, node: Any, by: Any, content_only: bool = False) -> None:
        # minidom looks for each node that it moves or removes among its siblings, one by one
        sources = by if isinstance(by, list) else [] if by is None else [by]
        moved = sum(len(each.childNodes) if content_only else 1 for each in sources)
        siblings = len(node.parentNode.childNodes) + moved
        self._budget.spend(2 + (1 + moved) * siblings // 250)
        self._replace_node(node, by, content_only)


@functools.lru_cache(maxsize=1)
def engine_for_models() -> _Engine:
    """Return the engine that evaluates models as data; one for all of them."""
    return _Engine()


def copy_of_xacro() -> Any:
    """Load xacro once more, under a name of our own.

    Raises:
        ModelFileError: the installed xacro is another than this module knows.
    """
    try:
        version = importlib.metadata.version("xacro")
    except importlib.metadata.PackageNotFoundError:
        version = "without a version"
    module_spec = importlib.util.find_spec("xacro")
    if module_spec is None or module_spec.origin is None or not version.startswith(_SUPPORTED):
        raise _unknown(version, "its expressions cannot be evaluated safely")
    spec = importlib.util.spec_from_file_location(
        _NAME, module_spec.origin, submodule_search_locations=module_spec.submodule_search_locations
    )
    if spec is None or spec.loader is None:
        raise _unknown(version, "it cannot be loaded a second time")
    module: ModuleType = importlib.util.module_from_spec(spec)
    sys.modules[_NAME] = module
    spec.loader.exec_module(module)
    module.__dict__["substitution_args"] = importlib.import_module(f"{_NAME}.substitution_args")
    for name, parameters in INSIDES.items():
        function: Any = module
        for part in name.split("."):
            function = getattr(function, part, None)
        if function is None or tuple(inspect.signature(function).parameters) != parameters:
            raise _unknown(version, f"its {name} is another")
    return module


def _unknown(version: str, what: str) -> ModelFileError:
    return ModelFileError(
        f"The installed xacro is {version}: {what}.",
        remedy="Install xacro 2.1, or load the robot with trust=True (--trust) if you trust who wrote it.",
        version=version,
    )


def _report(level: int, *values: object, **options: object) -> str:
    """Log a message of a xacro file, without what would steer a terminal."""
    text = " ".join(map(str, values))
    _log.log(level, "%s", "".join(each if each.isprintable() else " " for each in shortened(text, 1000)))
    return ""


_REPORTS: Mapping[str, Callable[..., str]] = {
    name: functools.partial(_report, level)
    for name, level in {"message": logging.INFO, "warning": logging.WARNING, "error": logging.WARNING}.items()
}


def _refuse_environment(name: str) -> str:
    raise ExpressionError(
        f"models may not read the environment ({name}), which may hold secrets: pass it as an argument of the robot"
    )


def _default_of_environment(name: str, default: str = "") -> str:
    """Return the default where the variable is not set; never another value than xacro's."""
    return _refuse_environment(name) if name in os.environ else default


def _glob(pattern: str) -> list[str]:
    folder, _ = os.path.split(pattern)
    if glob.has_magic(folder):
        raise ExpressionError(f"models may use wildcards in the name of a file only, not in {folder}")
    return glob.glob(pattern)


def _tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
    pieces = re.split(f"[{re.escape(sep)}]", text)
    return [piece for piece in pieces if piece] if skip_empty else pieces
