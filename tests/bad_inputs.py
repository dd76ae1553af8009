"""Bad inputs: ways to spoil a data set for the commands of bad_inputs.yaml, small files that would
take gigabytes, and calls. `test_bad_inputs` reads them."""

import json
import math
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scene
import tifffile
import torch
import yaml

import omnistereo_lib as osl
from omnistereo_lib.geometry.rig import camera_pairs
from omnistereo_lib.pictures import write_image
from omnistereo_rigs import Checkerboard, calibrate_camera
from omnistereo_rigs.boards.captures import save_corners

# ---- ways to spoil a data set: the keys of bad_inputs.yaml, and what `by` names there


def first(data: Path, camera: int = 2) -> Path:
    return data / f"cam{camera}" / "0001.png"


def remove(data: Path, name: str) -> None:
    (data / name).unlink()


def write(data: Path, contents: dict[str, str | bytes]) -> None:
    for name, content in contents.items():
        (data / name).write_bytes(content if isinstance(content, bytes) else content.encode())


def by(data: Path, name: str) -> None:
    globals()[name](data)


def config(data: Path, change: dict | Callable[[dict], Any]) -> None:
    content = yaml.safe_load((data / "config.yaml").read_text())
    content.update(change) if isinstance(change, dict) else change(content)
    (data / "config.yaml").write_text(yaml.safe_dump(content))


def second(data: Path, values: dict[str, Any]) -> None:
    """Change values of the second camera; None removes one."""

    def change(content: dict) -> None:
        camera = content["cameras"][1] | values
        content["cameras"][1] = {key: value for key, value in camera.items() if value is not None}

    config(data, change)


def corners(data: Path, edit: list[str]) -> None:
    """Edit a file of corners by hand: replace the first text by the second."""
    board, path = Checkerboard((4, 3), 0.06), data / "boards" / "corners_1.yaml"
    save_corners(path, {"a": 100 * board.points[:, :2]}, board, (200, 192))
    text = path.read_text()
    assert edit[0] in text
    path.write_text(text.replace(*edit, 1))


def cut(data: Path) -> None:
    first(data).write_bytes(first(data).read_bytes()[:2000])


def folder_named_like_a_picture(data: Path) -> None:
    first(data).unlink()
    first(data).mkdir()


def a_smaller_picture(data: Path) -> None:
    write_image(first(data), np.zeros((96, 100, 3), np.uint8))


def black_mask(data: Path) -> None:
    write_image(data / "cam2" / "mask.png", np.zeros((192, 200)))


def a_number_as_camera(data: Path) -> None:
    config(data, lambda content: content["cameras"].append(5))


def an_image_size_of_400_digits(data: Path) -> None:
    second(data, {"image_size": [10**400, 3]})


def a_thousand_coefficients(data: Path) -> None:
    second(data, {"poly": [1000, -100] + [0] * 999})


def two_frames(data: Path) -> None:
    for camera in (1, 2, 3, 4):
        shutil.copy(first(data, camera), data / f"cam{camera}" / "0002.png")
    shutil.copy(data / "omnidepth_gt_96" / "00001.tiff", data / "omnidepth_gt_96" / "00002.tiff")


def torn_later(data: Path) -> None:
    two_frames(data)
    last = data / "cam2" / "0002.png"
    last.write_bytes(last.read_bytes()[:-9])


# ---- bombs: small files that would take gigabytes, or for ever


def pictures(data: Path) -> list[np.ndarray]:
    return osl.load_images([first(data, camera) for camera in (1, 2, 3, 4)])


def images(data: Path) -> Any:
    return osl.load_dataset(data)[0].images


def ground_truth(data: Path) -> np.ndarray:
    return osl.load_dataset(data)[0].inverse_depth


def weights(data: Path) -> osl.MCCNN:
    return osl.MCCNN.from_file(data / "weights.safetensors")


def large(side: int) -> Callable[[Path], None]:
    """The first rows of a black PNG of many pixels in few bytes."""

    def spoil(data: Path) -> None:
        packer = zlib.compressobj(1)
        rows = [packer.compress(bytes(1 + side)) for _ in range(1000)]
        size = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
        chunks = [(b"IHDR", size), (b"IDAT", b"".join(rows) + packer.flush()), (b"IEND", b"")]
        packed = [
            struct.pack(">I", len(c)) + n + c + struct.pack(">I", zlib.crc32(n + c))
            for n, c in chunks
        ]
        first(data).write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))

    return spoil


def circular(name: str) -> Callable[[Path], None]:
    """A TIFF whose next directory is itself."""
    circle = struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, 256, 3, 1, 6, 0, 8)
    return lambda data: write(data, {name: circle})


