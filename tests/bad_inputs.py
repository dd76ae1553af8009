"""Bad inputs, one row each: what is wrong, the command or call, a phrase of the answer.
`test_bad_inputs` reads them.

In a command DATA is a small data set of one frame with ground truth, RIG its config.yaml, IMAGES
the four pictures, OUT a folder that does not exist yet, BOARDS a folder of corners, LONG a name of
300 characters."""

import json
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

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

DEPTH = "depth --rig RIG --images IMAGES --grid 96x24x16 --method zncc --out OUT "
RECORDING = DEPTH.replace("depth", "record").replace(
    "IMAGES", "DATA/cam1 DATA/cam2 DATA/cam3 DATA/cam4"
)
SET = "depth --rig DATA --grid 96x24x16 --method zncc --out OUT "
LOOK = "doctor --rig RIG "
EVALUATE = "evaluate --sets DATA --methods zncc --out OUT "
TRAIN = "train sweepnet --data DATA --out OUT "
CALIBRATE = "calibrate BOARDS --square 0.06 --out OUT --board 4x3 "


class Row(NamedTuple):
    """A command that must end with one line."""

    wrong: str
    command: str
    said: str  # regular expression
    spoil: Callable[[Path], None] = lambda data: None  # makes the input bad


class Call(NamedTuple):
    """A call that must raise the library's error."""

    wrong: str
    call: Callable[[], Any]
    said: str


# ---- ways to spoil a data set


def first(data: Path, camera: int = 2) -> Path:
    return data / f"cam{camera}" / "0001.png"


def write(name: str, content: str | bytes) -> Callable[[Path], None]:
    return lambda data: (data / name).write_bytes(
        content if isinstance(content, bytes) else content.encode()
    )


def picture(pixels: np.ndarray, camera: int = 2) -> Callable[[Path], None]:
    return lambda data: write_image(first(data, camera), pixels)


def cut(data: Path) -> None:
    first(data).write_bytes(first(data).read_bytes()[:2000])


def folder_named_like_a_picture(data: Path) -> None:
    first(data).unlink()
    first(data).mkdir()


def config(change: Callable[[dict], Any]) -> Callable[[Path], None]:
    def spoil(data: Path) -> None:
        content = yaml.safe_load((data / "config.yaml").read_text())
        change(content)
        (data / "config.yaml").write_text(yaml.safe_dump(content))

    return spoil


def second(key: str, value: Any) -> Callable[[Path], None]:
    """Change a value of the second camera; None removes it."""
    return config(lambda content: content["cameras"][1].update({key: value}))


def without(key: str) -> Callable[[Path], None]:
    return config(lambda content: content["cameras"][1].pop(key))


SMALLER = np.zeros((96, 100, 3), np.uint8)


def two_pictures_swapped(data: Path) -> None:
    one, other = first(data, 1).read_bytes(), first(data, 2).read_bytes()
    first(data, 1).write_bytes(other)
    first(data, 2).write_bytes(one)


def corners(old: str, new: str) -> Callable[[Path], None]:
    """Edit the file of corners by hand."""

    def spoil(data: Path) -> None:
        board = Checkerboard((4, 3), 0.06)
        save_corners(
            data / "boards" / "corners_1.yaml", {"a": 100 * board.points[:, :2]}, board, (200, 192)
        )
        text = (data / "boards" / "corners_1.yaml").read_text()
        assert old in text
        (data / "boards" / "corners_1.yaml").write_text(text.replace(old, new, 1))

    return spoil


def two_frames(data: Path) -> None:
    for camera in (1, 2, 3, 4):
        shutil.copy(first(data, camera), data / f"cam{camera}" / "0002.png")
    shutil.copy(data / "omnidepth_gt_96" / "00001.tiff", data / "omnidepth_gt_96" / "00002.tiff")


def torn_later(data: Path) -> None:
    two_frames(data)
    last = data / "cam2" / "0002.png"
    last.write_bytes(last.read_bytes()[:-9])


# ---- commands

