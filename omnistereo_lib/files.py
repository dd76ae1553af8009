"""File access: errors that name the file, and atomic writes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError

_END_MARKERS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND"}  # JPEG and PNG: first bytes → end-of-image marker


def read_bytes(path: str | Path) -> bytes:
    """Return the content of a file; an `OmnistereoError` says why it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise OmnistereoError(f"{path} cannot be read: {error.strerror}. Check the path.") from None


def read_text(path: str | Path) -> str:
    """Return the content of a text file; bytes that are not UTF-8 become replacement characters."""
    return read_bytes(path).decode("utf-8", errors="replace")


def read_pixels(path: str | Path, flags: int) -> NDArray:
    """Decode an image file with OpenCV; `flags` select depth and colour, see `cv2.imdecode`.

    Raises an `OmnistereoError` if the file is missing, not an image, or truncated: OpenCV would fill it with gray.
    """
    import cv2

    content = read_bytes(path)
    end = _END_MARKERS.get(content[:2])
    if end is not None and end not in content[-64:]:
        raise OmnistereoError(f"{path} is truncated ({len(content)} bytes, no end-of-image marker). Copy it again.")
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    except cv2.error:  # the header states an absurd size
        pixels = None
    if pixels is None:
        raise OmnistereoError(f"{path} is not an image ({len(content)} bytes); expected PNG, JPEG or similar")
    return pixels


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read an image, uint8: (height, width) if it is gray, else (height, width, 3) in RGB.

    The EXIF orientation is ignored: calibrations refer to the pixels of the sensor. Raises as `read_pixels`.
    """
    import cv2

    image = read_pixels(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_gray(path: str | Path, image_size: tuple[int, int]) -> NDArray[np.uint8]:
    """Read an image of a known size (width, height), such as a mask, as gray, shape (height, width).

    Raises as `read_pixels`, and if the size differs.
    """
    image = read_image(path)
    height, width = image.shape[:2]
    if (width, height) != image_size:
        raise OmnistereoError(f"{path} is {width} × {height} px, the camera {image_size[0]} × {image_size[1]} px")
    return image if image.ndim == 2 else image.max(-1)


def write_image(path: str | Path, image: NDArray) -> None:
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

    Raises an `OmnistereoError` if the folder is missing or not writable.
    """
    path = Path(path)
    temporary = path.with_name(f".{os.getpid()}.{path.name}")  # same suffix: writers choose the format by it
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise OmnistereoError(
            f"{path} cannot be written: {error.strerror}. Give a file in an existing, writable folder."
        ) from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def make_folder(path: str | Path) -> Path:
    """Make a folder and its parents if missing; return its path. An `OmnistereoError` says why it is not writable."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        message = f"folder {path} cannot be made or written to: {error.strerror}. Choose another folder."
        raise OmnistereoError(message) from None
