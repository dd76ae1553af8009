"""File access: one reader for each format, errors that name the file, atomic writes."""

import glob
import hashlib
import json
import math
import os
import re
import stat
import warnings
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError, shortened

MAX_PIXELS = 1 << 26  # of a picture or panorama: decoding one takes less than a gigabyte
_MAX_SIDE = 100_000
_MAX_SCANS = 64  # of a JPEG, whose decoder goes over the whole picture for each of its scans
_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP")  # as Pillow calls them
_NOT_READ = {
    "CMYK": "CMYK colours",
    "LAB": "CIELAB colours",
    "YCbCr": "YCbCr colours",
    "HSV": "HSV colours",
}
# modes, as Pillow calls them
_NOT_READ |= {"F": "floating-point numbers", "I": "integers of 32 bits"}
# width, height, largest value
_NETPBM = re.compile(rb"P([2356])" + 3 * rb"(?:\s|#[^\n]*\n)+([0-9]{1,6})" + rb"\s")
_ORIENTATION, _BITS, _PLANAR = 274, 258, 284  # tags of TIFF, the first of EXIF, too
_remarked: set[tuple[Path, str]] = set()  # what has been said of the pictures of a folder
_made: list[Path] = []  # folders that `make_folder` has made
# of the two parsers
_BROKEN = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, RecursionError)
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
        raise OmnistereoError(
            f"{name} is {shortened(path)}; expected the name of a file or folder"
        ) from None


