"""A matching cost: from sweep, frame and camera pairs to the volume (paper, Section III-B)."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from omnistereo_lib.errors import OmnistereoError, shortened
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Pair
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_lib.stereo.device import check_memory
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.threads import map_threads


class Volume(Protocol):
    """Costs of all rays on all spheres: a tensor, or what makes one of the rows that are read."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows, columns and spheres."""

    def __getitem__(self, rows: slice) -> Tensor:
        """Return the costs of some rows."""


class Cost(Protocol):
    """A matching cost.

    `ZNCC`, `LearnedCost`, the networks and everything derived from `BlockCost` are costs.
    """

    def volume(
        self, sweep: SphereSweep, frame: Frame, pairs: Sequence[Pair], progress: Progress = silent
    ) -> Volume:
        """Return the cost volume C(p, n) of a frame.

        Args:
            frame: Of the cameras of the sweep.
            pairs: The camera pairs to compare.
            progress: Called with parts done, parts in all and the next part; see `progress`.

        Returns:
            float32 tensor, shape (H, W, N), on the device of the sweep: Cost in [0, 1], 0 = match;
                NaN where the point is not visible to both cameras of any pair. Or a `Volume`.
        """


class BlockCost(ABC):
    """Base of a cost that compares images warped onto a block of spheres by `__call__`."""

    # whether `__call__` runs in one thread, so that each block can have one
    one_thread: ClassVar[bool] = False

    @abstractmethod
    def __call__(
        self,
        spherical_images: Tensor,
        pairs: Sequence[Pair],
        columns: Sequence[tuple[int, int]] | None = None,
    ) -> Tensor:
        """Return the mean cost over camera pairs (Eq. 2) for a block of spheres.

        Args:
            spherical_images (float32 tensor, shape (cameras, B, H, W)): Images warped onto B
                spheres, NaN where the ray is not visible to the camera.
            columns: Visible columns (start, width) of each camera, around the seam; all others may
                be skipped. Default: all columns.

        Returns:
            float32 tensor, shape (H, W, B): Cost in [0, 1], NaN where the ray is not visible to
                both cameras of any pair.
        """

    def volume(
        self, sweep: SphereSweep, frame: Frame, pairs: Sequence[Pair], progress: Progress = silent
    ) -> Tensor:
        """Return the cost volume, one block of spheres at a time; see `Cost`."""
        device = sweep.device
        sweep.keep(check_memory, lambda: check_memory(len(sweep.rig), sweep.grid, device))
        # A block of spheres per thread, if the cost runs in one, each with a buffer to warp into.
        # One (h, w) for each camera.
        normalized = sweep.normalize_images(frame)
        (H, W), on_cpu, blocks = sweep.grid.shape, device.type == "cpu", sweep.blocks()
        volume = torch.empty(H, W, sweep.grid.num_spheres, dtype=torch.float32, device=device)
        threads = min(torch.get_num_threads(), len(blocks)) if on_cpu and self.one_thread else 1
        buffers = [volume.new_empty(len(sweep.rig), H, W, len(blocks[0])) for _ in range(threads)]

        def fill(spheres: range) -> None:
            # Warp and compare.
            buffer = buffers.pop()
            # the last block may be smaller
            out = buffer if len(spheres) == buffer.shape[-1] else None
            block = sweep.warp_block(normalized, spheres, out)  # (cameras, B, H, W); Eq. 1
            columns = [sweep.visible_columns(camera, spheres) for camera in range(len(sweep.rig))]
            costs = self(block, pairs, columns)  # (H, W, B); Eq. 2
            # Check what a cost of the user's own returns, and copy it.
            target = volume[:, :, spheres.start : spheres.stop]
            shape = tuple(getattr(costs, "shape", ()))
            if shape != target.shape:
                wrong = (
                    f"{shortened(self)} gives"
                    f" {f'costs of shape {shape}' if shape else shortened(costs)}"
                )
                raise OmnistereoError(f"{wrong}; expected (H, W, spheres) = {tuple(target.shape)}")
            costs = torch.as_tensor(costs)
            # by NumPy: torch's own threads spin after each operation, and slow these
            if on_cpu:
                target.numpy()[:] = costs.detach().float().numpy()
            else:
                target.copy_(costs)
            buffers.append(buffer)

        step = counted(progress, len(blocks))
        step("sweep")
        for number, _ in enumerate((map_threads if threads > 1 else map)(fill, blocks), 1):
            step("sweep" if number < len(blocks) else "")
        return volume