COMMANDS = [
    # the command itself
    Row("a misspelt command", "deph --out OUT", "there is no command 'deph'. Did you mean depth"),
    Row("no such command", "xyz", "Expected one of demo, start, board, depth, "),
    Row("no such option", DEPTH + "--no-such-option", "unrecognized arguments"),
    # pictures
    Row("a picture is missing", DEPTH, r"cam2.0001.png cannot be read: No such file", lambda d: first(d).unlink()),
    Row("a picture is truncated", DEPTH, r"cam2.0001.png is damaged, truncated or of", cut),
    Row("a picture is text", DEPTH, r"cam2.0001.png is not an image .5 bytes", write("cam2/0001.png", "hello")),
    Row("a picture is a folder", DEPTH, r"0001.png holds many frames; expected one pict.*: omnistereo record",
        folder_named_like_a_picture),
    Row("a picture is smaller", DEPTH, r"cam2.0001.png is 100 × 96 px; the camera has 200 × 192 px", picture(SMALLER)),
    Row("a picture has a long name", "depth --rig RIG --images LONG LONG LONG LONG", "File name too long"),
    Row("a picture too few", DEPTH + "--images DATA/cam1/0001.png", "is one image of 200 × 192 px for 4 cameras"),
    Row("pictures without a rig", "depth --images IMAGES --out OUT", r"--images needs --rig"),
    Row("doctor: fix and no rig", "doctor --write OUT.yaml", "--write needs --rig"),
    Row("a mask hides all", DEPTH, "mask.png hides the whole picture; expected",
        lambda d: write_image(d / "cam2" / "mask.png", np.zeros((192, 200)))),
    # panoramas
    Row("lower than the window", DEPTH + "--grid 96x4x16", r"window is 5; expected at most .* 96 × 4"),
    Row("more than the memory", DEPTH + "--grid 30000x30000x9999", "9999 spheres needs .*GiB"),
    Row("wider than OpenCV can", DEPTH + "--grid 32767x24x16", "32767.* 32766"),
    Row("a nearest depth beyond the Moon", DEPTH + "--min-depth 1e30", r"--min-depth is 1e\+30; expected a number of"),
    # methods
    Row("no such method", DEPTH + "--method magic", r"one of zncc, mccnn, sweepnet, volumenet, got 'magic'"),
    Row("no such setting", DEPTH + "--method zncc,size=5", "unknown setting 'size'; expected one of window"),
    Row("a setting twice", DEPTH + "--method zncc,pairs=all,pairs=ring", "pairs is set twice; expected once"),
    Row("a setting of another type", DEPTH + "--method zncc,window=wide", "window must be of type int, got 'wide'"),
    Row("penalties upside down", DEPTH + "--method zncc+sgm,p1=3,p2=2", r"expected 0 ≤ p1 ≤ p2, got 3.0 and 2.0"),
    Row("a setting it does not use", DEPTH + "--method zncc,p1=0.2", "zncc does not use p1. Leave it out"),
    Row("weights outside", DEPTH + "--method sweepnet,weights=../mine", "without folder and ending"),
    Row("no such device", DEPTH + "--device tpu", "--device: invalid choice: 'tpu'"),
    # data sets and outputs
    Row("no such frame", SET + "--frame 7", r"has frames 0 to 0, not 7"),
    Row("a file as data set", SET + "--rig RIG", r"config.yaml is not a data set folder"),
    Row("damaged ground truth", SET, "00001.tiff is not an image", write("omnidepth_gt_96/00001.tiff", "II*")),
    Row("out is a file", DEPTH + "--out RIG", r"config.yaml cannot be made or written to: File exists"),
    Row("out below a file", DEPTH + "--out RIG/out", r"cannot be made or written to: Not a directory"),
    Row("a mesh of another kind", DEPTH + "--mesh OUT.stl", r"out.stl has the wrong suffix; expected .glb or .ply"),
    Row("a farthest depth not a number", DEPTH + "--max-depth nan", "--max-depth is nan; expected a number of"),
    # recordings
    Row("a recording whose last picture is torn", RECORDING, r"cam2.0002.png is damaged, truncated", torn_later),
    Row("every 0th frame", RECORDING + "--frames ::0", "--frames is ::0; expected START:STOP:STEP"),
    Row("pictures as a recording", DEPTH.replace("depth", "record"), r"neither a folder nor a vid.*: omnistereo depth"),
    # rig files
    Row("a rig file of a long name", DEPTH + "--rig LONG", "File name too long"),
    Row("another format", LOOK, r"config.yaml: unknown format", write("config.yaml", "cameras: 4\n")),
    Row("no cameras", LOOK, "config.yaml: the rig has 0 cameras", write("config.yaml", "cameras: []\n")),
    Row("YAML cut off", LOOK, "config.yaml: not valid JSON or YAML", write("config.yaml", "a: [1, 2")),
    Row("a camera is a number", LOOK, "cameras 5: found 5; expected keys", config(lambda c: c["cameras"].append(5))),
    Row("a pose not a number", LOOK, r"camera 2.* finite numbers", second("pose", [float("nan"), 0, 0, 0, 0, 0])),
    Row("no polynomial", LOOK, r"camera 2: key 'poly' is missing", without("poly")),
    Row("a centre of a mapping", LOOK, r"camera 2: the centre .* must be numbers", second("center", {"row": 1})),
    Row("an image size of 400 digits", LOOK, "camera 2: the image size", second("image_size", [10**400, 3])),
    Row("a thousand coefficients", LOOK, "camera 2", second("poly", [1000, -100] + [0] * 999)),
    Row("a field of view in words", LOOK, "camera 2: max_fov must be numbers", second("max_fov", "wide")),
    Row("a field of view of 500°", LOOK, r"camera 2: max_fov is 500.0; expected", second("max_fov", 500)),
    Row("a mask that is text", LOOK, "mask.png is not an image", lambda d: (
        second("invalid_mask", "mask.png")(d), write("mask.png", "no")(d))),
    Row("a mask outside the folder", LOOK, r"camera 2: .*\.\./", second("invalid_mask", "../mask.png")),
    Row("a mask by an absolute path", LOOK, "camera 2: .*/etc/passwd", second("invalid_mask", "/etc/passwd")),
    Row("a nearest depth in words", LOOK, "config.yaml: omnimvs_sweep_min_depth must be numbers",
        config(lambda c: c.update(config={"omnimvs_sweep_min_depth": "near"}))),
    # evaluate
    Row("evaluate: no such ablation", EVALUATE + "--ablations everything", "unknown ablation 'everything'; expected"),
    # train
    Row("train: no such network", "train resnet", "invalid choice: 'resnet'"),
    Row("train: no such preset", TRAIN + "--preset tiny", "sweepnet has the presets .*, not 'tiny'"),
    Row("train: a seed of 70 bits", TRAIN + "--set seed=1180591620717411303424", "seed = 1180.*; expected .*2.31"),
    Row("train: no weights to start from", TRAIN + "--init-weights DATA/none.safetensors",
        "none.safetensors", two_frames),
    Row("train: text as weights", TRAIN + "--init-weights RIG", "config.yaml is not a complete", two_frames),
    Row("train: one frame", TRAIN, "has 1 frames with ground truth; expected at least 2"),
    # calibrate
    Row("calibrate: a board of words", CALIBRATE + "--board twelve", "expected columns x rows such as --board 12x10"),
    Row("calibrate: another board", CALIBRATE + "--board 9x6", "is of a board of 4 x 3", corners("a", "a")),
    Row("calibrate: radians", CALIBRATE + "--max-fov 3.84", r"is 3.84; .* radians \(220", corners("a", "a")),
    Row("calibrate: one view", CALIBRATE, "1 of 1 views show the board; expected at least 3", corners("a", "a")),
    Row("calibrate: no corners", CALIBRATE, "boards has no images .*expected cam1/0001.png"),
    Row("calibrate: a wild corner", CALIBRATE, r"corners_1.yaml: view a: corner .*\[-50000.0, 0.0\],? .*outside",
        corners("[0.0000, 0.0000]", "[-50000, 0]")),
    Row("calibrate: a corner of words", CALIBRATE, "corners_1.yaml: ", corners("[0.0000, 0.0000]", "[left, 0]")),
    Row("calibrate: an image of no size", CALIBRATE, r"corners_1.yaml: image_size",
        corners("[200, 192]", "[0, 0]")),
]  # fmt: skip

