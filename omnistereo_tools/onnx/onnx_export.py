"""VolumeNet for a rig as one ONNX file, with a script that runs it without torch."""

import shutil
import warnings
from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate
from torch.onnx import register_custom_op_symbolic  # type: ignore[attr-defined]

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.reference import correlate
from omnistereo_lib.stereo.correlation import (
    pixels_per_degree,
    project_cells,
    volume_cells,
    volume_sizes,
)
from omnistereo_lib.stereo.kernels.correlation_numba import GROUPS
from omnistereo_lib.stereo.volumenet import VolumeNet, local_mean, normalize, resize_logits

FILES = ("depth.onnx", "run_onnx.py")
OPSET = 18  # the first whose Resize takes the axes as torch does
_SCRIPT = Path(__file__).with_name("run_onnx.py")
_COLUMNS = 32  # of a volume or the panorama at a time: temporary arrays stay small
_LUMA = 0.299, 0.587, 0.114  # of red, green and blue (BT.601)


def check_installed() -> None:
    """Raise an `OmnistereoError` if the package onnx, by which torch.onnx writes, is missing."""
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise OmnistereoError(
            "an export needs onnx: in the clone, .venv/bin/pip install -e '.[onnx]'"
        ) from None


def export_onnx(out: Path, rig: Rig, grid: SphereGrid) -> list[str]:
    """Write VolumeNet for a rig and a grid into a folder; return the names of the files.

    depth.onnx    image1 … imageK (h, w, 3) uint8, RGB → inverse_depth (H, W) float32 in 1/m,
                  0 = infinitely far, NaN = unknown, and confidence (H, W)
    run_onnx.py   reads images and runs it

    Raises:
        OmnistereoError: If the package onnx is not installed, or a file cannot be written.
    """
    check_installed()
    out = make_folder(out)
    graph = DepthGraph(VolumeNet.pretrained(), rig, grid).cpu().eval()
    images = tuple(
        torch.randint(256, (*camera.image_size[::-1], 3), dtype=torch.uint8)
        for camera in rig.cameras
    )
    for name, symbolic in _WRITTEN_OTHERWISE.items():
        register_custom_op_symbolic(f"aten::{name}", symbolic, OPSET)
    with atomic_write(out / "depth.onnx") as temporary, warnings.catch_warnings(), torch.no_grad():
        # tracing warns of sizes that become constants; they are those of rig and grid
        warnings.simplefilter("ignore")
        torch.onnx.export(
            graph,
            images,
            str(temporary),
            input_names=[f"image{k}" for k in range(1, len(rig) + 1)],
            output_names=["inverse_depth", "confidence"],
            opset_version=OPSET,
            # the coordinates of all cells would be a hundred times as large as the network
            do_constant_folding=False,
            dynamo=False,  # the newer exporter takes twenty times as long, for the same numbers
        )
    with atomic_write(out / _SCRIPT.name) as temporary:
        shutil.copyfile(_SCRIPT, temporary)
    return ["depth.onnx", _SCRIPT.name]


