"""VolumeNet as ONNX files for a rig, with a script that runs them without torch."""

from __future__ import annotations

import shutil
import warnings
from pathlib import Path

import numpy as np
import torch

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.correlation import feature_coordinates, pixels_per_degree, volume_sizes
from omnistereo_lib.stereo.sweep import reduce_images
from omnistereo_lib.stereo.volumenet import VolumeNet

OPSET = 18  # the first whose Resize takes the axes as torch does
_SCRIPT = Path(__file__).with_name("run_onnx.py")


def export_onnx(out: Path, rig: Rig, grid: SphereGrid, network: VolumeNet | None = None) -> list[str]:
    """Write VolumeNet for a rig and a grid into a folder; return the names of the files.

    features.onnx   image (h, w) float32 and visible (h, w) bool → features (32, ⌈h / 2⌉, ⌈w / 2⌉); any size
    volume.onnx     volume (1, 9, W, H, N) float32, sizes in multiples of 8 → logits (1, W, H, N)
    rig.npz         for each volume and camera a mask, the factor by which images are reduced, and where cells land
    run_onnx.py     the rest of the method in NumPy

    Args:
        network: Default: the bundled one.

    Raises:
        OmnistereoError: If the package onnx is not installed, or a file cannot be written.
    """
    try:
        import onnx  # noqa: F401  (torch.onnx writes by it)
    except ImportError:
        raise OmnistereoError("an export needs onnx: pip install 'omnistereo-lib[onnx]'") from None
    out = make_folder(out)
    network = (VolumeNet.pretrained() if network is None else network).cpu().eval()
    image, visible = torch.zeros(64, 64), torch.ones(64, 64, dtype=torch.bool)
    sizes = {0: "height", 1: "width"}
    _export(network.features, (image, visible), out / "features.onnx", {"image": sizes, "visible": sizes}, "features")
    volume = torch.zeros(1, 9, 16, 16, 16)
    _export(network, (volume,), out / "volume.onnx", {"volume": {2: "W", 3: "H", 4: "N"}}, "logits")
    _write_rig(out / "rig.npz", rig.recentered(), grid)
    with atomic_write(out / _SCRIPT.name) as temporary:
        shutil.copyfile(_SCRIPT, temporary)
    return ["features.onnx", "volume.onnx", "rig.npz", _SCRIPT.name]


def _export(network: torch.nn.Module, inputs: tuple, path: Path, axes: dict, output: str) -> None:
    with atomic_write(path) as temporary, warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # tracing warns of sizes that become constants; they are the channels
        # dynamo=False: the newer exporter takes twenty times as long, for the same numbers.
        torch.onnx.export(
            network, inputs, str(temporary), input_names=list(axes), output_names=[output], dynamic_axes=axes,
            opset_version=OPSET, dynamo=False,
        )  # fmt: skip


def _write_rig(path: Path, rig: Rig, grid: SphereGrid) -> None:
    """Write what of the rig and the grid the script needs."""
    blank = [np.zeros(camera.image_size[::-1], np.uint8) for camera in rig.cameras]
    arrays = {
        "size": np.array([grid.width, grid.height, grid.num_spheres]),
        "inverse_depth": np.array([1 / grid.min_depth, 1 / grid.max_depth]),
        "image_sizes": np.array([camera.image_size for camera in rig.cameras]),
    }
    sizes = volume_sizes(grid)
    for number, size in enumerate(sizes):
        reduced, _ = reduce_images(rig, blank, pixels_per_degree(size))
        for k, (camera, uv) in enumerate(zip(reduced.cameras, feature_coordinates(reduced, grid, size), strict=True)):
            name = f"{number}_{k}"
            arrays[f"mask{name}"] = camera.visible_pixels()
            arrays[f"factor{name}"] = np.array(rig.cameras[k].image_size[0] // camera.image_size[0])
            arrays[f"uv{name}"] = uv.numpy()
    arrays["volumes"] = np.array(len(sizes))
    with atomic_write(path) as temporary:
        np.savez_compressed(temporary, **arrays)