# ---- bombs: small files that would take gigabytes, or for ever


class Bomb(NamedTuple):
    """What is loaded, and refused within a second and a gigabyte."""

    wrong: str
    load: Callable[[Path], Any]
    said: str
    spoil: Callable[[Path], None]


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
    return write(name, struct.pack("<2sHIHHHIHHI", b"II", 42, 8, 1, 256, 3, 1, 6, 0, 8))


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


def tensors(entry: dict, length: int | None = None) -> Callable[[Path], None]:
    """A file of weights with one tensor, or with a header that says it is so long."""
    header = json.dumps({"__metadata__": {"about": "{}", "sha256": ""}, "x": entry}).encode()
    return write("weights.safetensors", struct.pack("<Q", length or len(header)) + header)


BOMBS = [
    Bomb("a picture of 30,000 × 30,000 pixels", pictures, "cam2.0001.png", large(30_000)),
    Bomb("a picture larger than the camera", images, "is too large for a picture: 13000 × 13000", large(13_000)),
    Bomb("a circle of directories", pictures, "cam2.0001.png is not an image", circular("cam2/0001.png")),
    Bomb("ground truth with such a circle", ground_truth, "1.tiff is not an image",
         circular("omnidepth_gt_96/00001.tiff")),
    Bomb("a long chunk", pictures, "cam2.0001.png is damaged, truncated", long_chunk),
    Bomb("a picture of 20,000 scans", pictures, "or of too many scans", scans),
    Bomb("weights of a long header", weights, "its header has 109", tensors({}, 1 << 40)),
    Bomb("weights of a strange type", weights, "tensors of type .'F8_E5M2'.; expected F16, BF16",
         tensors({"dtype": "F8_E5M2", "shape": [0], "data_offsets": [0, 0]})),
    Bomb("weights of a thousand dimensions", weights, "more than 8 dimensions",
         tensors({"dtype": "F32", "shape": [1] * 1000, "data_offsets": [0, 0]})),
    Bomb("weights of a large shape", weights, "not a complete safetensors",
         tensors({"dtype": "F32", "shape": [1 << 20, 1 << 20], "data_offsets": [0, 1 << 42]})),
    Bomb("ground truth of 268 million pixels", ground_truth, "is too large for a picture", large_ground_truth),
]  # fmt: skip

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


