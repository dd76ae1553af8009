"""A student's notebook in a kernel of its own: a copy of the clone to work in, limits of time and memory.

This keeps mistakes from doing harm, not malice: the code runs as the user who starts it. For strangers' notebooks
the whole check belongs into a container; book/teaching.md says how.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import DEVNULL
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

import psutil
from nbclient import NotebookClient
from nbclient.exceptions import DeadKernelError
from nbformat.v4 import new_code_cell, new_notebook

from course import kernels, nbtools, wire
from omnistereo_lib.errors import OmnistereoError

GIB = 2**30
COPIED = (
    "notebooks",
    "data_samples",
    "omnistereo_lib",
    "omnistereo_tools",
    "course",
    "render",
    "environment.txt",
    "constraints.txt",
)
LEFT_OUT = shutil.ignore_patterns(".*", "solutions*")  # the answers stay out of the copy
KEPT = ("PATH", "HOME", "LANG", "LC_ALL", "TMPDIR", "VIRTUAL_ENV", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
MAX_REPLY_BYTES = 64 * 2**20


class Stopped(BaseException):
    """The kernel has gone: it broke a limit, or it died. No `Exception`, so that no checker takes it for a finding."""


class _Client(NotebookClient):
    """A client that keeps no output but errors: a student's cell may print without end."""

    def output(self, outs: list, msg: dict, display_id: str | None, cell_index: int) -> Any:
        return super().output(outs, msg, None, cell_index) if msg["msg_type"] == "error" else None


class Student:
    """A notebook's kernel, while it runs; see `running`."""

    def __init__(self, client: NotebookClient, folder: Path, seconds: float, memory_gib: float) -> None:
        self.client, self.folder = client, folder
        self.seconds, self.memory_gib = seconds, memory_gib
        self.started, self.kernel = time.monotonic(), psutil.Process(client.km.provisioner.pid)
        self.broken = ""  # the limit that was broken, in words
        self.peak_gib = 0.0

    def run(self, source: str, seconds: float) -> str:
        """Run a cell, interrupted after so many seconds; return the error with which it stopped, or nothing.

        Raises:
            Stopped: If the kernel has gone.
        """
        cell = new_code_cell(source)
        self.client.timeout = max(1, round(seconds))
        try:
            self.client.execute_cell(cell, 0)
        except (DeadKernelError, RuntimeError) as error:
            raise Stopped(self.broken or f"the kernel died: {error}") from None
        errors = [output for output in cell.outputs if output.output_type == "error"]
        if not errors:
            return ""
        name, text = errors[0].ename, errors[0].evalue
        text = f"interrupted after {seconds:g} s" if name == "KeyboardInterrupt" else text
        return f"{name}: {text}"[:500]

    def function(self, name: str, seconds: float) -> Callable:
        """Return a function that calls the student's function of this name, in its kernel."""

        def call(*arguments: Any) -> Any:
            wire.write_call(self.folder, arguments)
            said = self.run(f"__import__('course.wire').wire.serve({name}, {str(self.folder)!r})", seconds)
            reply = self.folder / wire.REPLY
            if said.startswith("KeyboardInterrupt"):
                raise TimeoutError(f"no answer in {seconds:g} s")
            if not reply.is_file():
                raise RuntimeError(said or "no answer")
            if reply.stat().st_size > MAX_REPLY_BYTES:
                raise MemoryError(f"an answer of more than {MAX_REPLY_BYTES // 2**20} MiB")
            return wire.read_reply(self.folder, arguments)

        return call

    def has(self, name: str) -> bool:
        """Tell whether the notebook has a function of this name."""
        return not self.run(f"assert callable({name})", 10)

    def enforce_limits(self) -> None:
        """Kill the kernel and its children if they have broken a limit."""
        with suppress(psutil.NoSuchProcess):
            family = [self.kernel, *self.kernel.children(recursive=True)]
            used = sum(process.memory_info().rss for process in family) / GIB
            self.peak_gib = max(self.peak_gib, used)
            if time.monotonic() - self.started > self.seconds:
                self.broken = f"it ran longer than {self.seconds:g} s"
            elif used > self.memory_gib:
                self.broken = f"it used more than {self.memory_gib:g} GiB of memory"
            for process in family if self.broken else ():
                process.kill()

    def watch(self, over: Event) -> None:
        """Enforce the limits until the notebook is over."""
        while not over.wait(0.1):
            self.enforce_limits()


@contextmanager
def running(seconds: float, memory_gib: float) -> Iterator[Student]:
    """Start a kernel in a copy of the clone, for a notebook; end it and remove the copy afterwards.

    Args:
        seconds: The time that the kernel may take in all.
        memory_gib: The memory that it and its children may use together.
    """
    with TemporaryDirectory(prefix="student-") as folder:
        copy, calls = Path(folder, "clone"), Path(folder, "calls")
        for path in map(nbtools.ROOT.joinpath, COPIED):
            if path.is_dir():
                shutil.copytree(path, copy / path.name, ignore=LEFT_OUT)
            else:
                shutil.copy2(path, copy)
        calls.mkdir()
        client = _Client(
            new_notebook(cells=[new_code_cell()]),
            kernel_name="python3",
            kernel_manager_class=kernels.KernelManager,
            allow_errors=True,
            interrupt_on_timeout=True,
            shutdown_kernel="immediate",
        )
        env = {name: os.environ[name] for name in KEPT if name in os.environ} | {"PYTHONPATH": str(copy)}
        over = Event()
        try:
            with client.setup_kernel(cwd=str(copy / "notebooks"), env=env, stdout=DEVNULL, stderr=DEVNULL):
                student = Student(client, calls, seconds, memory_gib)
                student.enforce_limits()  # the first cell may be over before the watcher looks
                watcher = Thread(target=student.watch, args=(over,), daemon=True)
                watcher.start()
                try:
                    try:
                        student.run("__import__('course.wire')", seconds)
                    except Stopped as stopped:
                        raise OmnistereoError(f"no cell can run: {stopped}. Raise --seconds or --memory") from None
                    yield student
                finally:
                    over.set()
                    watcher.join()
        except RuntimeError as error:
            raise OmnistereoError(f"no kernel started: {error}. Run `python -m course doctor`") from None
