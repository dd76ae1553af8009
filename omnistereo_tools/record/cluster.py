"""Frames handed out to many machines by Dask: `--cluster ADDRESS` of a scheduler; all machines see
the same files.

A worker that dies costs its frame only: the scheduler gives the frame to another one. Results are
files, written atomically, and the same as those of a local run.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omnistereo_learn.evaluate.records import config_checksum
from omnistereo_learn.evaluate.run import Evaluation, Job
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import checksum, read_bytes
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.rig_file import load_rig
from omnistereo_lib.stereo.learned import Precision, choose_precision
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.input.sources import Pictures, Recording
from omnistereo_tools.record.recordings import PICTURES, SETTINGS, DepthWriter

if TYPE_CHECKING:
    from dask.distributed import Client

_PATIENCE_S = 30  # for the scheduler to answer
_VIDEO_BATCH = 32  # frames at a time: a worker reads a video from its start up to them


def connect(address: str) -> Client:
    """Return a client of a Dask scheduler.

    Raises an `OmnistereoError` if dask.distributed is not installed or no scheduler answers.
    """
    try:
        from dask.distributed import Client
    except ImportError:
        raise OmnistereoError(
            "--cluster needs Dask: in the clone, .venv/bin/pip install -e '.[distributed]'"
        ) from None
    try:
        logging.getLogger("distributed.client").setLevel(
            logging.CRITICAL
        )  # what it logs of errors, ours says in a line
        return Client(address, timeout=_PATIENCE_S)
    except (OSError, ValueError) as error:
        raise OmnistereoError(
            f"no Dask scheduler answers at {address}: {error}. Start one: dask scheduler"
        ) from None


def on_cluster(
    address: str, function: Callable[[Any], Any], arguments: Sequence[Any]
) -> Iterator[Any]:
    """Yield function(argument) for all arguments as workers of a Dask cluster finish them.

    Raises an `OmnistereoError` as `connect`, if a frame killed several workers, or if the scheduler
    ends; what a worker raises is raised here.
    """
    with connect(address) as client:
        from dask.distributed import KilledWorker, as_completed
        from distributed.client import FutureCancelledError
        from distributed.comm.core import CommClosedError

        if not client.scheduler_info()["workers"]:
            print(f"waiting for a worker. Start one: dask worker {address}", flush=True)
        futures = client.map(function, arguments, pure=False)
        try:
            for future in as_completed(futures):
                yield future.result()
        except KilledWorker as error:
            raise OmnistereoError(
                f"several workers died on the same frame: {error}. See their logs"
            ) from None
        except (CommClosedError, FutureCancelledError):
            raise OmnistereoError(
                f"the scheduler at {address} has ended. Start one; run the same to resume"
            ) from None
        finally:
            client.cancel(futures)


@dataclass(frozen=True)
class RecordingTask:
    """What a worker needs to continue a recording that was prepared: paths that every machine sees,
    and the grid.

    `contents` tells it from another recording in the same folder.
    """

    out: Path
    images: tuple[Path, ...]
    grid: SphereGrid
    method: Method
    with_video: bool
    device: str
    precision: Precision
    contents: str  # checksum of the rig, the settings and the marks of the pictures
    late: tuple[int, ...] = ()

    def open(self) -> DepthWriter:
        """Return the writer of the recording; its rig is that stored with the settings."""
        if _contents(self.out) != self.contents:
            raise OmnistereoError(
                f"{self.out} is not the same on all machines: its rig or settings differ. Share it."
            )
        sweep = SphereSweep(load_rig(self.out / "config.yaml"), self.grid, device=self.device)
        recording, method = Recording.open(self.images, late=self.late), self.method
        return DepthWriter(self.out, recording, sweep, method, self.with_video, self.precision)


def _contents(out: Path) -> str:
    """Return a checksum of all that tells a prepared recording from others."""
    files = sorted(path for path in out.glob("config*") if path.is_file())  # with masks
    return checksum(b"".join(map(read_bytes, [*files, out / SETTINGS, out / PICTURES])))


def depth_on_cluster(address: str, writer: DepthWriter, device: str = "cpu") -> Iterator[int]:
    """Estimate the depth of all frames that are not done yet; yield their numbers."""
    sources, grid = writer.recording.sources, writer.sweep.grid
    task = RecordingTask(
        writer.out.resolve(),
        tuple(path.resolve() for path in writer.recording.paths),
        grid,
        writer.method,
        writer.with_video,
        device,
        choose_precision(writer.precision, writer.sweep.device),
        _contents(writer.out),
        writer.recording.late,
    )
    left = writer.left()
    size = 1 if all(isinstance(source, Pictures) for source in sources) else _VIDEO_BATCH
    batches = [(task, tuple(left[k : k + size])) for k in range(0, len(left), size)]
    for numbers in on_cluster(address, _depth_of_batch, batches):
        yield from numbers


_open_once = lru_cache(2)(RecordingTask.open)  # once per worker


def _depth_of_batch(batch: tuple[RecordingTask, tuple[int, ...]]) -> tuple[int, ...]:
    task, numbers = batch
    writer = _open_once(task)
    for _ in writer.run([number for number in numbers if not writer.is_done(number)]):
        pass
    return numbers


def evaluate_on_cluster(
    address: str, arguments: dict[str, Any], jobs: Sequence[Job]
) -> Iterator[Job]:
    """Do the jobs of an `Evaluation`, given its arguments, whose paths every machine sees; yield
    each job.

    Jobs that have a result already are not done again.
    """
    absolute = {
        name: value.resolve() if isinstance(value, Path) else value
        for name, value in arguments.items()
    }
    absolute["sets"] = {name: path.resolve() for name, path in arguments["sets"].items()}
    evaluation = Evaluation(**arguments)
    contents = config_checksum(evaluation.inputs, "data", "weights")
    absolute["precision"] = evaluation.precision
    frames = [
        tuple(group) for _, group in groupby(evaluation.missing(jobs), attrgetter("data", "frame"))
    ]
    for done in on_cluster(
        address, _evaluate_frame, [(absolute, contents, frame) for frame in frames]
    ):
        yield from done


# the last one of this worker, by arguments and contents
_evaluations: dict[tuple[str, str], Evaluation] = {}


def _evaluate_frame(task: tuple[dict[str, Any], str, tuple[Job, ...]]) -> tuple[Job, ...]:
    arguments, contents, jobs = task
    key = repr(arguments), contents
    if key not in _evaluations:
        _evaluations.clear()
        evaluation = Evaluation(**arguments)
        if config_checksum(evaluation.inputs, "data", "weights") != contents:
            raise OmnistereoError(
                "data, weights or rig are not the same on all machines. Share them."
            )
        _evaluations[key] = evaluation
    return tuple(_evaluations[key].run(jobs))
