"""Installs each program, runs `measure.py` in it, writes book/conventions.md, says what changed."""

import difflib
import json
import os
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import checksum, make_folder, write_text

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "book/conventions.md"
CACHE = ROOT / "out/peers"
# Name → the function of measure.py, the pinned packages, and the Python that has wheels of them;
# "ours" has torch.
PROGRAMS = {
    "pycolmap": ("pycolmap", "pycolmap==4.2.1", "3.11"),
    "opencv-4": ("opencv", "opencv-contrib-python-headless==4.14.0.94", "3.11"),
    "opencv-5": ("opencv", "opencv-contrib-python-headless==5.0.0.93", "3.11"),
    "gtsam": ("gtsam", "gtsam==4.3.0", "3.11"),
    "aria": ("aria", "projectaria-tools==2.3.0 numpy==2.4.6 --no-deps", "3.11"),
    "ds-msp": ("ds_msp", "ds-msp==0.22.2", "3.11"),
    "mrcal": (
        "mrcal",
        "setuptools==84.2.1 packaging==26.4 numpy==2.4.6; "  # what numpysane is built with
        "mrcal==2.5.2.post1 numpysane==0.45 --no-deps --no-build-isolation",
        "3.12",
    ),
    "anipose": ("anipose", "aniposelib==0.8.0", "3.11"),
    "depthai": ("depthai", "depthai==3.12.0 numpy==2.4.6", "3.11"),
    "kitti360": ("kitti360", "kitti360scripts==1.0.0 numpy==2.4.6 PyYAML==6.0.3 --no-deps", "3.11"),
    "formulas": ("formulas", "numpy==2.4.6", "3.11"),
    "plyfile": ("plyfile", "plyfile==1.1.5 numpy==2.4.6", "3.11"),
    "laspy": ("laspy", "laspy==2.7.0 lazrs==0.8.2 numpy==2.4.6", "3.11"),
    "open3d": ("open3d", "open3d==0.20.0", "3.11"),
    "meshlab": ("meshlab", "pymeshlab==2025.7.post1", "3.11"),
    "rasterio": ("rasterio", "rasterio==1.4.4", "3.11"),
    "evo": ("evo", "evo==1.38.1", "3.11"),
    "pyav": ("pyav", "av==18.1.0 numpy==2.4.6", "3.11"),
    "onnxruntime": ("onnxruntime", "onnxruntime==1.32.0 numpy==2.4.6", "3.11"),
    "openvino": ("openvino", "openvino==2026.4.1", "3.11"),
    "tract": ("tract", "tract==0.23.9 numpy==2.4.6", "3.11"),
    "py360convert": ("panoramas", "py360convert==1.0.4", "3.11"),
    "kornia": ("kornia", "kornia==0.9.0 kornia_rs==0.2.0 --no-deps", "ours"),
    "rerun": ("rerun", "rerun-sdk==0.41.0", "3.11"),
    "blender": ("blender", "bpy==5.0.1", "3.11"),
    "nerfstudio": (
        "nerfstudio",  # its reader, which needs no GPU
        "open3d==0.20.0; nerfstudio==1.1.5 jaxtyping==0.3.11 wadler_lindig==0.1.8 tyro==1.0.17 "
        "typeguard==4.6.1 docstring_parser==0.18.0 rich==15.0.0 viser==1.1.1 msgspec==0.22.0 "
        "websockets==17.4 zstandard==0.25.0 tensorboard==2.21.0 absl-py==2.5.1 --no-deps",
        "ours",
    ),
}
COLORS = [(230, 30, 20), (30, 200, 40), (250, 160, 10)]  # RGB, of the video
_HEADS = {
    "lenses": (
        "program | model | order of the parameters | pixel centres | ray at 110° → pixel | "
        "that pixel → ray | largest field"
    ),
    "poses": "program | what | direction, unit, order",
    "files": "file | program | what is compared | off by | allowed",
}
_INTRODUCTION = """\
# Conventions, measured

*Written by the module `workshop.peers`, never by hand.*
Pages of libraries say what they mean to do; this table says what they did, with the versions \
named. A lens has a focal length of 200 pixels and its centre at (320, 240) where the centre of \
the first pixel is (0, 0). An equidistant one sees a ray at 110° from its axis at u = 703.97. The \
pixel of that ray, taken back, should be 110°: where a library has no pixel of its own, the true \
one is taken back. *none* is an answer that says so, the name of an error an exception; any other \
number is an answer without a warning. The largest field is the one over which rays go to pixels \
and back to .01°, looked at every degree. Pixel centres and the order of parameters are as a \
library states them.

Not here: basalt and Kalibr, programs in C++ that no package installs (`formats/camera_models.py` \
has their formulas, tested by hand), and MATLAB itself, whose row is computed by the formula on \
its page. GLOMAP is `global_mapping` of pycolmap since COLMAP 4, with COLMAP's models and files.

"""
_PARTS = {
    "lenses": "## Lenses",
    "poses": "## Poses",
    "files": (
        "## Our files\n\nWhat these programs find in what `depth`, `world`, `record` and "
        "`calibrate` write, against what was meant."
    ),
}