def read_bytes(path: str | Path, most: int = _MAX_BYTES) -> bytes:
    """Return the content of a regular file of at most `most` bytes; an `OmnistereoError` says why
    it cannot be read.
    """
    path = as_path(path)
    try:
        status = path.stat()  # opening a pipe would wait for its other end
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
    """Return the path of a name in the file `source`; an `OmnistereoError` says that it leaves
    `root` (the folder).
    """
    path = folder / str(name)
    try:
        path.exists()  # raises for a name that no file can have
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
    """Return the content of a text file in UTF-8, else in Latin-1, which the comments of older
    programs have.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def read_data(path: str | Path, most: int = _MAX_TEXT) -> Any:
    """Return the content of a JSON, XML (by their suffixes) or YAML file as Python values.

    A matrix of OpenCV is a mapping with its rows, cols and data; values in XML are text. An
    `OmnistereoError` names what is damaged, stated twice, nested too deeply, or repeated too often
    by aliases.
    """
    import yaml

    text = read_text(path, most)
    if Path(path).suffix == ".json":
        return parse_json(text, path)
    if Path(path).suffix == ".xml":
        return _parse_xml(text, path)
    # OpenCV before 5 writes "%YAML:1.0", people "data:[" without a blank, ROS a line of dashes
    # behind a message.
    text = re.sub(r"\A\s*%YAML:.*|\n---\s*\Z", "", text)
    text = re.sub(r"(?m)^([ ]*[\w.-]+:)(?=[\[{])", r"\1 ", text)
    try:
        return _not_deep(_yaml_loader()(text).get_single_data())
    except (yaml.YAMLError, *_BROKEN) as error:
        raise _damaged(path, error) from None


def parse_json(text: str | bytes, source: str | Path) -> Any:
    """Return JSON as Python values; an `OmnistereoError` names the source, and what is damaged or
    stated twice.
    """
    try:
        return _not_deep(json.loads(text, object_pairs_hook=_unique))
    except _BROKEN as error:
        raise _damaged(source, error) from None


def _parse_xml(text: str, source: str | Path) -> Any:
    """Return XML as a mapping from the name of its root; elements called `_` are a list, as OpenCV
    writes it.
    """
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
    """Return values as they are, which are not nested so deeply that Python could not compare or
    show them.
    """
    inner = [values]
    for _ in range(_MAX_DEPTH):
        inner = [part for value in inner for part in _parts(value)]
        if not inner:
            return values
    raise ValueError(f"values nested more than {_MAX_DEPTH} deep")


def _parts(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def _yaml_loader() -> type:
    """Return a loader in Python, whose recursion is limited: that in C crashes where a file is
    nested deeply.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        def get_single_node(self) -> Any:
            node = super().get_single_node()
            if node is not None and _expanded(node, {}) > _MAX_VALUES:
                raise yaml.YAMLError(f"aliases repeat more than {_MAX_VALUES} values")
            return node

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            _unique(
                [(key.value, None) for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
            )
            return super().construct_mapping(node, deep)

    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(
            f"tag:yaml.org,2002:{tag}",
            lambda loader, node: loader.construct_mapping(node, deep=True),
        )
    return Loader


def _expanded(node: Any, known: dict[int, float]) -> float:
    """Return the number of values of a YAML node with those of its aliases; infinite if it holds
    itself.
    """
    if id(node) not in known:
        known[id(node)] = np.inf
        parts = node.value if isinstance(node.value, list) else []
        children = (
            child for part in parts for child in (part if isinstance(part, tuple) else [part])
        )
        known[id(node)] = 1 + sum(_expanded(child, known) for child in children)
    return known[id(node)]


def open_picture(path: str | Path) -> tuple[bytes, Any]:
    """Return the content of an image file and what Pillow reads of its header, whose pixels are not
    decoded yet.

    Raises an `OmnistereoError` if the file is missing, not an image, larger than any picture, or
    damaged where that shows without decoding it.
    """
    from PIL import Image, UnidentifiedImageError

    content = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            Image.open(BytesIO(content), formats=_FORMATS).verify()  # the checksums of a PNG
            picture = Image.open(BytesIO(content), formats=_FORMATS)
            orientation = Image.Image.getexif(picture).get(_ORIENTATION, 1)  # that of PNG decodes
            if orientation != 1 and picture.format == "TIFF":
                content = _not_turned(content)
                picture = Image.open(BytesIO(content), formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise OmnistereoError(f"{path} is too large for a picture: {error}") from None
    except UnidentifiedImageError:
        found = f"{path} is not an image ({len(content)} bytes)"
        raise OmnistereoError(f"{found}; expected one of {', '.join(_FORMATS)}") from None
    except Exception as error:  # of many types
        raise _damaged_picture(path, error) from None
    if picture.width * picture.height > MAX_PIXELS or max(picture.size) > _MAX_SIDE:
        raise OmnistereoError(
            f"{path} is too large for a picture: {picture.width} × {picture.height} pixels"
        )
    if picture.format == "JPEG" and not (
        b"\xff\xd9" in content[-64:] and content.count(b"\xff\xda") <= _MAX_SCANS
    ):
        raise _damaged_picture(path, "without the marker of its end, or of too many scans")
    if orientation != 1:
        remark_turned(path, f"or mirrored (orientation {orientation})")
    return content, picture


def check_image(path: str | Path, image_size: tuple[int, int] | None = None) -> tuple[bytes, Any]:
    """Return what `open_picture` does of a picture of gray or RGB values and of a size (width,
    height), if given.

    Raises an `OmnistereoError` if it has others, or as `open_picture`.
    """
    content, picture = open_picture(path)
    check_size(path, picture.size, image_size)
    if (found := _NOT_READ.get(picture.mode)) and picture.format != "PPM":
        raise OmnistereoError(
            f"{path} holds {found}; expected gray or RGB values of 8 or 16 bits. Convert it."
        )
    if picture.mode in ("RGBA", "LA", "PA"):
        _remark(path, "has transparency, which is ignored")
    if (more := pages_of(path, picture) - 1) > 0:
        _remark(
            path, f"has {more} more {'page, which is' if more == 1 else 'pages, which are'} ignored"
        )
    return content, picture


def pages_of(path: str | Path, picture: Any) -> int:
    """Return how many pages a picture has; an `OmnistereoError` says that one does not lead to the
    next.
    """
    try:
        return int(getattr(picture, "n_frames", 1))
    except Exception as error:  # of many types
        raise _damaged_picture(path, error) from None


def read_pixels(path: str | Path) -> NDArray[Any]:
    """Return the pixels of an image file as they are stored: (height, width) or RGB, (height,
    width, 3).

    They are uint8, or uint16 where the file has more bits. Raises an `OmnistereoError` as
    `check_image`, or if the pixels are damaged. A JPEG that is damaged in the middle is read as far
    as it can be, with a warning.
    """
    return _read_pixels(path, None)[0]


def _read_pixels(
    path: str | Path, image_size: tuple[int, int] | None
) -> tuple[NDArray[Any], int | None]:
    """Return what `read_pixels` does, and the value that means white; None: 16 bits, which may not
    all be used.
    """
    content, picture = check_image(path, image_size)
    try:
        if picture.format == "JPEG":
            return _decode_jpeg(path, content, picture.mode), 255
        if netpbm := _NETPBM.match(content):
            return _decode_netpbm(content, netpbm), int(netpbm[4])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            pixels = _decode(content, picture)
        return pixels, 255 if pixels.dtype == np.uint8 else None
    except Exception as error:  # of many types
        raise _damaged_picture(path, error) from None


def _decode_jpeg(path: str | Path, content: bytes, mode: str) -> NDArray[np.uint8]:
    """Return the pixels of a JPEG; warn if it is damaged, which other decoders print or keep for
    themselves.
    """
    from simplejpeg import decode_jpeg

    space = "GRAY" if mode == "L" else "RGB"
    try:
        pixels = decode_jpeg(content, space)
    except ValueError as error:
        pixels = decode_jpeg(content, space, strict=False)
        _remark(
            path, f"is damaged, so that a part of the picture may be wrong ({error}). Copy it again"
        )
    return pixels[..., 0] if mode == "L" else pixels


def _decode_netpbm(content: bytes, header: re.Match[bytes]) -> NDArray[Any]:
    """Return the pixels of a PGM or PPM, as text or bytes; raises a `ValueError` if there are too
    few or too large.
    """
    kind, width, height, most = header[1], *map(int, header.groups()[1:])
    shape = (height, width) if kind in b"25" else (height, width, 3)
    count = math.prod(shape)
    if kind in b"23":
        values = np.array(
            re.sub(rb"#.*", b"", content[header.end() :]).split(None, count)[:count]
        ).astype(np.uint16)
    else:
        values = np.frombuffer(content, ">u2" if most > 255 else np.uint8, count, header.end())
    if values.max() > most:
        raise ValueError(f"a value of {values.max()}, where {most} is the largest")
    return values.astype(np.uint8 if most <= 255 else np.uint16).reshape(shape)


def _decode(content: bytes, picture: Any) -> NDArray[Any]:
    """Return the pixels of a picture; Pillow reads all, and only checks colours of 16 bits, which
    it would round.
    """
    import cv2

    tags = getattr(picture, "tag_v2", {})  # of a TIFF
    is_deep = ";16" in str(picture.tile) or max(tags.get(_BITS, (8,))) > 8
    if is_deep and tags.get(_PLANAR) == 2:
        raise ValueError("colours of 16 bits that are stored apart")
    picture.load()
    if is_deep and not picture.mode.startswith("I"):
        return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED))[
            ..., 2::-1
        ]
    if not picture.mode.startswith("I"):
        picture = picture.convert("L" if picture.mode in ("1", "L", "LA") else "RGB")
    pixels = np.asarray(picture)
    return pixels.astype(pixels.dtype.newbyteorder("="))