class DepthGraph(nn.Module):
    """`estimate_depth` by VolumeNet for one rig and grid, of operations that ONNX has."""

    def __init__(self, network: VolumeNet, rig: Rig, grid: SphereGrid) -> None:
        super().__init__()
        self.network, self.rig, self.grid = network, rig.recentered(), grid
        # Buffers: what is computed from them is part of the graph.
        for number, size in enumerate(volume_sizes(grid, rig)):
            rays, inverse_depth = volume_cells(grid, size)
            self.register_buffer(f"rays{number}", rays)
            self.register_buffer(f"inverse_depth{number}", inverse_depth)

    def forward(self, *images: Tensor) -> tuple[Tensor, Tensor]:
        """Return inverse depth, 1/m, and confidence, (H, W), NaN = unknown, of (h, w, 3) images."""
        grid, sizes = self.grid, volume_sizes(self.grid, self.rig)
        *_, correlation = correlations = [
            self._correlation(images, k, size) for k, size in enumerate(sizes)
        ]
        logits = [self.network(one[None]) / len(sizes) for one in correlations]
        read_out = []
        for columns in torch.arange(grid.width).split(_COLUMNS):
            mean = reduce(torch.add, (resize_logits(one, columns, grid)[0] for one in logits))
            read_out.append(torch.stack(local_mean(1 - mean.softmax(-1))))
        index, confidence = torch.cat(read_out, 1).transpose(1, 2)
        shared = (correlation[-1] > 0.3).any(-1).float()[None, None]  # k / 4 of two cameras is 0.5
        hidden = interpolate(shared, grid.shape[::-1], mode="nearest")[0, 0].T == 0
        far, near = 1 / grid.max_depth, 1 / grid.min_depth
        inverse_depth = far + index * ((near - far) / (grid.num_spheres - 1))
        return inverse_depth.masked_fill(hidden, torch.nan), confidence.masked_fill(
            hidden, torch.nan
        )

    def _correlation(
        self, images: Sequence[Tensor], number: int, size: tuple[int, int, int]
    ) -> Tensor:
        """Return the correlation volume (9, W, H, N) of a number and size."""
        blank = [np.zeros(camera.image_size[::-1], np.uint8) for camera in self.rig.cameras]
        rig = Frame.of(self.rig, blank).reduced(pixels_per_degree(size)).rig
        features = []
        for image, camera, reduced in zip(images, self.rig.cameras, rig.cameras, strict=True):
            gray = _reduced_gray(image, camera.image_size[0] // reduced.image_size[0])
            visible = torch.from_numpy(reduced.visible_pixels())
            features.append(self.network.features(normalize(gray, visible), visible))
        rays, inverse_depth = (
            self.get_buffer(f"rays{number}"),
            self.get_buffer(f"inverse_depth{number}"),
        )
        parts = [project_cells(rig, some, inverse_depth) for some in rays.split(_COLUMNS)]
        return torch.cat([correlate(features, part, GROUPS) for part in parts], 1)


def _reduced_gray(image: Tensor, factor: int) -> Tensor:
    """Return an image (h, w, 3) in gray, reduced, as `Frame.reduced` and `to_gray` give it."""
    blocks = avg_pool2d(image.permute(2, 0, 1).float()[None], factor)[0]
    return ((blocks + 0.5).floor() * torch.tensor(_LUMA)[:, None, None]).sum(0)


def _isfinite(g: Any, x: Any) -> Any:
    """Write the test for finite numbers without IsInf, which tract does not have."""
    return g.op("Equal", g.op("Sub", x, x), _constant(g, 0.0))


def _nan_to_num(g: Any, x: Any, *_: Any) -> Any:
    """Write NaN → 0, for pixels, which are never infinite, without IsInf."""
    return g.op("Where", g.op("IsNaN", x), _constant(g, 0.0), x)


def _constant(g: Any, value: object) -> Any:
    return g.op("Constant", value_t=torch.tensor(value))


def _double(g: Any, volume: Any, *_: Any) -> Any:
    """Write the doubling as two Resize of pictures: OpenCV 5 and tract refuse five axes."""
    batch, channels, w, h, n = volume.type().sizes()

    def resize(x: Any, shape: list[int], scales: list[float]) -> Any:
        x = g.op("Reshape", x, _constant(g, shape))
        factors = _constant(g, [1.0, 1.0, *scales])
        how = {"mode_s": "linear", "coordinate_transformation_mode_s": "half_pixel"}
        return g.op("Resize", x, _constant(g, []), factors, **how)

    x = resize(volume, [batch, channels * w, h, n], [2.0, 2.0])
    x = resize(x, [batch, channels, w, 4 * h * n], [2.0, 1.0])
    shape = [batch, channels, 2 * w, 2 * h, 2 * n]
    return g.op("Reshape", x, _constant(g, shape))


# What OpenCV 5 and tract take in another form only.
_WRITTEN_OTHERWISE: dict[str, Callable[..., Any]] = {
    "isfinite": _isfinite,
    "nan_to_num": _nan_to_num,
    "upsample_trilinear3d": _double,
}