def long_chunk(data: Path) -> None:
    """A PNG, in the length of one of whose chunks a bit is wrong."""
    content = bytearray(first(data).read_bytes())
    content[33] ^= 0x40  # of the chunk after the header
    first(data).write_bytes(content)


def scans(data: Path) -> None:
    """A progressive JPEG with the last of its scans 20,000 times."""
    noise = np.random.default_rng(0).integers(0, 255, (192, 200), np.uint8)
    content = cv2.imencode(".jpg", np.tile(noise, (10, 10)), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[
        1
    ].tobytes()
    scan = content.rindex(b"\xff\xda")
    (length,) = struct.unpack_from(">H", content, scan + 2)
    first(data).write_bytes(
        content[:-2] + 20_000 * content[scan : scan + 2 + length] + content[-2:]
    )


def large_ground_truth(data: Path) -> None:
    """A TIFF whose header states another size than it holds."""
    with tifffile.TiffFile(data / "omnidepth_gt_96" / "00001.tiff", mode="r+") as tiff:
        for tag in ("ImageWidth", "ImageLength"):
            tiff.pages[0].tags[tag].overwrite(1 << 14)


def tensors(dtype: str, shape: list[int], length: int | None = None) -> Callable[[Path], None]:
    """A file of weights with one tensor, or with a header that says it is so long."""
    size = 0 if 0 in shape else 4 * math.prod(shape)
    entry = {"dtype": dtype, "shape": shape, "data_offsets": [0, size]}
    header = json.dumps({"__metadata__": {"about": "{}", "sha256": ""}, "x": entry}).encode()
    content = struct.pack("<Q", length or len(header)) + header
    return lambda data: write(data, {"weights.safetensors": content})


# What is loaded, what is said within a second and a gigabyte, and what was done to the data.
BOMBS = {
    "a picture of 30,000 × 30,000 pixels": (pictures, "cam2.0001.png", large(30_000)),
    "a picture larger than the camera": (images, "picture: 13000 × 13000", large(13_000)),
    "a circle of directories": (pictures, "is not an image", circular("cam2/0001.png")),
    "ground truth with such a circle": (
        ground_truth,
        "1.tiff is not an image",
        circular("omnidepth_gt_96/00001.tiff"),
    ),
    "a long chunk": (pictures, "cam2.0001.png is damaged, truncated", long_chunk),
    "a picture of 20,000 scans": (pictures, "or of too many scans", scans),
    "weights of a long header": (weights, "its header has 109", tensors("F8_E5M2", [0], 1 << 40)),
    "weights of a strange type": (
        weights,
        "tensors of type .'F8_E5M2'.; expected F16, BF16",
        tensors("F8_E5M2", [0]),
    ),
    "weights of 1000 dimensions": (weights, "more than 8 dimensions", tensors("F32", [1] * 1000)),
    "weights of a large shape": (
        weights,
        "not a complete safetensors",
        tensors("F32", [1 << 21] * 2),
    ),
    "ground truth of 268 million pixels": (
        ground_truth,
        "is too large for a picture",
        large_ground_truth,
    ),
}

# ---- calls

RIG = scene.rig(width=200, height=192)
IMAGES = [np.zeros((192, 200), np.uint8)] * 4
GRID = osl.SphereGrid(96, 24, (-45, 45), 16, 0.6)
LENS = RIG.cameras[0]
VOLUME = np.zeros((2, 3, 4), np.float32)


def grid(**values: Any) -> osl.SphereGrid:
    return osl.SphereGrid(**{"width": 96, "height": 24} | values)


def camera(**values: Any) -> osl.OcamCamera:
    own = {
        name: getattr(LENS, name)
        for name in ("poly", "inv_poly", "center", "affine", "image_size", "max_fov_deg")
    }
    return osl.OcamCamera(**own | values)


def depth(images: Any = IMAGES, rig: osl.Rig = RIG, **options: Any) -> osl.Depth:
    return osl.estimate_depth(osl.Frame.of(rig, images), GRID, **{"method": "zncc"} | options)


def narrow() -> osl.Rig:
    """Four cameras of 60° that look away from each other."""
    poses = [
        osl.Pose.from_vector([0, a, 0, 0.2 * np.cos(a), 0, 0.2 * np.sin(a)])
        for a in np.arange(4) * np.pi / 2
    ]
    return osl.Rig([scene.camera(200, 192, max_fov_deg=60)] * 4, poses)


def with_infinity(value: float) -> np.ndarray:
    return np.where(np.arange(24).reshape(2, 3, 4) == 7, value, 0)


# A call, and what is said of it.
CALLS = [
    (lambda: grid(width=1), "width is 1; expected"),
    (lambda: grid(num_spheres=1), "num_spheres is 1"),
    (lambda: grid(phi_deg=(45, -45)), "phi_deg is .* first < last"),
    (lambda: grid(phi_deg=(-91, 45)), "-90 ≤ first"),
    (lambda: grid(min_depth=None), "min_depth is None .*Pass the nearest depth"),
    (lambda: grid(min_depth=0.0), "0 < min_depth < max_depth"),
    (lambda: grid(sampling="centre"), "sampling is .*; expected one of"),
    (lambda: camera(poly=[-180.0, 0, np.nan]), "poly is .*; expected .*finite"),
    (lambda: camera(poly=[180.0, 0.0]), "expected a0 < 0"),
    (lambda: camera(image_size=(1, 760)), "image_size is .*1"),
    (lambda: camera(max_fov_deg=0.0), r"max_fov_deg is .*; expected"),
    (lambda: camera(center=(np.inf, 1.0)), "center"),
    (lambda: camera(affine=(0.0, 1.0, 0.0)), "singular"),
    (lambda: camera(mask=np.ones((200, 192), bool)), r"mask has shape \(200, 192\)"),
    (lambda: osl.Pose(2 * np.eye(3), np.zeros(3)), "not a rotation"),
    (lambda: osl.Pose(np.diag([1.0, 1, -1]), np.zeros(3)), "determinant -1"),
    (lambda: calibrate_camera([], Checkerboard((4, 3), 0.06)), "there are no views"),
    (lambda: osl.Pose(np.eye(3), [1e308, 0, 0]), "expected finite numbers, t below"),
    (lambda: osl.Pose(np.eye(4), np.zeros(3)), r"expected \(3, 3\)"),
    (lambda: osl.Pose(np.eye(3), np.zeros(4)), r"and t \(4,\); expected"),
    (lambda: osl.Pose.from_vector([1, 2, 3]), r"shape \(3,\); expected 6 numbers"),
    (lambda: osl.Pose.identity() @ [1.0, 2.0], r"points have shape \(2,\); expected \(..., 3\)"),
    (lambda: osl.Rig(RIG.cameras, RIG.T_rig_cam[:3]), "4 cameras and 3 poses"),
    (lambda: camera_pairs("star", RIG), "is 'star'"),
    (lambda: camera_pairs([(0.9, 1.2)], RIG), r"pairs has \(0.9, 1.2\); expected"),
    (lambda: osl.Rig(RIG.cameras, [osl.Pose(np.eye(3), [0, 0, 4e8])] * 4), "distance of cam"),
    (lambda: camera_pairs([(0, 4)], RIG), r"\(0, 4\)"),
    (lambda: camera_pairs([(1, 1)], RIG), r"\(1, 1\)"),
    (lambda: camera_pairs([], RIG), "empty"),
    (lambda: Checkerboard((2, 9), 0.06), "two integers of 3 to 200"),
    (lambda: osl.sgm(VOLUME[0]), r"shape \(3, 4\)"),
    (lambda: osl.sgm(VOLUME, paths=5), "paths is 5; expected 4 or 8"),
    (lambda: osl.sgm(VOLUME, p1=1.0, p2=0.5), "p2 = 0.5"),
    (lambda: osl.sgm(with_infinity(np.inf)), "a cost is infinite"),
    (lambda: osl.sgm(VOLUME.astype(complex)), "the cost volume holds complex"),
    (lambda: osl.winner_takes_all(VOLUME[0]), r"shape \(3, 4\) .*expected"),
    (lambda: osl.ZNCC(window=4), "window is 4; expected an odd number"),
    (lambda: depth(IMAGES[:3]), "3 images for 4 cameras"),
    (lambda: depth(rig=narrow()), "no ray is visible to both cameras of any pair"),
    (lambda: depth([IMAGES[0][:-1], *IMAGES[1:]]), r"image 1 has shape \(191, 200\)"),
    (lambda: depth([IMAGES[0].astype(int), *IMAGES[1:]]), "image 1 has type int64"),
    (lambda: depth([*IMAGES[:3], np.full((192, 200), np.nan)]), "image 4 has NaN"),
    (lambda: depth(device="foo"), "device is 'foo'; expected"),
    (
        lambda: osl.cost_volume(osl.SphereSweep(RIG, GRID), IMAGES, 5),
        "cost is 5; expected an object with a method `volume`",
    ),
    (lambda: osl.load_dataset("none"), "none"),
    (
        lambda: calibrate_camera([np.zeros((12, 2))], Checkerboard((4, 3), 0.06)),
        "the image size is unknown",
    ),
    (lambda: osl.confidence(torch.zeros(3, 4)), r"shape \(3, 4\) .*expected"),
]