def _not_turned(content: bytes) -> bytes:
    """Return a TIFF without its mark that it is turned, which decoders would follow."""
    import tifffile

    file = BytesIO(content)
    with tifffile.TiffFile(file, mode="r+") as tiff:
        tiff.pages.first.tags[_ORIENTATION].overwrite(1)
    return file.getvalue()


def _damaged_picture(path: str | Path, reason: object) -> OmnistereoError:
    return OmnistereoError(
        f"{path} is damaged, truncated or of an unusual form ({reason}). Copy or convert it."
    )


def _remark(path: str | Path, what: str) -> None:
    """Warn of something in a picture, once for all pictures of its folder."""
    place = (Path(path).parent, what)
    if place not in _remarked:
        _remarked.add(place)
        warnings.warn(f"{path} {what}", UserWarning, stacklevel=2)


def remark_turned(path: str | Path, how: str) -> None:
    """Warn of a picture or video that is marked as turned, once for all in its folder."""
    _remark(
        path,
        f"is marked as turned {how}; its pixels are taken as they are stored, as a calibration"
        " means them. If yours means the turned picture, store that without the mark",
    )


def check_size(path: str | Path, found: tuple[int, int], expected: tuple[int, int] | None) -> None:
    """Raise an `OmnistereoError` if an image has another size (width, height) than its camera."""
    if expected is not None and found != tuple(expected):
        size, camera = (f"{width} × {height} px" for width, height in (found, expected))
        raise OmnistereoError(
            f"{path} is {size}; the camera has {camera}. Pass images as captured: not resized,"
            " cropped or rotated."
        )


