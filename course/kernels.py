"""Run notebooks from fresh kernels: `python -m workshop run notebooks/00_quickstart.ipynb`."""

import math
import os
import shutil
import time
from pathlib import Path
from queue import Empty
from typing import Any

import nbformat
from jupyter_client.asynchronous.client import AsyncKernelClient
from jupyter_client.channels import AsyncZMQSocketChannel
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError

from course import nbtools, rules
from course.figures import stills
from omnistereo_lib.files import write_text


class _Channel(AsyncZMQSocketChannel):
    """A channel that looks again every second.

    Now and then the asynchronous poll misses a message that has arrived, and waits until its time
    limit: ten minutes for the answer to a cell, for ever for its outputs.
    """

    async def get_msg(self, timeout: float | None = None) -> dict[str, Any]:  # type: ignore[override]
        end = math.inf if timeout is None else time.monotonic() + timeout
        while True:
            try:
                return await super().get_msg(max(0.0, min(1.0, end - time.monotonic())))
            except Empty:
                if time.monotonic() >= end:
                    raise


class _Client(AsyncKernelClient):
    shell_channel_class = iopub_channel_class = _Channel


class KernelManager(AsyncKernelManager):
    """Starts kernels whose channels look again."""

    client_factory = _Client


def execute(
    nb: nbformat.NotebookNode, folder: Path, variables: dict[str, str] | None = None
) -> float:
    """Run all cells in a fresh kernel, with `folder` as its working directory; return the seconds
    it took.

    Args:
        variables: Environment variables of the kernel, in addition to those of this process.
    """
    start = time.perf_counter()
    NotebookClient(
        nb,
        timeout=600,
        kernel_name="python3",
        kernel_manager_class=KernelManager,
        resources={"metadata": {"path": str(folder)}},
        coalesce_streams=True,
        record_timing=False,
    ).execute(env=os.environ | (variables or {}))
    return time.perf_counter() - start


def run(paths: list[Path]) -> bool:
    """Run notebooks from fresh kernels, clean and store them; print what prevents it."""
    return rules.report({path: run_one(path) for path in paths})


def run_one(path: Path) -> list[str]:
    """Run, clean and store one notebook; return why it is not stored, if so."""
    nb = nbtools.read_notebook(path)
    try:
        seconds = execute(nb, path.parent)
    except (CellExecutionError, CellTimeoutError, DeadKernelError) as error:
        return [f"stopped: {error}"]
    budget = nb.metadata.get("omnistereo", {}).get("budget_s", rules.MAX_BUDGET_S)
    print(f"{path.name}: {seconds:.1f} s of {budget} s")
    if seconds > budget:
        return [f"took {seconds:.1f} s, its budget is {budget} s (metadata.omnistereo.budget_s)"]
    text = nbtools.text_of(nbtools.clean(nb))
    if not (found := rules.problems(text)):
        write_text(path, text)
    return found


def record_stills(paths: list[Path]) -> None:
    """Run notebooks and store what their live figures show, for the website and the slides."""
    for path in paths:
        nb = nbtools.read_notebook(path)
        live = [
            number
            for number, cell in enumerate(nb.cells)
            if cell.cell_type == "code" and stills.LIVE.search(cell.source)
        ]
        shutil.rmtree(stills.STILLS / path.stem, ignore_errors=True)
        if live:
            nb.cells = nb.cells[: live[-1] + 1]
            execute(nb, path.parent, {stills.VARIABLE: str(stills.STILLS / path.stem)})
