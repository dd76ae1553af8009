"""Reading and writing files such that bad ones are named and half-written ones never stay."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError

_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND"}  # how JPEG and PNG files begin and end


def read_bytes(path: str | Path) -> bytes:
    """Return a file's content; an `OmnistereoError` says why if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise OmnistereoError(f"{path} cannot be read: {error.strerror}. Check the path") from None


def read_text(path: str | Path) -> str:
    """Return a text file's content; bytes that are not UTF-8 become replacement characters."""
    return read_bytes(path).decode("utf-8", errors="replace")


def read_pixels(path: str | Path, flags: int) -> NDArray:
    """Decode a picture file with OpenCV's `flags` for depth and colour.

    Raises
    ------
    OmnistereoError
        If the file is missing, cut short or no picture. OpenCV itself fills the missing part of a JPEG or a
        PNG with gray or black, hence the look at how the file ends.
    """
    import cv2

    content = read_bytes(path)
    end = _ENDS.get(content[:2])
    if end is not None and end not in content[-64:]:
        raise OmnistereoError(f"{path} is cut short: {len(content)} bytes without an end. Copy it again")
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    except cv2.error:  # a header that promises more pixels than anybody has
        pixels = None
    if pixels is None:
        raise OmnistereoError(f"{path} holds no picture, {len(content)} bytes; expected PNG, JPEG or the like")
    return pixels


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture as it was taken, uint8: (height, width) if it is gray, else (height, width, 3) in RGB.

    A remark in the file that asks viewers to turn it is not followed: calibrations know nothing of it.

    Raises
    ------
    OmnistereoError
        As `read_pixels`.
    """
    import cv2

    picture = read_pixels(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def read_gray(path: str | Path, image_size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read a picture of a known size (width, height), such as a mask, as gray, shape (height, width).

    Raises
    ------
    OmnistereoError
        As `read_image`, or if the size is another one.
    """
    picture = read_image(path)
    picture = picture if picture.ndim == 2 else picture.max(-1)
    if picture.shape != image_size[::-1]:
        height, width = picture.shape
        raise OmnistereoError(f"{path} is {width} × {height} px, the camera {image_size[0]} × {image_size[1]} px")
    return picture


def write_image(path: str | Path, picture: NDArray) -> None:
    """Write a picture, gray (height, width) or RGB (height, width, 3), in the format that the name's ending says.

    Values are 0 … 255; NaN becomes black. JPEG files have quality 95.
    """
    import cv2

    pixels = np.nan_to_num(picture).clip(0, 255).round().astype(np.uint8)
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
    suffix = Path(path).suffix
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95] if suffix.lower() in (".jpg", ".jpeg") else []
    content = cv2.imencode(suffix, pixels, quality)[1]
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())


def write_ply(path: str | Path, points: NDArray, colors: NDArray | None = None) -> None:
    """Write a point cloud (M, 3) in metres, with uint8 RGB colours (M, 3) if given, as binary PLY."""
    names = ["x", "y", "z"] + (["red", "green", "blue"] if colors is not None else [])
    kinds = {"x": "<f4", "y": "<f4", "z": "<f4", "red": "u1", "green": "u1", "blue": "u1"}
    vertices = np.empty(len(points), [(name, kinds[name]) for name in names])
    for name, values in zip(names, np.column_stack([points] + ([] if colors is None else [colors])).T, strict=True):
        vertices[name] = values
    properties = [f"property {'float' if kinds[name] == '<f4' else 'uchar'} {name}" for name in names]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties, "end_header"]
    with atomic_write(path) as temporary:
        temporary.write_bytes("\n".join([*header, ""]).encode() + vertices.tobytes())


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary name beside a file to write to, then rename: readers see all of it or nothing.

    Raises
    ------
    OmnistereoError
        If the folder is missing or not writable. What was written stays nowhere then.
    """
    path = Path(path)
    temporary = path.with_name(f".{os.getpid()}.{path.name}")  # the same ending: writers look at it
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise OmnistereoError(
            f"{path} cannot be written: {error.strerror}. Give a file in an existing, writable folder"
        ) from None
    finally:
        with suppress(OSError):  # where no folder is, no file is left
            temporary.unlink()


def make_folder(path: str | Path) -> Path:
    """Make a folder, and those above it, unless it is there; return its path.

    Raises
    ------
    OmnistereoError
        If it cannot be made or is not writable.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        message = f"folder {path} cannot be made or written to: {error.strerror}. Choose another"
        raise OmnistereoError(message) from None
