"""Speed, always as a ratio against a named alternative, in one run and with the same number of threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from omnistereo_lib.sgm import _sgm_torch, sgm


@dataclass(frozen=True)
class Row:
    """One comparison: seconds of ours and of the alternative, and what else to know about it."""

    name: str
    ours_s: float
    theirs_s: float
    note: str = ""

    @property
    def ratio(self) -> float:
        """Our time in units of theirs."""
        return self.ours_s / self.theirs_s


def table(rows: Sequence[Row]) -> str:
    """Return the comparisons as aligned text."""
    width = max(len(row.name) for row in rows)
    lines = [f"{'':{width}}   ours/ms  theirs/ms  ratio"]
    for row in rows:
        lines.append(
            f"{row.name:{width}} {1e3 * row.ours_s:9.1f} {1e3 * row.theirs_s:10.1f} {row.ratio:6.2f}  {row.note}"
        )
    return "\n".join(lines)


def best_of(repeats: int, ours: Callable[[], object], theirs: Callable[[], object]) -> tuple[float, float]:
    """Return the shortest time of each, in seconds; they take turns, so that a busy moment hits both."""
    times = [(_seconds(ours), _seconds(theirs)) for _ in range(repeats + 1)]
    return tuple(min(column) for column in zip(*times[1:], strict=True))  # the first round compiles and warms up


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def bench_sgm(width: int = 1200, height: int = 300, num: int = 192, repeats: int = 5) -> list[Row]:
    """Compare `sgm` (float32, 8 paths, around the seam) with OpenCV's StereoSGBM in mode HH (16-bit, 8 paths).

    Both get the same image pair, the paper's penalties and the same number of threads (of which mode HH can use
    one only). OpenCV's time holds the single-pixel costs and the winner too, ours the aggregation alone; OpenCV
    skips the first `num` columns. The note says how often the winner is that of a float64 run.
    """
    left, right = _stereo_pair(width, height, num)
    volume = torch.stack([torch.from_numpy(np.abs(left - np.roll(right, n, axis=1))) for n in range(num)], -1)
    left, right = (cv2.convertScaleAbs(image, alpha=255) for image in (left, right))
    opencv = cv2.StereoSGBM.create(
        numDisparities=num, blockSize=1, P1=round(0.1 * 255), P2=12 * 255, mode=cv2.StereoSGBM_MODE_HH
    )
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(torch.get_num_threads())
    try:
        ours, theirs = best_of(repeats, lambda: sgm(volume), lambda: opencv.compute(left, right))
    finally:
        cv2.setNumThreads(threads_before)
    part = volume[: height // 5 + 1]  # the float64 run takes seconds even so
    winner = _sgm_torch(part.double(), 0.1, 12.0, 8, True).argmin(-1)
    same = (sgm(part).argmin(-1) == winner).double().mean().item()
    note = f"{volume.numel() / ours / 1e6:.0f} M cells/s; winner as in float64 on {same:.2%} of {winner.numel()} rays"
    return [Row(f"SGM {width}×{height}×{num}, 8 paths, against StereoSGBM HH", ours, theirs, note)]


def _stereo_pair(width: int, height: int, num: int) -> tuple[NDArray, NDArray]:
    """Return two float32 images in [0, 1], right(x) = left(x + d): smooth relief, texture, camera noise."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 1.5)
    texture = 0.5 + 0.15 * texture / texture.std()
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    disparity = num * (0.5 + 0.2 * np.sin(4 * np.pi * x / width) + 0.1 * np.cos(2 * np.pi * y / height))
    seen_at = np.float32((x + disparity) % width), np.float32(y)
    right = cv2.remap(texture, *seen_at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    noisy = [image + rng.normal(scale=0.01, size=image.shape) for image in (texture, right)]
    return tuple(np.clip(image, 0, 1).astype(np.float32) for image in noisy)


def run(quick: bool = False) -> None:
    """Print the table; quick: at teaching scale, where the figures say little, in seconds."""
    print(table(bench_sgm(320, 80, 64) if quick else bench_sgm()))
