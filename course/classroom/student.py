"""A student's notebook in a process of its own, with limits: what its functions answer comes back,
and nothing else.

`run` starts `python -m course.classroom.student` in a copy of the clone. That process runs the
cells by IPython, as Jupyter does, and after each cell tries the functions that are new on the
inputs of their exercises. What it writes is JSON, a line each, into a file that is read when all
its processes have ended; so nobody waits for it. Nothing in there is believed: `handin` compares
the answers with the right ones.

This keeps mistakes from doing harm, not malice: the code runs as the user who starts it. For
strangers' notebooks the whole check belongs into a container; book/teaching.md says how.
"""

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, NamedTuple

import numpy as np
import psutil

from course.exercises.compare import CASES, where
from course.exercises.opened import Open
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Pose

ROOT = Path(__file__).resolve().parents[2]
COPIED = (
    "notebooks",
    "data_samples",
    "omnistereo_lib",
    "omnistereo_rigs",
    "omnistereo_learn",
    "omnistereo_tools",
    "course",
    "workshop",
    "environment.txt",
)
# of the environment
KEPT = ("PATH", "LANG", "LC_ALL", "VIRTUAL_ENV", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
GIB = 2**30
MAX_PROCESSES = 256
MAX_FILE_BYTES = 4 * GIB  # of each file that it writes
MAX_ANSWER_BYTES = 4 * 2**20  # as JSON
MAX_READ_BYTES = 64 * 2**20
PR_SET_CHILD_SUBREAPER = 36  # <sys/prctl.h>


# --- The judge's side


@dataclass
class Run:
    """What came back from a notebook."""

    records: list[dict[str, Any]]  #: as written by `main`; not to be believed
    stopped: str  #: why it did not come to its end, or nothing
    seconds: float
    peak_gib: float  #: memory of all its processes, and of its files in /dev/shm
    left_mib: float = 0.0  #: of files outside its copy that it has left, and that were removed


def run(task: dict[str, Any], seconds: float, memory_gib: float) -> Run:
    """Run a notebook in a process of its own, and end all that it has started.

    Args:
        task: For `main`: the cells, the exercises, the seed of their cases and the limits of time.
        seconds: The time that it may take in all.
        memory_gib: The memory that all its processes may use together.
    """
    started = time.monotonic()
    with (
        TemporaryDirectory(prefix="student-", ignore_cleanup_errors=True) as folder,
        TemporaryFile() as answers,
    ):
        copy, told = Path(folder, "clone"), Path(folder, "task.json")
        copy_clone(copy)
        told.write_text(json.dumps(task), encoding="ascii")
        own = private(Path(folder))
        command = [*own, sys.executable, "-m", "course.classroom.student"]
        with told.open("rb") as task_file:
            files, where = (task_file, answers), copy / "notebooks"
            ran = limited(
                command, Path(folder), where, seconds, memory_gib, files, PYTHONPATH=str(copy)
            )
        answers.seek(0)
        records = list(read_records(answers.read(MAX_READ_BYTES)))
    if not (broken := ran.broken) and not any("end" in record for record in records):
        broken = f"its process ended with status {ran.status}"
    return Run(records, broken, time.monotonic() - started, ran.peak_gib, ran.left_mib)


class Limited(NamedTuple):
    """How a command with limits has ended."""

    broken: str  #: the limit that it has broken, or nothing
    status: int
    peak_gib: float
    left_mib: float


def limited(
    command: list[str],
    folder: Path,
    cwd: Path,
    seconds: float,
    memory_gib: float,
    files: tuple[Any, Any] = (subprocess.DEVNULL, subprocess.DEVNULL),
    **variables: str,
) -> Limited:
    """Run a command with an empty home and an empty folder for temporary files, and end all that it
    has started.

    Args:
        folder: Where these two are made; all in it is gone afterwards.
        cwd: The folder in which it runs.
        files: stdin and stdout.
        variables: Further ones of its environment.
    """
    # a process that detaches itself becomes this one's child, so that it is found
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    others = set(psutil.Process().children(recursive=True))

    def family() -> list[psutil.Process]:
        return [each for each in psutil.Process().children(recursive=True) if each not in others]

    home, temporary = folder / "home", folder / "tmp"
    home.mkdir()
    temporary.mkdir(exist_ok=True)
    env = {name: os.environ[name] for name in KEPT if name in os.environ}
    env |= {
        "HOME": str(home),
        "TMPDIR": str(temporary),
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLBACKEND": "agg",
    }
    process = subprocess.Popen(
        command,
        stdin=files[0],
        stdout=files[1],
        stderr=subprocess.DEVNULL,
        cwd=cwd,
        env=env | variables,
        start_new_session=True,
    )
    try:
        broken, peak_gib = watch(process, family, seconds, memory_gib)
    finally:
        end(process, family)
        left_mib = sum(map(bytes_in, (temporary, home))) / 2**20
        # Python's own way fails a thousand folders deep
        for remove in (["chmod", "-R", "u+rwx"], ["rm", "-rf"]):
            subprocess.run([*remove, "--", str(folder)], stderr=subprocess.DEVNULL, check=False)
    return Limited(broken, process.returncode, peak_gib, left_mib)


_PRIVATE = """\
mount -t tmpfs tmpfs /dev/shm || exit 125
if [ "$2" ]; then
    mkdir -p "$2" && mount --bind "$1" "$2" && mount --rbind "$1/tmp" /tmp || exit 125
fi
shift 2
exec unshare --user --map-root-user --mount "$@"
"""


def private(folder: Path) -> list[str]:
    """Return the command that gives another one a /tmp and a /dev/shm of its own, the former in
    `folder`/tmp; nothing where the system does not let its users do so.

    A Python that itself lies in /tmp would be hidden: it keeps that of all.
    """
    if shutil.which("unshare") is None:
        return []
    inside: Path | str = ""
    if not any(Path(prefix).is_relative_to("/tmp") for prefix in (sys.prefix, sys.base_prefix)):
        within = folder.relative_to("/tmp") if folder.is_relative_to("/tmp") else Path()
        inside = folder / "tmp" / within / ("" if within.parts else ".clone")
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", _PRIVATE, "sh"]
    command += [str(folder), str(inside)]
    tried = subprocess.run([*command, "true"], capture_output=True, check=False)
    return command if tried.returncode == 0 else []


def bytes_in(folder: Path) -> int:
    """Return how many bytes the files in a folder take, as far as it can be read."""
    total, folders = 0, [str(folder)]
    # `os.walk` of Python 3.11 fails a thousand folders deep.
    while folders:
        with suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
                else:
                    total += entry.stat(follow_symlinks=False).st_size
    return total


def bytes_shared(process: subprocess.Popen[Any]) -> int:
    """Return the bytes of the files in the /dev/shm of a process that has its own."""
    with suppress(OSError):
        own = os.stat(f"/proc/{process.pid}/root/dev/shm")
        if own.st_dev != os.stat("/dev/shm").st_dev:
            status = os.statvfs(f"/proc/{process.pid}/root/dev/shm")
            return (status.f_blocks - status.f_bfree) * status.f_frsize
    return 0  # it has ended, or shares that of all


def copy_clone(copy: Path) -> None:
    """Copy what a notebook needs of the clone: no solutions, hidden files, links, pipes."""

    def left_out(folder: str, names: list[str]) -> list[str]:
        paths = {name: Path(folder, name) for name in names}
        plain = {
            name
            for name, path in paths.items()
            if not path.is_symlink() and (path.is_file() or path.is_dir())
        }
        return [*set(names) - plain, *shutil.ignore_patterns(".*", "solutions*")(folder, names)]

    for path in map(ROOT.joinpath, COPIED):
        if path.is_dir():
            shutil.copytree(path, copy / path.name, ignore=left_out)
        else:
            shutil.copy2(path, copy)


def watch(
    process: subprocess.Popen[Any],
    family: Callable[[], list[psutil.Process]],
    seconds: float,
    memory_gib: float,
) -> tuple[str, float]:
    """Wait for a process; return the limit that its family broke, or "", and the peak in GiB."""
    deadline, peak = time.monotonic() + seconds, 0.0
    while process.poll() is None:
        members = family()
        if len(members) > MAX_PROCESSES:
            return f"it ran more than {MAX_PROCESSES} processes", peak
        in_files = bytes_shared(process) / GIB
        used = in_files + sum(map(memory_of, members)) / GIB
        # perhaps only because what they share counts for each of them
        if used > memory_gib and len(members) > 1:
            used = in_files + sum(memory_of(member, shared=True) for member in members) / GIB
        peak = max(peak, used)
        if peak > memory_gib:
            return f"it used more than {memory_gib:g} GiB of memory", peak
        if time.monotonic() > deadline:
            return f"it ran longer than {seconds:g} s", peak
        time.sleep(0.05)
    return "", peak


def memory_of(process: psutil.Process, shared: bool = False) -> int:
    """Return the bytes that a process uses; `shared`: with its part of what it shares; slow."""
    with suppress(psutil.Error):
        memory = process.memory_full_info() if shared else process.memory_info()
        return getattr(memory, "pss", memory.rss)
    return 0  # it has ended


def end(process: subprocess.Popen[Any], family: Callable[[], list[psutil.Process]]) -> None:
    """Kill a process and its family until nobody is left."""
    if process.poll() is None:
        with suppress(ProcessLookupError, PermissionError):  # it has just ended
            # all at once: they may start others faster than one can look
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    for _ in range(100):
        if not (members := family()):
            return
        # nobody starts another one in between
        for kill in (psutil.Process.suspend, psutil.Process.kill):
            for member in members:
                with suppress(psutil.Error):
                    kill(member)
        psutil.wait_procs(members, timeout=1)
    raise OmnistereoError(
        f"processes that it started cannot be ended: {[member.pid for member in members]}. End them"
    )


def read_records(content: bytes) -> Iterator[dict[str, Any]]:
    """Yield the records among some lines, whatever the others are."""
    for line in content.splitlines():
        with suppress(Exception):  # cut short, nested too deeply, not of ours
            if isinstance(record := json.loads(line), dict):
                yield record


# --- The student's side


class OutOfTime(BaseException):
    """Raised where a cell or function has taken too long; `except Exception` does not catch it."""


def main() -> None:
    """Run a task from stdin; write to stdout what cells raise and what functions answer."""
    import resource  # not on Windows, where the judge may be imported

    from IPython.core.interactiveshell import InteractiveShell
    from traitlets.config import Config

    task = json.load(sys.stdin)
    records = os.fdopen(os.dup(1), "w", encoding="ascii")
    # what it prints goes nowhere: it may print without end
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.path[:] = [one for one in sys.path if Path(one) == ROOT or not Path(one, "course").is_dir()]
    with suppress(ValueError):  # the limit is lower already
        resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_FILE_BYTES, MAX_FILE_BYTES))
    shell = InteractiveShell.instance(config=Config(HistoryManager={"enabled": False}))
    # The tee would keep all that a cell prints.
    shell._tee = lambda channel: nullcontext()  # type: ignore[assignment, method-assign, return-value]
    shell.showtraceback = shell.showsyntaxerror = lambda *_, **__: None  # type: ignore[assignment, method-assign]
    opened = {
        name: resolve_name(f"course.exercises.{checker}")
        for name, checker in task["exercises"].items()
    }
    tried: dict[str, Any] = {}
    handed: dict[str, Any] = {}  # to a check, which may put the solution in its place
    check = Open.__call__

    def check_and_keep(self: Open, function: Any) -> Any:
        handed[self.name] = function
        return check(self, function)

    Open.__call__ = check_and_keep  # type: ignore[method-assign]

    def write(**record: Any) -> None:
        print(json.dumps(record), file=records, flush=True)

    write(begin=True)
    for number, source in enumerate(task["cells"], start=1):
        write(cell=number, said=run_cell(shell, source, task["cell_s"]))
        for name, open_function in opened.items():
            function = handed.pop(name, shell.user_ns.get(name))
            if callable(function) and function is not tried.get(name) and not from_course(function):
                tried[name] = function  # now: a later cell may never end, or write over it
                write(
                    function=name,
                    replies=replies(function, open_function, task["seed"], task["answer_s"]),
                )
    threads = [one.name for one in threading.enumerate() if one is not threading.main_thread()]
    write(end=True, threads=", ".join(threads))
    os._exit(0)  # without threads and functions of `atexit` that a cell has left