def install(name: str) -> tuple[str, Path] | None:
    """Return the Python and the folder of a program's packages, installed once; None without it."""
    _, pins, version = PROGRAMS[name]
    # A shim of pyenv may be there without the version behind it.
    env = os.environ | {"PYENV_VERSION": version}
    python = sys.executable if version == "ours" else shutil.which(f"python{version}")
    if python is None or subprocess.run([python, "-V"], env=env, capture_output=True).returncode:
        return None
    site = CACHE / f"{name}-{checksum(pins.encode())[:8]}"
    env["PYTHONPATH"] = str(site)
    if not (site / "done").exists():
        shutil.rmtree(site, ignore_errors=True)
        for step in pins.split(";"):
            command = [python, "-m", "pip", "install", "--quiet", "--target", str(site)]
            done = subprocess.run([*command, *step.split()], env=env, capture_output=True)
            if done.returncode:
                raise OmnistereoError(f"{name}: {done.stderr.decode(errors='replace')[-500:]}")
        (site / "done").touch()
    return python, site


def measure(name: str, files: Path) -> dict[str, list[list[Any]]] | None:
    """Return the rows of one program; None if there is no Python for it."""
    if (found := install(name)) is None:
        return None
    python, site = found
    env = os.environ | {"PYTHONPATH": str(site), "PYENV_VERSION": PROGRAMS[name][2]}
    script = str(Path(__file__).with_name("measure.py"))
    command = [python, script, PROGRAMS[name][0], str(files)]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    if done.returncode:
        raise OmnistereoError(f"{name}: {done.stderr[-800:]}")
    rows: dict[str, list[list[Any]]] = json.loads(done.stdout.splitlines()[-1])
    return rows