def read_image(path: str | Path, image_size: tuple[int, int] | None = None) -> NDArray[Any]:
    """Read an image: (height, width) if it is gray, else (height, width, 3) in RGB, of values from
    0 to 255.

    They are uint8, or float32 where the file has other than 8 bits. Of a file of 16 bits white is
    its largest value of 8, 10, 12, 14 or 16 bits, as many as its pixels use; PGM and PPM state it.
    `image_size` is the width and height that it must have, compared before it is decoded. A mark
    that it is turned (EXIF, TIFF) is ignored: calibrations refer to the pixels of the sensor.
    Raises as `read_pixels`.
    """
    pixels, white = _read_pixels(path, image_size)
    if white == 255:
        return pixels
    if white is None:
        bits = next(bits for bits in (8, 10, 12, 14, 16) if pixels.max() < 1 << bits)
        white = (1 << bits) - 1
        if bits < 16:
            _remark(
                path,
                f"uses {bits} of its 16 bits, so that {white} is taken as white. A PGM or PPM can"
                " state it",
            )
    return pixels * np.float32(255 / white)


def read_gray(path: str | Path, image_size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read an image of a known size, such as a mask, as gray, shape (height, width); see
    `read_image`.
    """
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
                raise OmnistereoError(
                    f"{folder} has {found[path.stem].name} and {path.name}; expected one. Keep one"
                )
            found[path.stem] = path
    return found


def write_image(path: str | Path, image: NDArray[Any]) -> None:
    """Write an image, gray (height, width) or RGB (height, width, 3), in the format of the file
    name suffix.

    Values range from 0 to 255; NaN becomes black. uint16 is written as it is, for PNG. JPEG files
    have quality 95, OpenCV's default.
    """
    import cv2

    pixels = (
        image
        if image.dtype == np.uint16
        else np.nan_to_num(image).clip(0, 255).round().astype(np.uint8)
    )
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
    content = cv2.imencode(Path(path).suffix, pixels)[1]
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())


def write_text(path: str | Path, text: str) -> None:
    """Write a text in UTF-8, atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path beside it, rename it on success, remove it on
    failure.

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
        now = temporary.stat().st_mtime  # of the disk: the clocks of machines that share it differ
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
        return  # Windows has no such thing
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove_stale(path: Path, now: float) -> None:
    """Remove the temporary files of `path` to which nobody has written for an hour, by the clock of
    the disk.
    """
    for left in path.parent.glob(f".{'[0-9a-f]' * 16}.{glob.escape(path.name)}"):
        with suppress(FileNotFoundError):  # another writer was quicker
            if now - left.stat().st_mtime > _STALE:
                left.unlink()


def make_folder(path: str | Path) -> Path:
    """Make a folder and its parents if missing; return its path. An `OmnistereoError` says why it
    is not writable.
    """
    path = Path(path)
    _made.extend(folder for folder in (path, *path.parents) if not folder.exists())
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        message = (
            f"folder {path} cannot be made or written to: {error.strerror}. Choose another folder."
        )
        raise OmnistereoError(message) from None


def remove_empty_folders() -> None:
    """Remove the folders that `make_folder` has made and nothing was written into, as before a
    refusal.
    """
    for folder in sorted(set(_made), reverse=True):  # inner ones first
        with suppress(OSError):
            folder.rmdir()
    _made.clear()


def is_whole(path: str | Path) -> bool:
    """Return whether an image file is there and complete, as far as can be seen without decoding
    it.
    """
    try:
        open_picture(path)
    except OmnistereoError:
        return False
    return True


def unpack(folder: Path) -> None:
    """Unpack NAME.zip where a folder NAME, or one above it, is not there yet, but its archive is.

    Sets of thousands of small files lie as one archive each; the folder appears when it is whole.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    archive = next(
        (p for path in missing if (p := path.parent / f"{path.name}.zip").exists()), None
    )
    if archive is None:
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
