"""Depth without torch: run the exported VolumeNet by ONNX Runtime. Needs numpy, onnxruntime and opencv-python.

`omnistereo onnx` copies this file beside what it reads: features.onnx, volume.onnx and rig.npz.
example: python run_onnx.py front.png right.png back.png left.png --out inverse_depth.npy
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
import onnxruntime as ort

Array = np.ndarray
RADIUS = 2  # spheres on either side of the most probable one that the read-out takes in
COLUMNS = 16  # of the volume or the panorama at a time: temporary arrays stay small


def depth(folder: Path, images: list[Array]) -> tuple[Array, Array]:
    """Return inverse depth in 1/m, NaN = unknown, and confidence, (H, W) each, of one image per camera of the rig.

    Args:
        folder: Folder of the exported files.
        images: uint8 arrays, (height, width) gray or (height, width, 3) BGR, as cv2.imread gives them
    """
    rig = np.load(folder / "rig.npz")
    features, volume = (ort.InferenceSession(folder / name) for name in ("features.onnx", "volume.onnx"))
    logits = []
    for number in range(rig["volumes"]):  # coarse to fine: their logits are averaged
        maps, names = [], [f"{number}_{k}" for k in range(len(images))]
        for name, image in zip(names, images, strict=True):
            gray, mask = normalized(image, rig[f"mask{name}"], int(rig[f"factor{name}"]))
            maps.append(features.run(None, {"image": gray, "visible": mask})[0])
        correlation = correlate(maps, [rig[f"uv{name}"] for name in names])
        logits.append(volume.run(None, {"volume": correlation[None]})[0][0])
    index, confidence = read_out(logits, tuple(rig["size"]))
    hidden = resize_nearest((correlation[-1] <= 0.3).all(-1).T, index.shape)  # k / 4 of two cameras is 0.5
    near, far = rig["inverse_depth"]
    inverse_depth = far + index * (near - far) / (rig["size"][2] - 1)
    return np.where(hidden, np.nan, inverse_depth), np.where(hidden, np.nan, confidence)


def normalized(image: Array, mask: Array, factor: int) -> tuple[Array, Array]:
    """Return an image in gray, reduced, with zero mean and unit variance over the mask; and the mask."""
    height, width = mask.shape
    image = cv2.resize(image[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
    gray = image.astype(np.float32)
    gray = gray if gray.ndim == 2 else cv2.cvtColor(gray, cv2.COLOR_BGR2GRAY)
    values = gray[mask]
    return np.where(mask, (gray - values.mean()) / max(values.std(ddof=1), 1e-6), 0).astype(np.float32), mask


def correlate(maps: list[Array], coordinates: list[Array]) -> Array:
    """Return the mean correlation of all pairs of cameras in eight groups of channels, and k / 4: (9, W, H, N)."""
    parts = []
    for start in range(0, len(coordinates[0]), COLUMNS):
        uvs = [uv[start : start + COLUMNS] for uv in coordinates]
        warped = [sample(features, uv) for features, uv in zip(maps, uvs, strict=True)]
        k = sum(~np.isnan(uv[..., 0]) for uv in uvs).astype(np.float32)[..., None]
        products = sum(warped) ** 2 - sum(w**2 for w in warped)
        groups = products.reshape(*products.shape[:-1], 8, -1).mean(-1) / np.maximum(k * (k - 1), 1)
        parts.append(np.concatenate([groups, k / 4], -1))
    return np.ascontiguousarray(np.concatenate(parts).transpose(3, 0, 1, 2))


def sample(features: Array, uv: Array) -> Array:
    """Sample maps (C, h, w) bilinearly at pixels (..., 2): (..., C), 0 where a pixel is NaN."""
    height, width = features.shape[1:]
    table = features.transpose(1, 2, 0)
    x, y = np.nan_to_num(uv[..., 0]), np.nan_to_num(uv[..., 1])
    column, row = np.clip(np.floor(x), 0, width - 2).astype(int), np.clip(np.floor(y), 0, height - 2).astype(int)
    a, b = np.clip(x - column, 0, 1)[..., None], np.clip(y - row, 0, 1)[..., None]
    top = table[row, column] * (1 - a) + table[row, column + 1] * a
    bottom = table[row + 1, column] * (1 - a) + table[row + 1, column + 1] * a
    return np.where(np.isnan(uv[..., :1]), 0, top * (1 - b) + bottom * b).astype(np.float32)


def read_out(logits: list[Array], size: tuple[int, int, int]) -> tuple[Array, Array]:
    """Return sphere index and confidence (H, W) of logits (w, h, n) of volumes, averaged at a size (W, H, N)."""
    width, height, spheres = size
    index, confidence = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for start in range(0, width, COLUMNS):
        part = slice(start, start + COLUMNS)
        p = np.exp(sum(resized(one, size, part) for one in logits) / len(logits))
        p /= p.sum(-1, keepdims=True)
        near = p.argmax(-1)[..., None] + np.arange(-RADIUS, RADIUS + 1)
        mass = np.take_along_axis(p, near.clip(0, spheres - 1), -1) * ((near >= 0) & (near < spheres))
        index[:, part] = ((mass * near).sum(-1) / mass.sum(-1)).T
        confidence[:, part] = mass.sum(-1).T
    return index, confidence


def resized(logits: Array, size: tuple[int, int, int], columns: slice) -> Array:
    """Return columns of logits (w, h, n) at a size (W, H, N), interpolated, circular in θ."""
    left, right, weight = (x[columns] for x in positions(size[0], len(logits)))
    weight = weight[:, None, None]
    across = logits[left % len(logits)] * (1 - weight) + logits[right % len(logits)] * weight
    return between(between(across, size[1], 1), size[2], 2)


def positions(size: int, old: int) -> tuple[Array, Array, Array]:
    """Return for each of `size` samples its neighbours among `old` ones, and the weight of the second."""
    at = (np.arange(size) + 0.5) * old / size - 0.5
    left = np.floor(at).astype(int)
    return left, left + 1, (at - left).astype(np.float32)


def between(x: Array, size: int, axis: int) -> Array:
    """Resize one axis linearly; the ends are continued."""
    left, right, weight = positions(size, x.shape[axis])
    weight = weight.reshape([-1 if i == axis else 1 for i in range(x.ndim)])
    last = x.shape[axis] - 1
    return x.take(left.clip(0, last), axis) * (1 - weight) + x.take(right.clip(0, last), axis) * weight


def resize_nearest(x: Array, shape: tuple[int, int]) -> Array:
    """Resize a panorama to a shape (H, W) by repeating pixels."""
    row, column = (np.arange(new) * old // new for new, old in zip(shape, x.shape, strict=True))
    return x[row[:, None], column]


def read_images(paths: list[str], sizes: Array) -> list[Array]:
    """Return one image per camera of the rig, whose sizes (width, height) are given; exit if they do not fit."""
    if len(paths) != len(sizes):
        raise SystemExit(f"error: there are {len(paths)} images for {len(sizes)} cameras. Give one for each.")
    images = []
    for path, (width, height) in zip(paths, sizes, strict=True):
        image = cv2.imread(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if image is None:
            raise SystemExit(f"error: {path} cannot be read as an image. Check the path.")
        if image.shape[:2] != (height, width):
            found = f"{image.shape[1]} × {image.shape[0]} px; the camera has {width} × {height} px"
            raise SystemExit(f"error: {path} is {found}. Pass images as they were calibrated.")
        images.append(image)
    return images


def main() -> None:
    """Compute the depth of one frame."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="+", help="one image per camera, in the order of the rig")
    parser.add_argument("--out", default="inverse_depth.npy", help="float32, 1/m, 0 = infinitely far, NaN = unknown")
    options = parser.parse_args()
    folder = Path(__file__).parent
    images = read_images(options.images, np.load(folder / "rig.npz")["image_sizes"])
    inverse_depth, _ = depth(folder, images)
    np.save(options.out, inverse_depth.astype(np.float32))
    height, width = inverse_depth.shape
    print(f"{options.out}: {width} × {height} rays, the nearest at {1 / np.nanmax(inverse_depth):.2g} m")


if __name__ == "__main__":
    main()
