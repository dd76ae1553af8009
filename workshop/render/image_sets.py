"""The image sets: frames of a world in a light, each rendered whole or not at all."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import make_folder, write_text
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.trajectory import trajectory_tum
from omnistereo_lib.pictures import is_whole
from workshop.render.camera.render_rig import RenderRig, make_rig, write_config
from workshop.render.city.drive import plan_drive
from workshop.render.city.layout import plan_district

SEED = 2019
# of the first public release's 16-bit ground truth: inverse depth in units of 1 / (65500 D_min)
_STEPS = 65500
# Differences of neighbours, of floats byte by byte (tag Predictor), in one strip: half the file.
_DELTAS = {"compression": "tiff_adobe_deflate", "tiffinfo": {317: 3}, "strip_size": 1 << 24}


@dataclass(frozen=True)
class ImageSet:
    """Frames of one world in one light.

    Attributes:
        route: Streets of the same city; no street is in both. A room has none.
        first, count: Numbers of the frames. Of a drive as the published sets count them: 1 to 700
        and 701 to 1000.
        shipped: The frames that are rendered unless others are asked for.
        size: Width and height of the images.
        samples: Paths for each pixel; the denoiser takes away most of the noise that few of them
            leave.
        truths: Width and height of the ground-truth panoramas; pixels are square: 640 × 160 is φ
            from -45° to 45°, 640 × 320 the full sphere.
        truth_suffix: Of the two public encodings: float, or a third as large in 16-bit steps, to
            0.01 of 192 spheres.
        truth_of: The set of the same drive whose ground truth is also this one's: light moves
            nothing.
        quality: Of the JPEG files: what is lost is less than the sensors' noise.
        kept: Of PNG ground truth only every step `kept` is used: 4 are within 0.01 of 192 spheres,
            32 within 0.05.
        rig: See `make_rig`.
        T_drive_rig: Rotation vector (radians) and position (metres, x right, y down, z forward) of
            the rig on the
            drive: zero on the roof of the van.
    """

    light: str
    route: str
    first: int
    count: int
    shipped: tuple[int, ...]
    size: tuple[int, int]
    gray: bool
    samples: int
    truths: tuple[tuple[int, int], ...] = ()
    truth_suffix: str = ".tiff"
    truth_of: str = ""
    quality: int = 85
    kept: int = 4
    world: str = "city"
    rig: str = "van"
    T_drive_rig: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


_TEST = {
    "route": "test",
    "first": 701,
    "count": 300,
    "shipped": (706, 731, 781, 831, 881, 906, 931, 981),
    "size": (800, 768),
    "gray": False,
    "samples": 16,
}

SETS = {
    "sunny/test": ImageSet(
        light="sunny", **_TEST | {"samples": 32}, truths=((640, 160), (1200, 300))
    ),
    # The frame that travels with the package, omnistereo_lib/sample.
    "sample": ImageSet(
        light="sunny",
        **_TEST | {"shipped": (831,), "size": (1600, 1536), "samples": 12},
        truths=((640, 160),),
        quality=72,
    ),
    "cloudy/test": ImageSet(light="cloudy", **_TEST, truth_of="sunny/test"),
    "sunset/test": ImageSet(light="sunset", **_TEST, truth_of="sunny/test"),
    "sunny/train": ImageSet(
        light="sunny",
        route="train",
        first=1,
        count=700,
        shipped=tuple(range(3, 701, 5))[:120],
        size=(400, 384),
        gray=True,
        samples=12,
        truths=((640, 160),),
        truth_suffix=".png",
        quality=80,
    ),
    # Frames in a row, with cars ahead of the van, behind it and towards it.
    "drive/test": ImageSet(
        light="sunny",
        **_TEST | {"shipped": tuple(range(723, 739)), "size": (400, 384), "samples": 12},
        truths=((640, 160),),
        truth_suffix=".png",
        quality=64,
        kept=32,
    ),
    # A drone that follows the van, nose down and banking: 15° in all.
    "aerial/test": ImageSet(
        light="sunny",
        **_TEST | {"shipped": (756, 871)},
        truths=((640, 320), (1200, 600)),
        truth_suffix=".png",
        T_drive_rig=(-0.2, 0.0, 0.17, 0.0, -15.0, 0.0),
    ),
    "indoor/test": ImageSet(
        light="cloudy",
        route="",
        first=1,
        count=2,
        shipped=(1, 2),
        size=(800, 768),
        gray=False,
        samples=16,
        truths=((640, 160), (1200, 300)),
        world="room",
        rig="handheld",
    ),
}


def image_path(folder: Path, number: int, camera: int) -> Path:
    """Return where the picture of a camera, counted from 1, lies."""
    return folder / f"cam{camera}" / f"{number:04d}.jpg"


def frame_paths(folder: Path, images: ImageSet, number: int) -> list[Path]:
    """Return all files of a frame in the public layout: pictures, then ground truth."""
    truths = [
        folder / f"omnidepth_gt_{width}" / f"{number:05d}{images.truth_suffix}"
        for width, _ in images.truths
    ]
    return [*(image_path(folder, number, camera) for camera in (1, 2, 3, 4)), *truths]


def is_complete(folder: Path, images: ImageSet, number: int) -> bool:
    """Return whether all files of a frame are there, and whole."""
    return all(map(is_whole, frame_paths(folder, images, number)))


def select_shard(numbers: tuple[int, ...], shard: str) -> tuple[int, ...]:
    """Return shard i/n, such as "2/8": every eighth frame, starting at the second."""
    part, _, parts = shard.partition("/")
    if not (part.isdecimal() and parts.isdecimal() and 1 <= int(part) <= int(parts)):
        raise OmnistereoError(
            f"shard {shard!r} is not of the form i/n; expected 1 ≤ i ≤ n, such as 2/8"
        )
    return numbers[int(part) - 1 :: int(parts)]


def begin_set(
    folder: Path, rig: RenderRig, size: tuple[int, int], first: int, last: int, **more: str
) -> None:
    """Make the folders of the cameras and write config.yaml."""
    for camera in range(1, len(rig.cameras) + 1):
        make_folder(folder / f"cam{camera}")
    layout = {"img_fmt": "cam%d/%04d.jpg", "start": first, "step": 1, "end": last}
    write_config(folder / "config.yaml", rig, size, layout | more)


def render_set(
    folder: Path, images: ImageSet, numbers: tuple[int, ...], seed: int
) -> Iterator[int]:
    """Render the frames that are missing, one at a time; yields the number of each finished frame.

    Args:
        folder: Where the set is, or begins to be.
        numbers: Frames wanted, of those that the drive has.
        seed: Of the world, the rig, the traffic and the noise.
    """
    from workshop.render.blender import empty_scene

    missing = [number for number in numbers if not is_complete(folder, images, number)]
    rig = make_rig(seed, images.rig)
    truth = {"truth": f"../../{images.truth_of}"} if images.truth_of else {}
    begin_set(folder, rig, images.size, images.first, images.first + images.count - 1, **truth)
    if images.world == "city" and not images.truth_of:
        _write_trajectory(folder / "trajectory.txt", images, {*images.shipped, *numbers}, seed)
    if not missing:
        return
    empty_scene()
    place_rig, exposure = _WORLDS[images.world](images, seed)
    for number in missing:
        T_world_rig = place_rig(number)
        pictures, truths = _render_frame(images, rig, T_world_rig, exposure, [seed, number])
        paths = frame_paths(folder, images, number)
        write_frame(paths, pictures, images.quality, truths, rig.min_depth, images.kept)
        yield number


def true_poses(images: ImageSet, seed: int) -> Callable[[int], Pose]:
    """Return a function that gives T_world_rig of a frame of a drive."""
    drive = plan_drive(plan_district(seed), images.route, images.count)
    return lambda number: drive.pose(number - images.first) @ Pose.from_vector(images.T_drive_rig)


def _write_trajectory(path: Path, images: ImageSet, numbers: set[int], seed: int) -> None:
    """Write the true poses of frames in the axes of the first one."""
    pose = true_poses(images, seed)
    T_first_world = pose(min(numbers)).inverse()
    write_text(path, trajectory_tum({k: T_first_world @ pose(k) for k in sorted(numbers)}))


def _city(images: ImageSet, seed: int) -> tuple[Callable[[int], Pose], float]:
    """Build the city; return a function of a frame that gives T_world_rig, and the exposure."""
    from workshop.render.city.district import build_city
    from workshop.render.surfaces.lights import add_light

    _, traffic = build_city(seed)
    exposure = add_light(images.light).exposure
    pose = true_poses(images, seed)

    def place_rig(number: int) -> Pose:
        T_world_rig = pose(number)
        traffic.show(number, T_world_rig.t[:2])
        return T_world_rig

    return place_rig, exposure


def _room(images: ImageSet, seed: int) -> tuple[Callable[[int], Pose], float]:
    """Build the room; return a function that gives T_world_rig of a frame, and the exposure."""
    from workshop.render.indoor.living_room import build_room, room_pose

    return lambda number: room_pose(number - images.first), build_room(images.light, seed)


_WORLDS = {"city": _city, "room": _room}


def _render_frame(
    images: ImageSet, rig: RenderRig, T_world_rig: Pose, exposure: float, seed: list[int]
) -> tuple[list[NDArray], list[NDArray]]:
    """Return what the cameras see, and the inverse depth for each size of ground truth."""
    from workshop.render.blender import depth_panorama, fisheye_picture
    from workshop.render.camera.sensor import develop

    pictures = []
    for i, camera in enumerate(rig.cameras):
        sampler_seed = 4 * seed[1] + i
        pose = T_world_rig @ camera.T_rig_cam
        radiance = fisheye_picture(camera.lens, pose, images.size, images.samples, sampler_seed)
        noise = np.random.default_rng([*seed, i])
        pictures.append(develop(radiance, camera.lens, camera.sensor, exposure, images.gray, noise))
    return pictures, [
        1.0 / depth_panorama(T_world_rig, size, 180.0 * size[1] / size[0]) for size in images.truths
    ]


def write_frame(
    paths: list[Path],
    pictures: list[NDArray],
    quality: int,
    truths: Sequence[NDArray] = (),
    min_depth: float = 1.0,
    kept: int = 1,
) -> None:
    """Write a frame's files atomically; of PNG truths every step `kept` is used."""
    from PIL import Image

    temporaries = [path.with_name(f".{path.name}") for path in paths]
    for path, picture in zip(temporaries, pictures, strict=False):
        Image.fromarray(picture).save(path, "JPEG", quality=quality, optimize=True)
    for path, truth in zip(temporaries[len(pictures) :], truths, strict=True):
        path.parent.mkdir(exist_ok=True)
        if path.suffix == ".png":
            steps = np.rint(truth * _STEPS * min_depth).clip(0, _STEPS).astype(np.uint16)
            Image.fromarray((steps + kept // 2) // kept * kept).save(path, optimize=True)
        else:
            Image.fromarray(_rounded(truth)).save(path, "TIFF", **_DELTAS)
    for temporary, path in zip(temporaries, paths, strict=True):
        temporary.replace(path)


def _rounded(values: NDArray) -> NDArray[np.float32]:
    """Round to 15 significant bits, 3.1e-5 relative: finer than the scene, half the file."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(mantissa * 2**15) / 2**15, exponent).astype(np.float32)


def forget_partial(folder: Path, images: ImageSet, numbers: tuple[int, ...]) -> list[Path]:
    """Delete what a killed run left of some frames: temporary files, and the files of frames that
    are not complete.

    Other frames are left alone: another machine may be writing them.
    """
    written = [*folder.glob("cam*/*.jpg"), *folder.glob("omnidepth_gt_*/*.*")]
    names = [(path, path.stem.lstrip(".")) for path in written]
    left = [
        path
        for path, name in names
        if name.isdigit()
        and int(name) in numbers
        and (path.name[0] == "." or not is_complete(folder, images, int(name)))
    ]
    for path in left:
        path.unlink()
    return left


def write_manifest(root: Path, seed: int, command: str) -> None:
    """Write manifest.json: the checksum of every file below a folder, the seed and the command that
    made them. Of a folder that lies there packed, too, only the archive counts.
    """
    packed = [path.with_suffix("") for path in root.rglob("*.zip")]
    files = sorted(
        path
        for path in root.rglob("*")
        if path.is_file() and path.name != "manifest.json" and not {*packed} & {*path.parents}
    )
    names = {path.relative_to(root).as_posix(): path for path in files}
    checksums = {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in names.items()
        if "/." not in f"/{name}"
    }
    text = json.dumps({"command": command, "seed": seed, "files": checksums}, indent=1) + "\n"
    write_text(root / "manifest.json", text)


def pack(folder: Path) -> None:
    """Write a folder as NAME.zip beside it, the same bytes each time."""
    partial = folder.with_name(f".{folder.name}.zip")
    with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(folder.parent).as_posix())
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, path.read_bytes())
    partial.replace(folder.with_name(f"{folder.name}.zip"))


def renew_manifest(root: Path) -> None:
    """Update manifest.json after files beside the rendered ones have changed."""
    manifest = json.loads((root / "manifest.json").read_text(encoding="utf-8"))
    write_manifest(root, manifest["seed"], manifest["command"])
