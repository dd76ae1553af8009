"""Containers of pictures: what their counts, lengths and offsets lead to must lie in the file.

Decoders trust these fields: a directory of TIFF that is its own successor never ends, and one byte in the length of a
PNG's chunk costs gigabytes. So they are followed here first. A `ContainerError` says what is wrong.
"""

import struct
import zlib
from typing import NamedTuple

MAX_PIXELS = 1 << 26  # of a picture or panorama: decoding one takes less than a gigabyte
_MAX_SIDE = 100_000
_JPEG, _PNG, _TIFF = b"\xff\xd8", b"\x89PNG\r\n\x1a\n", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")  # first bytes
_JPEG_END = b"\xff\xd9"
_MAX_PAGES = 1000
_MAX_VISITS = 1 << 31  # pixels × scans of a JPEG, whose decoder goes over the whole picture for each of its scans
_PIXELS_PER_BYTE = {"PNG": 8 * 1032, "JPEG": 1024, "BMP": 128, "PPM": 8}  # the most that a format can hold
_TIFF_SIZES = dict(enumerate((1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4), 1)) | {16: 8, 17: 8, 18: 8}  # bytes, by type
_TIFF_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_HEIGHT, _FORMAT = 256, 257, 258, 277, 322, 323, 339
_FLOAT = 3  # of the sample format


class ContainerError(ValueError):
    """What is wrong with a container, as the end of a sentence: "damaged (…)"."""


class TiffPage(NamedTuple):
    """A page of a TIFF, as its directory states it."""

    width: int
    height: int
    is_float: bool  #: one number per pixel, float32 or float64


def check_container(content: bytes) -> int:
    """Check what can be seen of a PNG, TIFF or JPEG without decoding it; return the number of pages of a TIFF, or 0."""
    if content[:8] == _PNG:
        check_png(content)
    elif content[:4] in _TIFF:
        return len(tiff_pages(content))
    elif content[:2] == _JPEG and _JPEG_END not in content[-64:]:
        raise ContainerError(f"truncated ({len(content)} bytes, no end-of-image marker)")
    return 0


def check_pixels(width: int, height: int) -> None:
    """Check that a picture is small enough to be decoded."""
    if width * height > MAX_PIXELS or max(width, height) > _MAX_SIDE:
        raise ContainerError(f"too large for a picture ({width} × {height} pixels are too many)")


def check_density(width: int, height: int, kind: str | None, content: bytes) -> None:
    """Check that the content of a file can hold so many pixels in a format, by Pillow's name for it."""
    scans = content.count(b"\xff\xda") if kind == "JPEG" else 1
    if width * height > min(_PIXELS_PER_BYTE.get(kind or "", MAX_PIXELS) * len(content), _MAX_VISITS // max(scans, 1)):
        raise ContainerError(f"damaged (it states {width} × {height} pixels in {len(content)} bytes)")


def check_png(content: bytes) -> None:
    """Check that the chunks of a PNG follow one another to the end, each with its checksum."""
    at = 8
    while at + 12 <= len(content):
        size, name = struct.unpack_from(">I4s", content, at)
        start, end = at + 4, at + 8 + size
        if end + 4 > len(content):
            break
        if zlib.crc32(memoryview(content)[start:end]) != int.from_bytes(content[end : end + 4], "big"):
            raise ContainerError(f"damaged (the checksum of a chunk at byte {at})")
        if name == b"IEND":
            return
        at = end + 4
    raise ContainerError(f"truncated ({len(content)} bytes, no end-of-image marker)")


def tiff_pages(content: bytes) -> list[TiffPage]:
    """Return the pages of a TIFF, classic or BigTIFF, none of which is too large."""
    order = "<" if content[:2] == b"II" else ">"
    pages: dict[int, TiffPage] = {}  # by the byte at which the directory begins
    try:
        big = struct.unpack_from(order + "H", content, 2)[0] == 43
        count, word = (order + "Q", order + "Q") if big else (order + "H", order + "I")
        (at,) = struct.unpack_from(word, content, 8 if big else 4)
        while at:
            if at in pages or len(pages) == _MAX_PAGES:
                raise ContainerError(f"damaged (the directory after page {len(pages)} is one before, or one too many)")
            pages[at], at = _read_directory(content, at, count, word)
    except (struct.error, OverflowError, IndexError):
        raise ContainerError(f"truncated (a directory beyond its {len(content)} bytes)") from None
    return list(pages.values())


def _read_directory(content: bytes, at: int, count: str, word: str) -> tuple[TiffPage, int]:
    """Return the page of a directory at a byte and where the next one is; raises `struct.error` beyond the end."""
    order, inline, found = word[0], struct.calcsize(word), {_SAMPLES: 1, _BITS: 1, _FORMAT: 1}
    (entries,) = struct.unpack_from(count, content, at)
    start, length = at + struct.calcsize(count), 4 + 2 * inline  # of the first entry, of each
    (after,) = struct.unpack_from(word, content, start + entries * length)
    for entry in range(start, start + entries * length, length):
        tag, kind, number = struct.unpack_from(f"{order}HH{word[1]}", content, entry)
        place, size = entry + 4 + inline, number * _TIFF_SIZES.get(kind, 0)
        if size > inline:
            (place,) = struct.unpack_from(word, content, place)
        if place + size > len(content):
            raise ContainerError(f"damaged (its tag {tag} ends at byte {place + size} of {len(content)})")
        if kind in _TIFF_INTEGERS and number:
            (found[tag],) = struct.unpack_from(order + _TIFF_INTEGERS[kind], content, place)
    width, height = found.get(_WIDTH, 0), found.get(_HEIGHT, 0)
    check_pixels(width, height)
    check_pixels(found.get(_TILE_WIDTH, 0), found.get(_TILE_HEIGHT, 0))
    is_float = found[_FORMAT] == _FLOAT and found[_SAMPLES] == 1 and found[_BITS] in (32, 64)
    return TiffPage(width, height, is_float), after
