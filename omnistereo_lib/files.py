"""File access: one reader for each format, errors that name the file, atomic writes."""

import glob
import json
import os
import re
import stat
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryFile
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.containers import ContainerError, check_container, check_density, check_pixels
from omnistereo_lib.errors import OmnistereoError, shortened

_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP")  # as Pillow calls them
_STDERR = Lock()  # of the whole process
# What the libraries print that OpenCV decodes by: warnings of libjpeg, libpng, FFmpeg.
_OF_DECODERS = re.compile(
    rb"Corrupt JPEG|Premature end|Inconsistent progression|Invalid SOS|Unsupported marker|Unknown Adobe|"
    rb"Warning: unknown JFIF|Invalid component|libpng|\[[a-z0-9_,]+ @ "
)
_made: list[Path] = []  # folders that `make_folder` has made
_BROKEN = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError)  # of the two parsers
_STALE = 3600.0  # seconds; no single file takes so long to write
_MAX_BYTES = 1 << 30
_MAX_TEXT = 1 << 24  # bytes; a calibration of 500 boards has 2 million
_MAX_DEPTH = 64
_MAX_VALUES = 1_000_000  # of a YAML file, with what its aliases repeat


def as_path(path: str | Path, name: str = "path") -> Path:
    """Return an argument as a path; an `OmnistereoError` says that it is something else."""
    try:
        return Path(path)
    except TypeError:
        raise OmnistereoError(f"{name} is {shortened(path)}; expected the name of a file or folder") from None


