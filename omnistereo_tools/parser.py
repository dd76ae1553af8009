"""How words become the options of a command: a frozen dataclass, the types of whose fields say how
they are read.

`OMNISTEREO_TINY=1` caps panoramas, frames and steps of every command, so that tests can run what
pages print.
"""

import os
import shlex
from argparse import SUPPRESS, ArgumentParser
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from omnistereo_lib.errors import OmnistereoError, check_number

# of what `option` declares; argparse knows the rest
_OURS = ("unset", "positional", "between", "suffixes", "needs")
_Settings = TypeVar("_Settings")
_CAPS = {"width": 96, "num_spheres": 16, "steps": 1, "batch_frames": 1, "validation_groups": 1}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of a command.

    A value that cannot be raises an `OmnistereoError`, before any file is opened.
    """

    resumes: ClassVar[bool] = False  #: whether the same command continues a run that was stopped

    def __post_init__(self) -> None:
        for name in self.given():
            value, facts = getattr(self, name), _declared(type(self), name)
            if "between" in facts:
                low, high = facts["between"]
                check_number(value, flag(name), low, high, whole=isinstance(value, int))
            if "suffixes" in facts and value.suffix.lower() not in facts["suffixes"]:
                raise OmnistereoError(
                    f"{value} has the wrong suffix; expected {' or '.join(facts['suffixes'])}"
                )
            if "needs" in facts and getattr(self, facts["needs"]) is None:
                raise OmnistereoError(
                    f"{flag(name)} needs {flag(facts['needs'])}. Add it, or leave {flag(name)} out"
                )

    def given(self) -> list[str]:
        """Return the names of the options whose value is not the default."""
        return [one.name for one in fields(self) if getattr(self, one.name) != one.default]


def option(help: str, default: Any = None, unset: str = "", **facts: Any) -> Any:
    """Declare an option: a field whose type says how it is read; a subclass may give it another
    default.

    Args:
        help: What `--help` says; the default is added.
        default: `MISSING`: it must be given.
        unset: What the default None does.
        facts: `positional`: it has no flag; `between`: the smallest and the largest number;
            `suffixes` of a file; `needs`: another option; what else `ArgumentParser.add_argument`
            takes, such as `metavar`.
    """
    return field(default=default, metadata={"help": help, "unset": unset, **facts})


def add_options(parser: ArgumentParser, kind: type[Options]) -> None:
    """Add the options of a command to a parser, which then returns those that are typed."""
    hints = get_type_hints(kind)
    for one in fields(kind):
        facts = _declared(kind, one.name)
        # What `--help` says of the default, and what argparse is told.
        said = facts["unset"] if one.default in (None, ()) else one.default
        said = " ".join(said) if isinstance(said, tuple) else said
        keywords = {name: value for name, value in facts.items() if name not in _OURS} | _read_as(
            hints[one.name]
        )
        if said not in ("", MISSING) and said is not False:
            keywords["help"] += f" (default: {said})"
        if facts.get("positional"):
            parser.add_argument(one.name, **keywords)
        else:
            parser.add_argument(
                flag(one.name), default=SUPPRESS, required=one.default is MISSING, **keywords
            )


def _declared(kind: type[Options], name: str) -> Mapping[str, Any]:
    """Return what is declared of an option, perhaps by a base class."""
    owners = [owner for owner in kind.__mro__ if name in vars(owner).get("__annotations__", ())]
    declared = (vars(owner)["__dataclass_fields__"][name].metadata for owner in owners)
    return next(filter(None, declared))


def _read_as(hint: Any) -> dict[str, Any]:
    """Return what argparse must know of a type."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (part for part in get_args(hint) if part is not NoneType)
    if hint is bool:
        return {"action": "store_true"}
    if get_origin(hint) is Literal:
        return {"choices": get_args(hint)}
    if get_origin(hint) is tuple:
        kind, more = get_args(hint)
        return {"type": kind, "nargs": "+" if more is ... else 2}
    return {"type": hint}


def flag(name: str) -> str:
    """Return an option as it is typed: min_depth as --min-depth."""
    return f"--{name.replace('_', '-')}"


def as_typed(command: str, kind: type[Options], options: Options, **changes: Any) -> str:
    """Return the command line of another command with the options that both have, and changes."""
    shared = {one.name for one in fields(kind)}.intersection(options.given())
    other = kind(**{name: getattr(options, name) for name in shared} | changes)
    words = ["omnistereo", command]
    for name in other.given():
        value = getattr(other, name)
        words.append(flag(name))
        if value is not True:
            values = value if isinstance(value, tuple) else [value]
            words += (f"{one:.9g}" if isinstance(one, float) else str(one) for one in values)
    return shlex.join(words)


def is_own(method: str | None) -> bool:
    """Whether a method is a Python file, not a name."""
    return method is not None and method.endswith(".py")


def is_tiny() -> bool:
    """Return whether the results are to be small and quick, and mean nothing."""
    return os.environ.get("OMNISTEREO_TINY") == "1"


def shrink(settings: _Settings) -> _Settings:
    """Return a dataclass with every number at most its cap, if `is_tiny`."""
    known: dict[str, Any] = vars(settings)
    if not is_tiny() or "width" not in known:
        return settings
    capped = {name: min(known[name], most) for name, most in _CAPS.items() if name in known}
    if known["height"] is not None:
        capped["height"] = max(1, round(known["height"] * capped["width"] / known["width"]))
    # What has no fields is no settings.
    return replace(settings, **capped)  # type: ignore[type-var]
