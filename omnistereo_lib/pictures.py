"""Pictures: read with what is wrong with them said, and written."""

import logging
import math
import re
import warnings
from collections.abc import Iterable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, read_bytes

# Of a picture or panorama: decoding one takes less than a gigabyte.
MAX_PIXELS = 1 << 26
_MAX_SIDE = 100_000
# Of a JPEG, whose decoder goes over the whole picture for each of its scans.
_MAX_SCANS = 64
# Formats that are read, as Pillow calls them.
_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP")
# modes, as Pillow calls them
_NOT_READ = {mode: f"{mode} colours" for mode in ("CMYK", "LAB", "YCbCr", "HSV")}
_NOT_READ |= {"F": "floating-point numbers", "I": "integers of 32 bits"}
_EXPECTED = "expected grey or RGB values of 8 or 16 bits. Convert it."
# All but those within a scan.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)
# width, height, largest value
_NETPBM = re.compile(rb"P([2356])" + 3 * rb"(?:\s|#[^\n]*\n)+([0-9]{1,6})" + rb"\s")
# Compressions of TIFF: none, and deflate by both of its numbers.
_PLAIN = (1, 8, 32946)
# What has been said of the pictures of a folder.
_remarked: set[tuple[Path, str]] = set()


def open_picture(path: str | Path) -> tuple[bytes, Any]:
    """Return the content of an image file and what Pillow reads of its header, not yet decoded.

    Raises an `OmnistereoError` if the file is missing, not an image, larger than any picture, or
    damaged where that shows without decoding it.
    """
    from PIL import ExifTags, Image, UnidentifiedImageError

    content = read_bytes(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # The checksums of a PNG.
            Image.open(BytesIO(content), formats=_FORMATS).verify()
            picture = Image.open(BytesIO(content), formats=_FORMATS)
            # That of PNG decodes.
            orientation = Image.Image.getexif(picture).get(ExifTags.Base.Orientation, 1)
            if orientation != 1 and picture.format == "TIFF":
                content = _not_turned(content)
                picture = Image.open(BytesIO(content), formats=_FORMATS)
    except Image.DecompressionBombError as error:
        raise OmnistereoError(f"{path} is too large for a picture: {error}") from None
    except UnidentifiedImageError:
        if of_what := _tiff_values(content):
            raise OmnistereoError(f"{path} holds {of_what}; {_EXPECTED}") from None
        found = f"{path} is not an image ({len(content)} bytes)"
        raise OmnistereoError(f"{found}; expected one of {', '.join(_FORMATS)}") from None
    except Exception as error:  # of many types
        raise _damaged_picture(path, error) from None
    if picture.width * picture.height > MAX_PIXELS or max(picture.size) > _MAX_SIDE:
        raise OmnistereoError(
            f"{path} is too large for a picture: {picture.width} × {picture.height} pixels"
        )
    if picture.format == "JPEG":
        # Embedded cameras pad their pictures, and telephones put a film behind them.
        content = content[: _jpeg_end(content)]
        if not content:
            raise _damaged_picture(path, "without the marker of its end, or of too many scans")
    if orientation != 1:
        remark_turned(path, f"or mirrored (orientation {orientation})")
    return content, picture


def _tiff_values(content: bytes) -> str | None:
    """Return what a TIFF that Pillow does not know holds, such as float32; None if it is none."""
    import tifffile

    with suppress(Exception):  # of many types
        logging.getLogger("tifffile").setLevel(logging.CRITICAL)
        page = tifffile.TiffFile(BytesIO(content)).pages.first
        if page.dtype is not None and page.dtype.kind in "if" and page.dataoffsets:
            return f"values of {page.dtype}, {' × '.join(map(str, page.shape))}"
    return None


def _jpeg_end(content: bytes) -> int:
    """Return where the picture of a JPEG ends; 0 if it is cut off or has too many scans."""
    at, scans = 2, 0
    while scans <= _MAX_SCANS and (found := _JPEG_MARKER.search(content, at)):
        marker, at = found[0][1], found.end()
        if marker == 0xD9:
            return at
        scans += marker == 0xDA
        at += int.from_bytes(content[at : at + 2], "big")  # a segment begins with its length
    # Damaged in the middle, it may still end as a picture does.
    is_whole = b"\xff\xd9" in content[-64:] and content.count(b"\xff\xda") <= _MAX_SCANS
    return len(content) if is_whole else 0


def check_image(path: str | Path, image_size: tuple[int, int] | None = None) -> tuple[bytes, Any]:
    """Return what `open_picture` does, of a gray or RGB picture of a size (width, height) if given.

    Raises an `OmnistereoError` if it has others, or as `open_picture`.
    """
    content, picture = open_picture(path)
    check_size(path, picture.size, image_size)
    if (found := _NOT_READ.get(picture.mode)) and picture.format != "PPM":
        raise OmnistereoError(f"{path} holds {found}; {_EXPECTED}")
    if picture.mode in ("RGBA", "LA", "PA"):
        _remark(path, "has transparency, which is ignored")
    if (more := pages_of(path, picture) - 1) > 0:
        pages = "page, which is" if more == 1 else "pages, which are"
        _remark(path, f"has {more} more {pages} ignored")
    return content, picture


def pages_of(path: str | Path, picture: Any) -> int:
    """Return how many pages a picture has; refuse one whose pages do not lead to each other."""
    try:
        return int(getattr(picture, "n_frames", 1))
    except Exception as error:  # of many types
        raise _damaged_picture(path, error) from None


def read_pixels(path: str | Path) -> NDArray[Any]:
    """Return the pixels of an image file as they are stored: (height, width) or (height, width, 3).

    They are uint8, or uint16 where the file has more bits. Raises an `OmnistereoError` as
    `check_image`, or if the pixels are damaged. A JPEG that is damaged in the middle is read as far
    as it can be, with a warning.
    """
    return _read_pixels(path, None)[0]


def _read_pixels(
    path: str | Path, image_size: tuple[int, int] | None
) -> tuple[NDArray[Any], int | None]:
    """Return what `read_pixels` does, and the value of white; None: some of 16 bits."""
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
    """Return the pixels of a JPEG; warn if it is damaged, which other decoders do not tell."""
    from simplejpeg import decode_jpeg

    space = "GRAY" if mode == "L" else "RGB"
    try:
        pixels = decode_jpeg(content, space)
    except ValueError as error:
        pixels = decode_jpeg(content, space, strict=False)
        found = f"is damaged, so that a part of the picture may be wrong ({error})"
        _remark(path, f"{found}. Copy it again")
    return pixels[..., 0] if mode == "L" else pixels


def _decode_netpbm(content: bytes, header: re.Match[bytes]) -> NDArray[Any]:
    """Return the pixels of a PGM or PPM; a `ValueError` if they are too few or too large."""
    kind, width, height, most = header[1], *map(int, header.groups()[1:])
    shape = (height, width) if kind in b"25" else (height, width, 3)
    count = math.prod(shape)
    if kind in b"23":
        words = re.sub(rb"#.*", b"", content[header.end() :]).split(None, count)
        values = np.array(words[:count]).astype(np.uint16)
    else:
        values = np.frombuffer(content, ">u2" if most > 255 else np.uint8, count, header.end())
    if values.max() > most:
        raise ValueError(f"a value of {values.max()}, where {most} is the largest")
    return values.astype(np.uint8 if most <= 255 else np.uint16).reshape(shape)


def _decode(content: bytes, picture: Any) -> NDArray[Any]:
    """Return the pixels of a picture; of 16 bits a colour Pillow only checks: it would round."""
    import cv2
    from PIL.ExifTags import Base

    # Of a TIFF.
    tags = getattr(picture, "tag_v2", {})
    bits = tags.get(Base.BitsPerSample, (8,))
    is_deep = ";16" in str(picture.tile) or max(bits) > 8
    if is_deep and tags.get(Base.PlanarConfiguration) == 2:
        raise ValueError("colours of 16 bits that are stored apart")
    is_plain = tags.get(Base.PhotometricInterpretation) in (1, 2)
    simple = picture.mode in ("L", "RGB", "I;16") and is_plain
    if simple and {*bits} <= {8, 16} and (pixels := decode_tiff(content, 0)) is not None:
        return pixels
    picture.load()
    if is_deep and not picture.mode.startswith("I"):
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        return np.asarray(decoded)[..., 2::-1]
    if not picture.mode.startswith("I"):
        picture = picture.convert("L" if picture.mode in ("1", "L", "LA") else "RGB")
    pixels = np.asarray(picture)
    return pixels.astype(pixels.dtype.newbyteorder("="))


def decode_tiff(content: bytes, page: int) -> NDArray[Any] | None:
    """Return the pixels of a page of a TIFF as stored; None if it is neither plain nor deflated.

    Raises one of several types if they are damaged: zlib compares the sum of what it unpacks, which
    libtiff, of Pillow and OpenCV, does not. libtiff prints into the terminal, too.
    """
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with tifffile.TiffFile(BytesIO(content)) as tiff:
        found = tiff.pages[page].aspage()
        if found.compression not in _PLAIN or found.planarconfig != 1 or found.predictor != 1:
            return None
        if 0 in (*found.dataoffsets, *found.databytecounts):
            raise ValueError("it has lost a strip")
        pixels = found.asarray()
    return pixels.astype(pixels.dtype.newbyteorder("="))


def _not_turned(content: bytes) -> bytes:
    """Return a TIFF without its mark that it is turned, which decoders would follow."""
    import tifffile

    file = BytesIO(content)
    with tifffile.TiffFile(file, mode="r+") as tiff:
        tiff.pages.first.tags["Orientation"].overwrite(1)
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
    """Read an image: (height, width) in gray, else (height, width, 3) in RGB, from 0 to 255.

    They are uint8, or float32 where the file has other than 8 bits. Of a file of 16 bits white is
    its largest value of 8, 10, 12, 14 or 16 bits, as many as its pixels use; PGM and PPM state it.
    `image_size` is the width and height that it must have, compared before it is decoded. A mark
    that it is turned (EXIF, TIFF) is ignored, as calibrations do. Raises as `read_pixels`.
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
    """Read an image of a known size, such as a mask, as gray (height, width); see `read_image`."""
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
    """Write an image, gray or RGB (height, width, 3), in the format of the suffix.

    Values range from 0 to 255; NaN becomes black. uint16 is written as it is, for PNG. JPEG files
    have quality 95, OpenCV's default.
    """
    import cv2

    pixels = image
    if image.dtype != np.uint16:
        pixels = np.nan_to_num(image).clip(0, 255).round().astype(np.uint8)
    pixels = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
    content = cv2.imencode(Path(path).suffix, pixels)[1]
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.tobytes())


def is_whole(path: str | Path) -> bool:
    """Return whether an image file is complete, as far as can be seen without decoding it."""
    try:
        open_picture(path)
    except OmnistereoError:
        return False
    return True