def read_bytes(path: str | Path, most: int = _MAX_BYTES) -> bytes:
    """Return the content of a regular file of at most `most` bytes; an `OmnistereoError` says why it cannot be read."""
    path = as_path(path)
    try:
        status = path.stat()  # opening a pipe would wait for its other end
        if not stat.S_ISREG(status.st_mode) or status.st_size > most:
            found = f"has {status.st_size} bytes" if stat.S_ISREG(status.st_mode) else "is a folder, a pipe or a device"
            raise OmnistereoError(f"{path} {found}; expected a file of at most {most >> 10} KiB. Check the path.")
        return path.read_bytes()
    except (OSError, ValueError) as error:  # a path cannot hold a zero byte
        if isinstance(error, OmnistereoError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise OmnistereoError(f"{path} cannot be read: {reason}. Check the path.") from None


def path_within(folder: Path, name: Any, source: str | Path, root: Path | None = None) -> Path:
    """Return the path of a name in the file `source`; an `OmnistereoError` says that it leaves `root` (the folder)."""
    path = folder / str(name)
    try:
        path.exists()  # raises for a name that no file can have
        inside = not Path(str(name)).is_absolute() and path.resolve().is_relative_to((root or folder).resolve())
    except (OSError, ValueError, RuntimeError):  # too long, a zero byte, links in a circle
        inside = False
    if not inside:
        raise OmnistereoError(f"{source} names {shortened(name)}; expected a path below {root or folder}. Copy it.")
    return path


def read_text(path: str | Path, most: int = _MAX_TEXT) -> str:
    """Return the content of a text file in UTF-8, else in Latin-1, which the comments of older programs have."""
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def read_data(path: str | Path, most: int = _MAX_TEXT) -> Any:
    """Return the content of a JSON, XML (by their suffixes) or YAML file as Python values.

    A matrix of OpenCV is a mapping with its rows, cols and data; values in XML are text. An `OmnistereoError` names
    what is damaged, stated twice, nested too deeply, or repeated too often by aliases.
    """
    import yaml

    text = read_text(path, most)
    if Path(path).suffix == ".json":
        return parse_json(text, path)
    if Path(path).suffix == ".xml":
        return _parse_xml(text, path)
    # OpenCV before 5 writes "%YAML:1.0", people "data:[" without a blank, ROS a line of dashes behind a message.
    text = re.sub(r"\A\s*%YAML:.*|\n---\s*\Z", "", text)
    text = re.sub(r"(?m)^([ ]*[\w.-]+:)(?=[\[{])", r"\1 ", text)
    try:
        return _not_deep(_yaml_loader()(text).get_single_data())
    except (yaml.YAMLError, *_BROKEN) as error:
        raise _damaged(path, error) from None


def parse_json(text: str | bytes, source: str | Path) -> Any:
    """Return JSON as Python values; an `OmnistereoError` names the source, and what is damaged or stated twice."""
    try:
        return _not_deep(json.loads(text, object_pairs_hook=_unique))
    except _BROKEN as error:
        raise _damaged(source, error) from None


def _parse_xml(text: str, source: str | Path) -> Any:
    """Return XML as a mapping from the name of its root; elements called `_` are a list, as OpenCV writes it."""
    from xml.etree import ElementTree

    def value(element: ElementTree.Element) -> Any:
        if len(element) == 0:
            words = (element.text or "").split()
            return words[0] if len(words) == 1 else words
        if all(child.tag == "_" for child in element):
            return [value(child) for child in element]
        return _unique([(child.tag, value(child)) for child in element])

    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise OmnistereoError(f"{source}: XML with a document type; expected plain elements. Remove it")
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
    return OmnistereoError(f"{source}: not valid {kind} ({reason}). Check that the file is complete")


def _unique(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a mapping, none of whose keys may be stated twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{next(key for key in keys if keys.count(key) > 1)!r} is stated twice")
    return found


def _not_deep(values: Any) -> Any:
    """Return values as they are, which are not nested so deeply that Python could not compare or show them."""
    inner = [values]
    for _ in range(_MAX_DEPTH):
        inner = [part for value in inner for part in _parts(value)]
        if not inner:
            return values
    raise ValueError(f"values nested more than {_MAX_DEPTH} deep")


def _parts(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _yaml_loader() -> type:
    """Return a loader in Python, whose recursion is limited: that in C crashes where a file is nested deeply."""
    import yaml

    class Loader(yaml.SafeLoader):
        def get_single_node(self) -> Any:
            node = super().get_single_node()
            if node is not None and _expanded(node, {}) > _MAX_VALUES:
                raise yaml.YAMLError(f"aliases repeat more than {_MAX_VALUES} values")
            return node

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            _unique([(key.value, None) for key, _ in node.value if isinstance(key, yaml.ScalarNode)])
            return super().construct_mapping(node, deep)

    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}", lambda loader, node: loader.construct_mapping(node, deep=True)
        )
    return Loader


def _expanded(node: Any, known: dict[int, float]) -> float:
    """Return the number of values of a YAML node with those of its aliases; infinite if it holds itself."""
    if id(node) not in known:
        known[id(node)] = np.inf
        parts = node.value if isinstance(node.value, list) else []
        children = (child for part in parts for child in (part if isinstance(part, tuple) else [part]))
        known[id(node)] = 1 + sum(_expanded(child, known) for child in children)
    return known[id(node)]


def read_pixels(path: str | Path, flags: int, image_size: tuple[int, int] | None = None) -> NDArray[Any]:
    """Decode an image file with OpenCV; `flags` select depth and colour, see `cv2.imdecode`.

    Raises an `OmnistereoError` if the file is missing, not an image, of another size (width, height) than expected,
    larger than any picture, damaged or truncated: OpenCV would fill it with gray. Warns if it is damaged where only
    the decoder can tell.
    """
    import cv2

    content = check_image(path, image_size)
    try:
        with decoder_messages() as said:
            pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:  # the header states an absurd size
        pixels = None
    if pixels is None:
        raise _not_an_image(path, content)
    if damage := [line for line in said if "Corrupt JPEG" in line or "libpng error" in line]:
        message = f"{path} is damaged, so that a part of the picture may be wrong ({damage[0]}). Copy it again"
        warnings.warn(message, UserWarning, stacklevel=3)
    return pixels


def check_image(path: str | Path, image_size: tuple[int, int] | None = None) -> bytes:
    """Return the content of an image file, checked as far as it can be without decoding; raises as `read_pixels`."""
    content = read_bytes(path)
    try:
        size = _read_header(path, content)
        check_size(path, size, image_size)  # a small file can hold a large picture
        check_pixels(*size)
    except ContainerError as error:
        raise OmnistereoError(f"{path} is {error}. Copy it again.") from None
    return content


@contextmanager
def decoder_messages() -> Iterator[list[str]]:
    """Collect the lines that a decoder, which is written in C, prints to the standard error output of the process.

    What other threads print meanwhile appears afterwards.
    """
    from cv2.utils import logging

    said: list[str] = []
    with _STDERR, TemporaryFile() as file:
        try:
            kept = os.dup(2)
        except OSError:  # it is closed
            yield said
            return
        level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)  # OpenCV's own log
        try:
            os.dup2(file.fileno(), 2)
            yield said
        finally:
            logging.setLogLevel(level)
            os.dup2(kept, 2)
            os.close(kept)
        file.seek(0)
        lines = file.read().splitlines(keepends=True)
        said += [line.decode(errors="replace").strip() for line in lines if _OF_DECODERS.match(line)]
        with suppress(OSError):
            os.write(2, b"".join(line for line in lines if not _OF_DECODERS.match(line)))  # of other threads


if hasattr(os, "register_at_fork"):  # no child is born while its error output leads elsewhere
    os.register_at_fork(before=_STDERR.acquire, after_in_parent=_STDERR.release, after_in_child=_STDERR.release)


def check_size(path: str | Path, found: tuple[int, int], expected: tuple[int, int] | None) -> None:
    """Raise an `OmnistereoError` if an image has another size (width, height) than its camera."""
    if expected is not None and found != tuple(expected):
        size, camera = (f"{width} × {height} px" for width, height in (found, expected))
        raise OmnistereoError(
            f"{path} is {size}; the camera has {camera}. Pass images as captured: not resized, cropped or rotated."
        )


