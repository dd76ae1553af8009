"""Run a notebook from a fresh kernel."""

import math
import os
import time
from pathlib import Path
from queue import Empty

import nbformat
from jupyter_client import AsyncKernelClient, AsyncKernelManager
from jupyter_client.channels import AsyncZMQSocketChannel
from nbclient import NotebookClient


class _Channel(AsyncZMQSocketChannel):
    """A channel that looks again every second.

    Now and then the asynchronous poll is not woken by a message that has arrived, and would sit beside it until
    its time limit: ten minutes for a cell's answer, for ever for its pictures.
    """

    async def get_msg(self, timeout: float | None = None) -> dict:
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


def execute(nb: nbformat.NotebookNode, folder: Path, variables: dict[str, str] | None = None) -> float:
    """Run all cells in a fresh kernel that stands in `folder`; return the seconds it took.

    Args:
        variables: Of the kernel's environment, besides this process's own.
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
