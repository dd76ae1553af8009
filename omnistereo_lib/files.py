"""Files and folders: errors that name the file, atomic writes, JSON, YAML and XML as values."""

import glob
import hashlib
import json
import os
import re
import stat
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError, shortened

# Folders that `make_folder` has made.
_made: list[Path] = []
# What the two parsers raise.
_BROKEN = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError)
# In seconds: no single file takes so long to write.
_STALE = 3600.0
_MAX_BYTES = 1 << 30
# In bytes; a calibration of 500 boards has 2 million.
_MAX_TEXT = 1 << 24
_MAX_DEPTH = 64
# Values of a YAML file, with what its aliases repeat.
_MAX_VALUES = 1_000_000
# Scalars of YAML: a pattern, what they begin with, and how they are read.
_NUMBERS: dict[str, tuple[str, str, Callable[[str], Any]]] = {
    "bool": ("true|True|TRUE|false|False|FALSE", "tTfF", lambda text: text.lower() == "true"),
    "int": ("[-+]?[0-9]+", "-+0123456789", int),
    "float": (
        r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)"
        r"|\.(?:nan|NaN|NAN)",
        "-+0123456789.",
        lambda text: float(re.sub(r"\.(?=[inIN])", "", text)),
    ),
}


def as_path(path: str | Path, name: str = "path") -> Path:
    """Return an argument as a path; an `OmnistereoError` says that it is something else."""
    try:
        return Path(path)
    except TypeError:
        raise OmnistereoError(
            f"{name} is {shortened(path)}; expected the name of a file or folder"
        ) from None


def read_bytes(path: str | Path, most: int = _MAX_BYTES) -> bytes:
    """Return the content of a regular file of at most `most` bytes; say why it cannot be read."""
    path = as_path(path)
    try:
        # Opening a pipe would wait for its other end.
        status = path.stat()
        is_file = stat.S_ISREG(status.st_mode)
        if is_file and status.st_size <= most:
            return path.read_bytes()
    except (OSError, ValueError) as error:  # a path cannot hold a zero byte
        reason = getattr(error, "strerror", None) or error
        raise OmnistereoError(f"{path} cannot be read: {reason}. Check the path.") from None
    found = f"has {status.st_size} bytes" if is_file else "is a folder, a pipe or a device"
    raise OmnistereoError(
        f"{path} {found}; expected a file of at most {most >> 10} KiB. Check the path."
    )


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()


def path_within(folder: Path, name: Any, source: str | Path, root: Path | None = None) -> Path:
    """Return the path of a name in the file `source`; refuse one that leaves `root` (folder)."""
    path = folder / str(name)
    try:
        # Raises for a name that no file can have.
        path.exists()
        inside = not Path(str(name)).is_absolute() and path.resolve().is_relative_to(
            (root or folder).resolve()
        )
    except (OSError, ValueError, RuntimeError):  # too long, a zero byte, links in a circle
        inside = False
    if not inside:
        raise OmnistereoError(
            f"{source} names {shortened(name)}; expected a path below {root or folder}. Copy it."
        )
    return path


def read_text(path: str | Path, most: int = _MAX_TEXT) -> str:
    """Return the content of a text file in UTF-8, else Latin-1, as in older programs' comments."""
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def read_data(path: str | Path, most: int = _MAX_TEXT) -> Any:
    """Return the content of a JSON, XML (by their suffixes) or YAML file as Python values.

    A matrix of OpenCV is a mapping with its rows, cols and data; values in XML are text. An
    `OmnistereoError` names what is damaged, stated twice, nested too deeply or repeated too often.
    """
    import yaml

    text = read_text(path, most)
    if "\0" in text:
        raise OmnistereoError(f"{path} is no text; expected JSON, XML or YAML. Check the path.")
    if Path(path).suffix == ".json":
        return parse_json(text, path)
    if Path(path).suffix == ".xml":
        return _parse_xml(text, path)
    # OpenCV before 5 writes "%YAML:1.0", people "data:[" without a blank, ROS dashes behind.
    text = re.sub(r"\A\s*%YAML:.*|\n---\s*\Z", "", text)
    text = re.sub(r"(?m)^([ ]*[\w.-]+:)(?=[\[{])", r"\1 ", text)
    try:
        return _not_deep(_yaml_loader()(text).get_single_data())
    except (yaml.YAMLError, *_BROKEN) as error:
        raise _damaged(path, error) from None


def parse_json(text: str | bytes, source: str | Path) -> Any:
    """Return JSON as Python values; an error names what is damaged or stated twice."""
    try:
        return _not_deep(json.loads(text, object_pairs_hook=_unique))
    except _BROKEN as error:
        raise _damaged(source, error) from None


def _parse_xml(text: str, source: str | Path) -> Any:
    """Return XML as a mapping from the name of its root; elements called `_` are OpenCV's lists."""
    from xml.etree import ElementTree

    def value(element: ElementTree.Element) -> Any:
        if len(element) == 0:
            words = (element.text or "").split()
            return words[0] if len(words) == 1 else words
        if all(child.tag == "_" for child in element):
            return [value(child) for child in element]
        return _unique([(child.tag, value(child)) for child in element])

    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise OmnistereoError(
            f"{source}: XML with a document type; expected plain elements. Remove it"
        )
    try:
        root = ElementTree.fromstring(text)
        return {root.tag: value(root)}
    except (ElementTree.ParseError, *_BROKEN) as error:
        raise _damaged(source, error, "XML") from None


