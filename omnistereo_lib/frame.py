"""A rig and its images, checked once where they enter; the files of images and exact depth."""

from __future__ import annotations

import json
from collections.abc import Sequence, Sized
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.arrays import as_array
from omnistereo_lib.consumer_images import check_not_stitched, split_image
from omnistereo_lib.errors import OmnistereoError, check_type, shortened
from omnistereo_lib.files import as_path, atomic_write, checksum
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import Sampling, SphereGrid
from omnistereo_lib.lazy import lazy_property
from omnistereo_lib.pictures import (
    MAX_PIXELS,
    decode_tiff,
    open_picture,
    pages_of,
    read_image,
    read_pixels,
)

_FEW, _SPANS = 1e-3, 1.0  # of a float image: pixels, and ranges of all others; see `Frame.of`
# Of depth files: what stands in their tags.
_SOFTWARE, _CHECKSUM = "omnistereo", "sha256 of the values"


@dataclass(frozen=True, eq=False)
class Frame:
    """A rig and what its cameras saw at one instant, with the exact depth if it is known.

    `load_dataset(...)[k]` gives one whose files are read on first use; `Frame.of` makes one of any
    rig and images.

    `number` is that of the file names; `rig` took the images, and its `min_depth` scales 16-bit PNG
    ground truth.

    >>> rig = osl.load_rig("data_samples/sunny/test")
    >>> images = osl.load_images([f"data_samples/sunny/test/cam{k}/0706.jpg" for k in (1, 2, 3, 4)])
    >>> osl.Frame.of(rig, images).images[0].shape
    (768, 800, 3)
    """

    rig: Rig
    image_paths: Sequence[Path] = ()
    number: int = 0
    gt_path: Path | None = None

    @classmethod
    def of(cls, rig: Rig, images: Frame | Sequence[ArrayLike]) -> Frame:
        """Return a frame of a rig and its images: one array per camera, (height, width) or (height,
        width, 3), RGB; or a frame, which is returned as it is if its cameras are those of the rig.

        Of float images all but one pixel in a thousand at either end make a range. What is beyond
        it by more than that range, such as a hot pixel of 1e12, is taken for as bright.

        Raises:
            OmnistereoError: If there is not one image per camera, or one has the wrong size, shape
                or type or is not finite.
        """
        check_type(rig, Rig, "rig")
        if isinstance(images, Frame):
            if rig.cameras == images.rig.cameras:
                return images
            images = images.images
        frame = cls(rig)
        frame.__dict__["images"] = check_images(images, rig)  # where the cached property keeps them
        return frame

    @lazy_property
    def images(self) -> list[NDArray[Any]]:
        """One array per camera, (height, width) or (height, width, 3) in RGB; read on first use."""
        return load_images(self.image_paths, self.rig)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is kept of the images: a copy in another process makes its own."""
        kept = ("gray", "_reduced")
        return {name: value for name, value in self.__dict__.items() if name not in kept}

    @lazy_property
    def gray(self) -> list[NDArray[np.float32]]:
        """The images in gray, (height, width); see `to_gray`."""
        return [to_gray(image) for image in self.images]

    def reduced(self, pixels_per_degree: float) -> Frame:
        """Return the frame with about a resolution of the images, if theirs is higher.

        Pixels are averaged in whole blocks; what is left at the rim is cut off. Equal sizes stay
        equal. The resolution is image width over field of view. The frame keeps what it returns.
        """
        widest = max(camera.max_fov_deg for camera in self.rig.cameras)
        sizes = [camera.image_size for camera in self.rig.cameras]
        factors = tuple(max(1, round(size[0] / widest / pixels_per_degree)) for size in sizes)
        if set(factors) == {1}:
            return self
        if factors not in self._reduced:
            cameras = [c.reduced(k) for c, k in zip(self.rig.cameras, factors, strict=True)]
            frame = replace(self, rig=replace(self.rig, cameras=cameras))
            frame.__dict__["images"] = [*map(_blocks_averaged, self.images, factors)]
            self._reduced[factors] = frame
        return self._reduced[factors]

    @lazy_property
    def _reduced(self) -> dict[tuple[int, ...], Frame]:
        return {}

    @lazy_property
    def inverse_depth(self) -> NDArray[np.float32]:
        """Ground truth, 1/m from the rig centre along each ray, 0 = sky, NaN = unknown.

        Raises an `OmnistereoError` if the frame has none.
        """
        if self.gt_path is None:
            beside = f" beside {self.image_paths[0].parent}" if self.image_paths else ""
            raise OmnistereoError(f"frame {self.number} has no ground truth{beside}")
        return read_inverse_depth(self.gt_path, self.rig.min_depth)

    def gt_index(self, grid: SphereGrid) -> NDArray[np.float64]:
        """Return the ground-truth sphere index n̂ on a grid, (H, W), not rounded; NaN = unknown.

        As in all published sets, ground-truth pixels are square and the middle row is the horizon:
        640 × 160 spans -45° to 45°. The pixel sampling is that of the grid. Each ray takes the
        nearest ground-truth pixel, since interpolation across a depth discontinuity gives a depth
        that is not in the scene.
        """
        check_type(grid, SphereGrid, "grid")
        return grid.inverse_depth_to_index(self.inverse_depth_along(grid.rays(), grid.sampling))

    def inverse_depth_along(
        self, rays: NDArray[np.float64], sampling: Sampling = "center"
    ) -> NDArray[np.float32]:
        """Return the inverse depth, 1/m, of the ground-truth pixels nearest to rays (..., 3)."""
        height, width = self.inverse_depth.shape
        highest = 180.0 * height / width
        grid = SphereGrid(width, height, (-highest, highest), sampling=sampling)
        found, inside = grid.look_up(self.inverse_depth, rays)
        return np.where(inside, found, np.float32(np.nan))


def to_gray(image: NDArray[Any]) -> NDArray[np.float32]:
    """Return an image (height, width) or RGB (height, width, 3) in gray, float32 (BT.601 luma)."""
    import cv2

    if image.ndim == 2:
        return np.ascontiguousarray(image, np.float32)
    gray, rows = np.empty(image.shape[:2], np.float32), 32
    # Some rows at a time, whose colours stay in the cache: half the time of all at once.
    for y in range(0, len(image), rows):
        part = np.ascontiguousarray(image[y : y + rows], np.float32)
        cv2.cvtColor(part, cv2.COLOR_RGB2GRAY, gray[y : y + rows])
    return gray


def _blocks_averaged(image: NDArray[Any], factor: int) -> NDArray[Any]:
    import cv2

    height, width = (side // factor for side in image.shape[:2])
    cut = image[: height * factor, : width * factor]
    return cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA)


def check_images(images: Sequence[ArrayLike], rig: Rig) -> list[NDArray[Any]]:
    """Return the images as arrays, checked against the cameras of the rig, as `Frame.of` does."""
    if not isinstance(images, Sized):  # arrays and tensors are sequences, too
        raise OmnistereoError(f"images is {shortened(images)}; expected one array per camera")
    arrays = [as_array(image, f"image {i}", None) for i, image in enumerate(images, 1)]
    sizes = rig.image_sizes(len(arrays))
    for i, (image, (width, height)) in enumerate(zip(arrays, sizes, strict=True)):
        if image.shape not in [(height, width), (height, width, 3)]:
            raise OmnistereoError(
                f"image {i + 1} has shape {image.shape}; camera {i + 1} expects ({height}, {width})"
                f" or ({height}, {width}, 3). Pass the image as captured: not resized, cropped or"
                " rotated."
            )
        if image.dtype != np.uint8 and not np.issubdtype(image.dtype, np.floating):
            raise OmnistereoError(f"image {i + 1} has type {image.dtype}; expected uint8 or float")
        if image.dtype != np.uint8:
            arrays[i] = _within_range(image, f"image {i + 1}")
    # Gray and colour images together are all in colour.
    if len({image.ndim for image in arrays}) > 1:
        arrays = [one if one.ndim == 3 else np.repeat(one[..., None], 3, -1) for one in arrays]
    return arrays


def _within_range(image: NDArray[Any], name: str) -> NDArray[np.float32]:
    """Return a float image in float32, no pixel of which is far from all others; see `Frame.of`."""
    with np.errstate(over="ignore"):
        single = np.asarray(image, np.float32)
    if not np.isfinite(single).all():
        raise OmnistereoError(
            f"{name} has NaN or infinite values, or too large for float32; expected finite grey "
            "values"
        )
    # The range without the most extreme pixels, whose three colours may all be.
    values = single[::2, ::2].ravel()
    few = min(max(3, int(_FEW * len(values))), (len(values) - 1) // 2)
    low, high = np.partition(values, (few, -1 - few))[[few, -1 - few]]
    span = _SPANS * (high - low)
    if span == 0 or (single.min() >= low - span and single.max() <= high + span):
        return single
    return single.clip(low - span, high + span)


def load_images(paths: Sequence[str | Path], rig: Rig | None = None) -> list[NDArray[np.uint8]]:
    """Read one image for each camera, in the order of the rig; see `read_image`.

    With a rig, number and sizes of the images are compared with its cameras before anything is
    decoded. One image for a rig holds all its cameras, see `consumer_images.split_image`.

    >>> images = osl.load_images([f"data_samples/sunny/test/cam{k}/0706.jpg" for k in (1, 2, 3, 4)])
    >>> images[0].shape, images[0].dtype
    ((768, 800, 3), dtype('uint8'))
    """
    check_type(paths, Sized, "paths")
    for path in paths:
        check_not_stitched(as_path(path, "paths"))
    if rig is not None and len(paths) == 1:
        return split_image(read_image(paths[0]), rig, paths[0])
    sizes = [None] * len(paths) if rig is None else rig.image_sizes(len(paths))
    return [read_image(path, size) for path, size in zip(paths, sizes, strict=True)]


def read_inverse_depth(path: str | Path, min_depth: float | None = None) -> NDArray[np.float32]:
    """Read a ground-truth panorama of inverse depth, 1/m, (H, W); 0 is infinitely far, NaN unknown.

    Float TIFF holds inverse depth as it is; in files of the current releases a thumbnail page
    precedes it. 16-bit PNG of the first release holds it in steps of 1/(65500 min_depth). Anything
    else raises an `OmnistereoError`.
    """
    path = Path(path)
    is_png = path.suffix.lower() == ".png"
    values = _read_png16(path, min_depth) if is_png else _read_float_tiff(path)
    with np.errstate(over="ignore"):
        values = values.astype(np.float32)
    return np.where(np.isfinite(values) & (values >= 0), values, np.float32(np.nan))


# The tag GDAL_NODATA, as text: programs that know it leave NaN out of masks and statistics.
_NODATA = (42113, 2, 0, "nan", True)


def write_inverse_depth(path: str | Path, inverse_depth: NDArray[Any]) -> None:
    """Write a panorama of inverse depth, 1/m, as a deflated float32 TIFF with a checksum inside.

    The checksum stands in the description (tag 270), which other programs show or ignore: decoders
    do not notice a hole of zeros in a deflated file.
    """
    import tifffile

    values = np.asarray(inverse_depth, np.float32)
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            values,
            compression="deflate",
            description=json.dumps({_CHECKSUM: _sum_of(values)}),
            software=_SOFTWARE,
            metadata=None,
            extratags=[_NODATA],
        )


def _sum_of(values: NDArray[Any]) -> str:
    """Return the checksum of a panorama, size and values, in any byte order of the machine."""
    return checksum(repr(values.shape).encode() + values.astype("<f4").tobytes())


def _read_float_tiff(path: Path) -> NDArray[Any]:
    from PIL.ExifTags import Base

    content, picture = open_picture(path)
    floats = []
    try:
        for page in range(pages_of(path, picture)):
            picture.seek(page)
            if picture.mode == "F" and picture.width * picture.height <= MAX_PIXELS:
                floats.append(page)
        if len(floats) == 1:
            picture.seek(floats[0])
            decoded = decode_tiff(content, floats[0])
            values = np.array(picture) if decoded is None else decoded
            tags = Base.ImageDescription, Base.Software
            about, software = (str(picture.tag_v2.get(tag, "")) for tag in tags)
    except Exception as error:  # of many types
        raise OmnistereoError(
            f"{path} is not a complete TIFF file ({error}). Copy it again."
        ) from None
    if len(floats) != 1:
        raise OmnistereoError(
            f"{path} has {len(floats)} float pages; expected one, of inverse depth in 1/m"
        )
    # Ours: it says so, or has lost what it said.
    told = about.split("\0")[0]
    lost = len(told) < len(about) and f'{{"{_CHECKSUM}'.startswith(told)
    is_ours = _CHECKSUM in about or software == _SOFTWARE or lost
    if is_ours and about != json.dumps({_CHECKSUM: _sum_of(values)}):
        raise OmnistereoError(
            f"{path} has changed since it was written (checksum). Copy it, or compute it again."
        )
    return values


def _read_png16(path: Path, min_depth: float | None) -> NDArray[np.float64]:
    steps = read_pixels(path)
    if steps.ndim != 2 or steps.dtype != np.uint16:
        found = f"{steps.dtype} of shape {steps.shape}"
        raise OmnistereoError(f"{path} holds {found}; expected 16-bit grey steps of inverse depth")
    if min_depth is None:
        raise OmnistereoError(
            f"{path} is in units of 1/min_depth. State the nearest depth in the rig file."
        )
    return steps / (65500.0 * min_depth)