def make_files(folder: Path) -> Path:
    """Write one of each kind of file, and truth.npz with what they mean; return the folder."""
    from omnistereo_lib import SphereGrid, VolumeNet, cost_volume, estimate_depth, load_dataset
    from omnistereo_lib.geometry.pose import Pose
    from omnistereo_lib.geometry.trajectory import trajectory_tum
    from omnistereo_lib.pictures import write_image
    from omnistereo_lib.stereo.sweep import SphereSweep
    from omnistereo_lib.stereo.volumenet import local_mean
    from omnistereo_rigs.formats.write import export_rig
    from omnistereo_tools.commands.options import SAMPLE
    from omnistereo_tools.onnx.onnx_export import export_onnx
    from omnistereo_tools.output.frame import FrameResult, equirectangular_depth
    from omnistereo_tools.output.mesh_export import linear, make_mesh
    from omnistereo_tools.output.points import Limits
    from omnistereo_tools.record.recordings import write_film
    from omnistereo_tools.world.page import write_surface
    from omnistereo_tools.world.surface import Surface

    folder.mkdir(parents=True, exist_ok=True)
    frame, random = load_dataset(SAMPLE)[0], np.random.default_rng(0)
    rig = frame.rig
    export_rig(rig, folder)
    for n, image in enumerate(frame.images, 1):
        # as COLMAP and as nerfstudio have it
        make_folder(folder / f"images/cam{n}")
        for name in (f"images/cam{n}/0001.png", f"cam{n}.png"):
            write_image(folder / name, image)
    grid = SphereGrid(160, 40, (-45, 45), 32, 0.6)
    depth = estimate_depth(frame, grid, method="zncc+sgm")
    export_onnx(folder, rig, grid)
    network = VolumeNet.pretrained()
    network.precision = "float32"
    volume = cost_volume(SphereSweep(rig, grid), frame.images, network)
    result = FrameResult(depth, Limits.of(depth), "zncc+sgm")
    result.write(folder)
    cloud = result._cloud
    result.export(folder / "scene.glb", folder / "whole.tiff", folder / "crops")
    result.export(folder / "scene.ply")
    cloud.write(folder / "points_z.ply", "z")
    if (laspy := install("laspy")) is not None:
        sys.path.append(str(laspy[1]))
        cloud.write_las(folder / "points.laz")
    count = 60
    places = random.normal(size=(count, 3)).astype(np.float32)
    surface = Surface(
        places,
        np.arange(count).reshape(-1, 3),
        random.integers(0, 256, (count, 3)).astype(np.float32),
    )
    write_surface(folder, surface)
    path = {n: Pose.from_vector([0, 0.1 * n, 0, 0.3 * n, 0, n]) for n in range(5)}
    write_text(folder / "trajectory.txt", trajectory_tum(path))
    times = {n: 1_700_000_000_050_000_000 + n * 10**8 for n in path}
    write_text(folder / "trajectory_seconds.txt", trajectory_tum(path, times))
    shown = np.repeat(np.array([COLORS], np.uint8)[..., ::-1], 40, 1).repeat(48, 0)
    for suffix in (".mp4", ".webm"):
        write_film(folder / f"a{suffix}", [shown] * 3, Fraction(10))
    camera, second = rig.cameras[0], rig.T_rig_cam[1].inverse() @ rig.T_rig_cam[0]
    width, height = camera.image_size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(float)
    rays, seen = camera.unproject(pixels)
    within = seen & (rays[..., 2] > np.cos(np.radians(85)))
    chosen = random.choice(np.flatnonzero(within), 200, replace=False)
    np.savez(
        folder / "truth.npz",
        pixels=pixels.reshape(-1, 2)[chosen],
        rays=rays.reshape(-1, 3)[chosen],
        mask=within,
        poses=np.array([np.column_stack([pose.R, pose.t]) for pose in rig.T_rig_cam]),
        pose2=np.column_stack([second.R, second.t]),
        depth=depth.depth,
        whole=equirectangular_depth(depth),
        near=depth.valid & (depth.depth < 65),
        inverse=depth.inverse_depth,
        points=cloud.points,
        quality=cloud.confidence,
        scene=make_mesh(depth, result.limits).vertices,
        vertices=surface.vertices,
        colors=surface.color,
        linear=linear(surface.color),
        path=np.array([pose.t for pose in path.values()]),
        colors3=np.array(COLORS),
        images=np.stack(frame.images),
        spheres=local_mean(volume)[0],
    )
    return folder


def page(rows: dict[str, list[list[Any]]]) -> str:
    """Return the page of all rows."""
    text = _INTRODUCTION
    for part, head in _HEADS.items():
        columns = head.count("|") + 1
        text += f"{_PARTS[part]}\n\n| {head} |\n{'| --- ' * columns}|\n"
        for row in rows[part]:
            words = [f"{word:.2g}" if isinstance(word, float) else str(word) for word in row]
            text += f"| {' | '.join(words)} |\n"
        text += "\n"
    return text.rstrip() + "\n"


def main(names: list[str]) -> None:
    """Measure, write the page if all were measured, and print what has changed."""
    files = make_files(CACHE / "files")
    rows: dict[str, list[list[Any]]] = {part: [] for part in _HEADS}
    missing = []
    for name in names or PROGRAMS:
        print(f"{name} …", flush=True)
        if (found := measure(name, files)) is None:
            missing.append(f"{name} needs Python {PROGRAMS[name][2]}")
            continue
        for part, more in found.items():
            rows[part] += more
    stored = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    new = page(rows)
    changed = list(difflib.unified_diff(stored.splitlines(), new.splitlines(), lineterm="", n=0))
    print("\n".join(changed[2:]) or "nothing has changed")
    if names or missing:
        print(f"{PAGE.name} is not written: {', '.join(missing) or 'not all were measured'}")
        return
    write_text(PAGE, new)


if __name__ == "__main__":
    main(sys.argv[1:])