def from_course(function: Callable[..., Any]) -> bool:
    """Tell whether a function is the course's own, such as a solution."""
    return str(getattr(function, "__module__", "")).partition(".")[0] == "course"


def run_cell(shell: Any, source: str, seconds: float) -> str:
    """Run a cell; return what it stopped with, or nothing."""
    try:
        with at_most(seconds):
            result = shell.run_cell(source, silent=True)
        error = (
            result.error_in_exec if result.error_before_exec is None else result.error_before_exec
        )
    # what IPython does not catch: a syntax tree too deep, a timer that comes late
    except BaseException as raised:
        error = raised
    return "" if error is None else ": ".join(described(error))


def replies(
    function: Callable[..., Any], open_function: Open, seed: int, seconds: float
) -> list[dict[str, Any]]:
    """Return what a function answers to each case of its checker, until it raises something."""
    found: list[dict[str, Any]] = []
    for k in range(CASES):
        try:
            inputs = open_function.inputs(k, seed)
            with at_most(seconds):
                answer = function(*inputs)
                value = in_json(answer)
                arguments = [in_json(value) for value in inputs]  # it may have written into them
            if len(value) > MAX_ANSWER_BYTES:
                raise MemoryError(f"an answer of more than {MAX_ANSWER_BYTES // 2**20} MiB")
        except BaseException as error:
            kind, text = described(error)
            return [*found, {"error": kind, "text": text + where(error)}]
        differentiable = getattr(answer, "requires_grad", False) is True
        found.append({"value": value, "arguments": arguments, "differentiable": differentiable})
    return found


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `OutOfTime` where the code within takes longer."""

    def stop(*_: Any) -> None:
        raise OutOfTime(f"no answer in {seconds:g} s")

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def described(error: BaseException) -> tuple[str, str]:
    """Return an exception's name and text."""
    try:
        return type(error).__name__, str(error)[:500]
    except BaseException:  # of its own making
        return type(error).__name__, ""


def in_json(value: Any) -> str:
    """Return a value in JSON: numbers of an array or a pose, else the name of its type."""
    try:
        return json.dumps(value, default=plain)
    except Exception:  # a list in itself, an object's own error
        return json.dumps({"type": type(value).__name__})


def plain(value: Any) -> Any:
    """Return what `json` is to write in place of a value that it does not know."""
    if value is ...:
        return None
    if isinstance(value, Pose):
        return value.as_vector().tolist()
    value = value.detach() if hasattr(value, "detach") else value
    if hasattr(value, "__array__"):
        return np.asarray(value).tolist()
    return {"type": type(value).__name__}


if __name__ == "__main__":
    main()