CALLS = [
    Call("one column", lambda: grid(width=1), "width is 1; expected"),
    Call("one sphere", lambda: grid(num_spheres=1), "num_spheres is 1"),
    Call("phi upside down", lambda: grid(phi_deg=(45, -45)), "phi_deg is .* first < last"),
    Call("phi beyond the pole", lambda: grid(phi_deg=(-91, 45)), "-90 ≤ first"),
    Call("no nearest depth", lambda: grid(min_depth=None), "min_depth is None .*Pass the nearest depth"),
    Call("a nearest depth of zero", lambda: grid(min_depth=0.0), "0 < min_depth < max_depth"),
    Call("no such sampling", lambda: grid(sampling="centre"), "sampling is .*; expected one of"),
    Call("poly not a number", lambda: camera(poly=[-180.0, 0, np.nan]), "poly is .*; expected .*finite"),
    Call("poly positive", lambda: camera(poly=[180.0, 0.0]), "expected a0 < 0"),
    Call("one pixel", lambda: camera(image_size=(1, 760)), "image_size is .*1"),
    Call("no field of view", lambda: camera(max_fov_deg=0.0), r"max_fov_deg is .*; expected"),
    Call("an infinite centre", lambda: camera(center=(np.inf, 1.0)), "center"),
    Call("a singular map", lambda: camera(affine=(0.0, 1.0, 0.0)), "singular"),
    Call("a mask on its side", lambda: camera(mask=np.ones((200, 192), bool)), r"mask has shape \(200, 192\)"),
    Call("a scaled rotation", lambda: osl.Pose(2 * np.eye(3), np.zeros(3)), "not a rotation"),
    Call("a mirrored rotation", lambda: osl.Pose(np.diag([1.0, 1, -1]), np.zeros(3)), "determinant -1"),
    Call("no views", lambda: calibrate_camera([], Checkerboard((4, 3), 0.06)), "there are no views"),
    Call("a translation of 1e308", lambda: osl.Pose(np.eye(3), [1e308, 0, 0]), "expected finite numbers, t below"),
    Call("a 4 × 4 rotation", lambda: osl.Pose(np.eye(4), np.zeros(3)), r"expected \(3, 3\)"),
    Call("a translation of four", lambda: osl.Pose(np.eye(3), np.zeros(4)), r"and t \(4,\); expected"),
    Call("a pose of three numbers", lambda: osl.Pose.from_vector([1, 2, 3]), r"shape \(3,\); expected 6 numbers"),
    Call("flat points", lambda: osl.Pose.identity() @ [1.0, 2.0], r"points have shape \(2,\); expected \(..., 3\)"),
    Call("poses missing", lambda: osl.Rig(RIG.cameras, RIG.T_rig_cam[:3]), "4 cameras and 3 poses"),
    Call("no such pairs", lambda: camera_pairs("star", RIG), "is 'star'"),
    Call("pairs of fractions", lambda: camera_pairs([(0.9, 1.2)], RIG), r"pairs has \(0.9, 1.2\); expected"),
    Call("a camera in orbit", lambda: osl.Rig(RIG.cameras, [osl.Pose(np.eye(3), [0, 0, 4e8])] * 4), "distance of cam"),
    Call("a camera that is not there", lambda: camera_pairs([(0, 4)], RIG), r"\(0, 4\)"),
    Call("a camera with itself", lambda: camera_pairs([(1, 1)], RIG), r"\(1, 1\)"),
    Call("no pairs", lambda: camera_pairs([], RIG), "empty"),
    Call("a board as a rod", lambda: Checkerboard((2, 9), 0.06), "two integers of 3 to 200"),
    Call("a flat volume", lambda: osl.sgm(VOLUME[0]), r"shape \(3, 4\)"),
    Call("five paths", lambda: osl.sgm(VOLUME, paths=5), "paths is 5; expected 4 or 8"),
    Call("penalties upside down", lambda: osl.sgm(VOLUME, p1=1.0, p2=0.5), "p2 = 0.5"),
    Call("an infinite cost", lambda: osl.sgm(with_infinity(np.inf)), "a cost is infinite"),
    Call("a complex volume", lambda: osl.sgm(VOLUME.astype(complex)), "the cost volume holds complex"),
    Call("depth of a flat volume", lambda: osl.winner_takes_all(VOLUME[0]), r"shape \(3, 4\) .*expected"),
    Call("an even window", lambda: osl.ZNCC(window=4), "window is 4; expected an odd number"),
    Call("three images", lambda: depth(IMAGES[:3]), "3 images for 4 cameras"),
    Call("cameras that share no view", lambda: depth(rig=narrow()), "no ray is visible to both cameras of any pair"),
    Call("an image cut", lambda: depth([IMAGES[0][:-1], *IMAGES[1:]]), r"image 1 has shape \(191, 200\)"),
    Call("an image of integers", lambda: depth([IMAGES[0].astype(int), *IMAGES[1:]]), "image 1 has type int64"),
    Call("an image not a number", lambda: depth([*IMAGES[:3], np.full((192, 200), np.nan)]), "image 4 has NaN"),
    Call("no such device", lambda: depth(device="foo"), "device is 'foo'; expected"),
    Call("a cost that is a number", lambda: osl.cost_volume(osl.SphereSweep(RIG, GRID), IMAGES, 5),
         "cost is 5; expected an object with a method `volume`"),
    Call("no such data set", lambda: osl.load_dataset("none"), "none"),
    Call("corners without a size", lambda: calibrate_camera(
        [np.zeros((12, 2))], Checkerboard((4, 3), 0.06)), "the image size is unknown"),
    Call("a confidence of a flat volume", lambda: osl.confidence(torch.zeros(3, 4)), r"shape \(3, 4\) .*expected"),
]  # fmt: skip