def _not_an_image(path: str | Path, content: bytes) -> OmnistereoError:
    return OmnistereoError(f"{path} is not an image ({len(content)} bytes); expected one of {', '.join(_FORMATS)}")


def _read_header(path: str | Path, content: bytes) -> tuple[int, int]:
    """Return width and height as the header states them; warn of what OpenCV leaves out.

    Raises an `OmnistereoError` if it cannot be read or the pixels are no integers, a `ContainerError` if what it states
    does not fit into the file.
    """
    from PIL import Image

    pages = check_container(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(BytesIO(content), formats=_FORMATS)
            size, mode, pages = image.size, image.mode, pages or getattr(image, "n_frames", 1)
    except Image.DecompressionBombError as error:
        raise OmnistereoError(f"{path} is too large for a picture: {error}") from None
    except Exception:  # it raises many types for a damaged file
        raise _not_an_image(path, content) from None
    check_density(*size, image.format, content)
    if mode == "F":
        raise OmnistereoError(f"{path} holds floating-point numbers; expected a picture of 8 or 16 bits")
    if mode in ("RGBA", "LA", "PA") or pages > 1:
        more = "1 more page, which is" if pages == 2 else f"{pages - 1} more pages, which are"
        warnings.warn(f"{path} has {'transparency, which is' if pages == 1 else more} ignored", stacklevel=5)
    return size


def read_image(path: str | Path, image_size: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """Read an image, uint8: (height, width) if it is gray, else (height, width, 3) in RGB.

    `image_size` is the width and height that it must have, compared before it is decoded. The EXIF orientation is
    ignored: calibrations refer to the pixels of the sensor. Raises as `read_pixels`.
    """
    import cv2

    image = read_pixels(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION, image_size)
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def read_gray(path: str | Path, image_size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read an image of a known size, such as a mask, as gray, shape (height, width); see `read_image`."""
    image = read_image(path, image_size)
    return image if image.ndim == 2 else image.max(-1)


def find_pictures(folder: Path, suffixes: Iterable[str]) -> dict[str, Path]:
    """Return the pictures in a folder, sorted, by name without ending; hidden files are none.

    Raises an `OmnistereoError` if two differ only in their ending.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in suffixes and path.name[0] != ".":
            if path.stem in found:
                raise OmnistereoError(f"{folder} has {found[path.stem].name} and {path.name}; expected one. Keep one")
            found[path.stem] = path
    return found


def write_image(path: str | Path, image: NDArray[Any]) -> None:
    """Write an image, gray (height, width) or RGB (height, width, 3), in the format of the file name suffix.

    Values range from 0 to 255; NaN becomes black. JPEG files have quality 95, OpenCV's default.
    """
    import cv2

    pixels = np.nan_to_num(image).clip(0, 255).round().astype(np.uint8)
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
    content = cv2.imencode(Path(path).suffix, pixels)[1]
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path beside it, rename it on success, remove it on failure.

    Each writer has a name of its own, also beside writers in other threads, containers and machines. The content is on
    the disk before the file has its name. Removes what killed processes have left of it. Raises an `OmnistereoError` if
    the folder is missing or not writable.
    """
    path = Path(path)
    temporary = path.with_name(f".{token_hex(8)}.{path.name}")  # same suffix: writers choose the format by it
    try:
        yield temporary
        _sync(temporary)
        now = temporary.stat().st_mtime  # of the disk: the clocks of machines that share it differ
        temporary.replace(path)
        _remove_stale(path, now)
        _sync(path.parent)
    except OSError as error:
        raise OmnistereoError(
            f"{path} cannot be written: {error.strerror}. Give a file in an existing, writable folder."
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        return  # Windows has no such thing
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_stale(path: Path, now: float) -> None:
    """Remove the temporary files of `path` to which nobody has written for an hour, by the clock of the disk."""
    for left in path.parent.glob(f".{'[0-9a-f]' * 16}.{glob.escape(path.name)}"):
        with suppress(FileNotFoundError):  # another writer was quicker
            if now - left.stat().st_mtime > _STALE:
                left.unlink()


def make_folder(path: str | Path) -> Path:
    """Make a folder and its parents if missing; return its path. An `OmnistereoError` says why it is not writable."""
    path = Path(path)
    _made.extend(folder for folder in (path, *path.parents) if not folder.exists())
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        message = f"folder {path} cannot be made or written to: {error.strerror}. Choose another folder."
        raise OmnistereoError(message) from None


def remove_empty_folders() -> None:
    """Remove the folders that `make_folder` has made and nothing was written into, as before a refusal."""
    for folder in sorted(set(_made), reverse=True):  # inner ones first
        with suppress(OSError):
            folder.rmdir()
    _made.clear()


def is_whole(path: str | Path) -> bool:
    """Return whether an image file is there and complete, as far as can be seen without decoding it."""
    try:
        content = read_bytes(path)
        check_container(content)
        return len(content) > 0
    except (OmnistereoError, ContainerError):
        return False