def to_yaml(data: dict[str, Any]) -> str:
    """Return YAML text with every number in full and lists of numbers on one line."""
    import yaml

    return str(yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100))


def _damaged(source: str | Path, error: Exception, kind: str = "JSON or YAML") -> OmnistereoError:
    reason = " ".join(str(error).split())[:300] or type(error).__name__
    if "tag:yaml.org,2002:python/" in reason:
        return OmnistereoError(
            f"{source} holds Python objects, such as NumPy's, not numbers. Write lists (.tolist())"
        )
    return OmnistereoError(
        f"{source}: not valid {kind} ({reason}). Check that the file is complete"
    )


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a mapping, none of whose keys may be stated twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(key for key in keys if keys.count(key) > 1)!r} is stated twice")
    return found


def _not_deep(values: Any) -> Any:
    """Return values as they are, if not nested too deeply for Python to compare or show."""
    inner = [values]
    for _ in range(_MAX_DEPTH):
        inner = [part for value in inner for part in _parts(value)]
        if not inner:
            return values
    raise ValueError(f"values nested more than {_MAX_DEPTH} deep")


def _parts(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _yaml_loader() -> type:
    """Return a loader in Python, whose recursion is limited: that in C crashes on deep nesting."""
    import yaml

    class Loader(yaml.SafeLoader):
        def get_single_node(self) -> Any:
            node = super().get_single_node()
            if node is not None and _expanded(node, {}) > _MAX_VALUES:
                raise yaml.YAMLError(f"aliases repeat more than {_MAX_VALUES} values")
            return node

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            _unique([(key, None) for key in keys])
            return super().construct_mapping(node, deep)

    # Numbers are Python's: 0200 is not 128, 3:20 not 200, 0b11 and yes are words.
    Loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in known if tag.rpartition(":")[2] not in _NUMBERS]
        for first, known in Loader.yaml_implicit_resolvers.items()
    }
    for kind, (pattern, first, read) in _NUMBERS.items():
        tag = f"tag:yaml.org,2002:{kind}"
        Loader.add_implicit_resolver(tag, re.compile(rf"(?:{pattern})\Z"), [*first])
        Loader.add_constructor(tag, lambda it, node, read=read: read(it.construct_scalar(node)))
    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}",
            lambda loader, node: loader.construct_mapping(node, deep=True),
        )
    return Loader


def _expanded(node: Any, known: dict[int, float]) -> float:
    """Return the number of values of a YAML node with its aliases; infinite if it holds itself."""
    if id(node) not in known:
        known[id(node)] = np.inf
        parts = node.value if isinstance(node.value, list) else []
        children = (
            child for part in parts for child in (part if isinstance(part, tuple) else [part])
        )
        known[id(node)] = 1 + sum(_expanded(child, known) for child in children)
    return known[id(node)]


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path beside it, rename it on success or remove it.

    Each writer has a name of its own, also beside writers in other threads, containers and
    machines. The content is on the disk before the file has its name. Removes what killed processes
    have left of it. Raises an `OmnistereoError` if the folder is missing or not writable.
    """
    path = Path(path)
    # same suffix: writers choose the format by it
    temporary = path.with_name(f".{token_hex(8)}.{path.name}")
    try:
        yield temporary
        _sync(temporary)
        # Of the disk: the clocks of machines that share it differ.
        now = temporary.stat().st_mtime
        temporary.replace(path)
        _remove_stale(path, now)
        _sync(path.parent)
    except OSError as error:
        raise OmnistereoError(
            f"{path} cannot be written: {error.strerror}. Give a file in an existing, writable"
            " folder."
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        # Windows has no such thing.
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_stale(path: Path, now: float) -> None:
    """Remove temporary files of `path` that are an hour old by the clock of the disk."""
    for left in path.parent.glob(f".{'[0-9a-f]' * 16}.{glob.escape(path.name)}"):
        # Another writer was quicker.
        with suppress(FileNotFoundError):
            if now - left.stat().st_mtime > _STALE:
                left.unlink()


def make_folder(path: str | Path) -> Path:
    """Make a folder and its parents; return its path, or say why it is not writable."""
    path = Path(path)
    _made.extend(folder for folder in (path, *path.parents) if not folder.exists())
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        found = f"folder {path} cannot be made or written to: {error.strerror}"
        raise OmnistereoError(f"{found}. Choose another folder.") from None


def remove_empty_folders() -> None:
    """Remove the folders that `make_folder` has made and nothing was written into."""
    for folder in sorted(set(_made), reverse=True):  # inner ones first
        with suppress(OSError):
            folder.rmdir()
    _made.clear()


def unpack(folder: Path) -> None:
    """Unpack NAME.zip where a folder NAME, or one above it, is not there yet, but its archive is.

    Sets of thousands of small files lie as one archive each; the folder appears when it is whole.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    archives = (path.parent / f"{path.name}.zip" for path in missing)
    if (archive := next((path for path in archives if path.exists()), None)) is None:
        return
    try:
        with (
            TemporaryDirectory(dir=archive.parent, prefix=f".{archive.stem}-") as partial,
            zipfile.ZipFile(archive) as packed,
        ):
            packed.extractall(partial)
            whole = archive.with_suffix("")
            try:
                os.rename(Path(partial) / whole.name, whole)
            except OSError:
                # Another process was first.
                if not whole.is_dir():
                    raise
    except (OSError, zipfile.BadZipFile) as error:
        raise OmnistereoError(
            f"{archive} cannot be unpacked: {error}. Check it by `make doctor`, and that its folder"
            " can be written"
        ) from None
