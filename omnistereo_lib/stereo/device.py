"""The device to compute on, and whether its memory holds a panorama."""

import math
import os
import re

import psutil
import torch
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.geometry.sphere import SphereGrid

# Spheres warped at a time: their cells fill one cache line of the (H, W, N) volume.
BLOCK = 16


def select_device(device: torch.device | str) -> torch.device:
    """Return the device to compute on; under `torchrun`, each process uses its own GPU.

    "auto" is the GPU where PyTorch finds one.

    Raises an `OmnistereoError` if PyTorch cannot use a GPU that was asked for.
    """
    if device == "auto":
        device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        device = torch.device(device)
        if device.type not in ("cpu", "cuda"):
            raise TypeError
    except (RuntimeError, TypeError):
        raise OmnistereoError(f'device is {device!r}; expected "auto", "cpu" or "cuda"') from None
    if device.type == "cuda":
        if (device.index or 0) >= (count := torch.cuda.device_count()):
            raise OmnistereoError(
                f'device is "{device}"; PyTorch finds {count or "no"} CUDA GPU. Pass device="cpu".'
            )
        device = torch.device("cuda", number_from_environment("LOCAL_RANK", device.index or 0))
        torch.cuda.set_device(device)
    return device


def takes_loops(x: Tensor) -> bool:
    """Return whether Numba's loops may compute with a tensor: on a CPU, where nothing is traced."""
    traced = torch.jit.is_tracing()  # type: ignore[attr-defined]  # torch's hints lack it
    return x.device.type == "cpu" and not traced


def number_from_environment(name: str, default: int) -> int:
    """Return a number that `torchrun` sets for each of its processes, else the default."""
    value = os.environ.get(name, str(default))
    if not re.fullmatch("[0-9]{1,6}", value):
        raise OmnistereoError(
            f"{name} in the environment is {shortened(value)}; expected a number. Unset it."
        )
    return int(value)


def check_memory(cameras: int, grid: SphereGrid, device: torch.device, volume: bool = True) -> None:
    """Refuse a panorama that needs more than three quarters of the memory: tables take the rest.

    Args:
        volume: Whether all costs are held at once. Those of `VolumeNet` never are on a CPU.

    Raises:
        OmnistereoError: With the size needed and the size available.
    """
    if device.type == "cpu":
        per_ray = bytes_of_ray(cameras, grid, volume)
    else:
        # Measured, with the costs of a block for every pair of a ring.
        per_ray = 1800 + 128 * cameras + 18 * grid.num_spheres
    need, free = grid.width * grid.height * per_ray, 0.75 * available_memory(device)
    if need > free:
        raise OmnistereoError(
            f"a panorama of {grid.width} × {grid.height} with {grid.num_spheres} spheres needs"
            f" {need / 2**30:.1f} GiB of {device} memory; {free / 2**30:.1f} GiB are available. Use"
            " fewer spheres or a smaller panorama."
        )


def bytes_of_ray(cameras: int, grid: SphereGrid, volume: bool) -> int:
    """Return the bytes for each ray at the peak on a CPU: of what is found, blended and written of
    it, the images there in colour, or while a `BlockCost` and SGM compute its volume.
    """
    if not volume:
        return 450 + 12 * cameras
    # Two volumes in float32. Each thread holds every camera's image on a block of spheres, in
    # float32, with coordinates and costs. One byte more a cell and 80 a camera were measured: what
    # the allocator leaves unused.
    threads = min(torch.get_num_threads(), math.ceil(grid.num_spheres / BLOCK))
    return 9 * grid.num_spheres + threads * (4 * BLOCK * cameras + 175) + 80 * cameras


def available_memory(device: torch.device) -> int:
    """Return the bytes that can be allocated: of the host unless the device is a CUDA GPU."""
    if device.type != "cuda":
        return int(psutil.virtual_memory().available)
    cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + cached
