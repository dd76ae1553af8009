"""Any methods on any data sets at any scale, frame by frame: stopped at any moment, spread over any machines.

Every result is a file of its own, written whole or not at all, which depends on nothing but the data, the weights and
the settings that it states. So a run that was killed goes on, machines share the frames by number, folders of several
are put together by copying, and the merged file is the same whichever way it came about.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch

from omnistereo_lib.dataset import Dataset, Frame, load_dataset
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.evaluate.methods import METHODS
from omnistereo_lib.evaluate.records import Record, add_record, check_record, checksum, config_checksum, write_record
from omnistereo_lib.evaluate.strata import error_sums, find_strata
from omnistereo_lib.files import make_folder, read_bytes
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.rig_files import load_rig
from omnistereo_lib.stereo.depth import winner_takes_all
from omnistereo_lib.stereo.learned import Precision, uses_bfloat16
from omnistereo_lib.stereo.methods import Method
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_lib.stereo.sweep import SphereSweep, find_device
from omnistereo_lib.stereo.volume import Cost, cost_volume
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS

DATA = Path(__file__).resolve().parents[2] / "data_samples"
_RIG_FILES = {".yaml", ".yml", ".json", ".txt", ".png"}  # masks among them


@dataclass(frozen=True)
class Scale:
    """Size of the panorama and number of spheres; φ from -45° to 45°."""

    width: int
    height: int
    num_spheres: int


SCALES = {"teaching": Scale(320, 80, 64), "training": Scale(600, 150, 192), "paper": Scale(1200, 300, 192)}


class Job(NamedTuple):
    """One method on one frame of one data set."""

    data: str
    frame: int
    method: Method


def share(numbers: tuple[int, ...], shard: str) -> tuple[int, ...]:
    """Return the part i/n of the frames, such as "2/8": every eighth, from the second on.

    Raises
    ------
    OmnistereoError
        If the shard is not of that form.
    """
    try:
        part, parts = (int(word) for word in shard.split("/"))
    except ValueError:
        part, parts = 0, 0
    if not 1 <= part <= parts:
        raise OmnistereoError(f"a shard is written i/n with 1 ≤ i ≤ n, such as 2/8; got {shard!r}")
    return numbers[part - 1 :: parts]


def find_sets(names: Sequence[str]) -> dict[str, Path]:
    """Return the folders of data sets by their names.

    Parameters
    ----------
    names : sequence of str
        "sunny" for the test frames of data_samples/sunny, and so on, or a folder. That is then called by its own
        name, or by that and the one above it where it is a split, such as city-train.

    Raises
    ------
    OmnistereoError
        If there is no such data set, or two of one name.
    """
    sets: dict[str, Path] = {}
    for text in names:
        name, folder = text, DATA / text / "test"
        if Path(text).name != text or not folder.is_dir():
            folder = Path(text).resolve()
            name = f"{folder.parent.name}-{folder.name}" if folder.name in ("train", "test") else folder.name
        if not folder.is_dir():
            raise OmnistereoError(f"there is no data set {text!r}: neither {DATA / text / 'test'} nor {folder}")
        if sets.setdefault(name, folder) != folder:
            raise OmnistereoError(f"{sets[name]} and {folder} would both be called {name!r}: evaluate them apart")
    return sets


def evaluate_frame(
    sweep: SphereSweep, frame: Frame, methods: Sequence[Method], load_cost: Callable[[Method], Cost]
) -> Iterator[tuple[Method, Record]]:
    """Judge methods on one frame; a cost volume is computed once for all methods that share it.

    Parameters
    ----------
    sweep : SphereSweep
        With the number of spheres that the methods want.
    frame : Frame
        With ground truth.
    methods : sequence of Method
    load_cost : callable
        Returns the matching cost of a method.

    Yields
    ------
    method : Method
    errors : dict
        "figures": what `index_error` returns for the frame, None for NaN; "strata": what `error_sums` returns.
    """
    gt_index = frame.gt_index(sweep.grid)
    strata = find_strata(gt_index, sweep)
    for kind in dict.fromkeys(method.volume_key for method in methods):
        volume = cost_volume(sweep, frame.images, load_cost(kind), kind.pairs)
        for method in methods:
            if method.volume_key == kind:
                index = winner_takes_all(method.smooth(volume), method.subindex).cpu().numpy()
                figures = index_error(index, gt_index, sweep.grid.num_spheres)
                known = {name: value if value == value else None for name, value in figures.items()}
                sums = error_sums(index, gt_index, sweep.grid.num_spheres, strata)
                yield method, {"figures": known, "strata": sums}


class Evaluation:
    """Methods × frames of data sets × one scale, with the results in a folder.

    Parameters
    ----------
    out : path
        Folder; made where it is missing. frames/SET/NUMBER/METHOD.json are the results as they come.
    sets : mapping of name to folder
        As `find_sets` returns them: folders that `load_dataset` reads, with ground truth.
    methods : sequence of Method
    scale : Scale
    split : str, optional
        Of the folders, see `load_dataset`.
    frames : sequence of int, optional
        Their numbers, in every set; default: all with ground truth.
    weights : path
        Folder of the networks' weights.
    device : torch device
        Under `torchrun` every process takes its own GPU.
    precision : "auto" | "float32" | "bfloat16"
        Of the networks.
    rig : path, optional
        Another rig in place of every set's own, such as a calibrated one: anything that `load_rig` reads. It is put
        where its first camera stands and looks as the set's first camera does.

    Attributes
    ----------
    jobs : list of Job
        Every method on every frame.

    Raises
    ------
    OmnistereoError
        If data, weights or rig are missing, the rig has other cameras than a set, there is no such device, or the
        folder holds results of another scale, rig, other data or other weights.
    """

    def __init__(
        self,
        out: str | Path,
        sets: Mapping[str, Path],
        methods: Sequence[Method] = METHODS,
        scale: Scale = SCALES["teaching"],
        split: str | None = None,
        frames: Sequence[int] | None = None,
        weights: str | Path = BUNDLED_WEIGHTS,
        device: torch.device | str = "cpu",
        precision: Precision = "auto",
        rig: str | Path | None = None,
    ) -> None:
        methods = tuple(dict.fromkeys(methods))
        self.scale, self.weights, self.precision = scale, Path(weights), precision
        self.device = find_device(device)
        _check_weights(methods, self.weights)
        self.load_cost = cache(lambda method: method.load_cost(self.weights, precision))
        self.sets = {name: load_dataset(folder, split) for name, folder in sets.items()}
        self.rigs = {name: data.rig if rig is None else _placed(rig, data) for name, data in self.sets.items()}
        self._rig = "own" if rig is None else checksum(b"".join(map(read_bytes, _rig_files(Path(rig)))))
        chosen = [(name, frame) for name, data in self.sets.items() for frame in _chosen(data, frames)]
        self.jobs = [Job(name, frame.number, method) for name, frame in chosen for method in methods]
        self._data = {(name, frame.number): _checksums(name, self.sets[name].folder, frame) for name, frame in chosen}
        paths = {method.weights_file(self.weights) for method in methods} - {None}
        self._weights = {path.name: checksum(read_bytes(path)) for path in paths}
        self._depends_on: Record = {}
        for job in self.jobs:
            add_record(self._depends_on, self._record(job, {}))
        self.out = make_folder(out)
        for path in sorted(self.out.glob("frames/*/*/[!.]*.json")):  # with a dot: being written, or left by a kill
            self.check(path)

    def path(self, job: Job) -> Path:
        """Return where the result of a job is, or will be."""
        return self.out / "frames" / job.data / f"{job.frame:05d}" / f"{job.method.name}.json"

    def check(self, path: str | Path) -> Record:
        """Read results, of one job or a results.json from anywhere, and compare settings and checksums with ours.

        Raises
        ------
        OmnistereoError
            If the file is missing or damaged, or states another setting, data file or weights file than ours; the
            message names them.
        """
        return check_record(Path(path), self._depends_on)

    def missing(self, jobs: Sequence[Job] | None = None) -> list[Job]:
        """Return the jobs, of all unless some are given, that have no result yet."""
        return [job for job in (self.jobs if jobs is None else jobs) if not self.path(job).is_file()]

    def share(self, shard: str = "1/1") -> list[Job]:
        """Return the jobs of part i/n of the frames, shared once more among the processes of `torchrun`.

        Raises
        ------
        OmnistereoError
            If the shard is not of that form.
        """
        frames = list(dict.fromkeys((job.data, job.frame) for job in self.jobs))
        process = f"{int(os.environ.get('RANK', '0')) + 1}/{os.environ.get('WORLD_SIZE', '1')}"
        mine = {frames[k] for k in share(share(tuple(range(len(frames))), shard), process)}
        return [job for job in self.jobs if (job.data, job.frame) in mine]

    def run(self, jobs: Sequence[Job] | None = None) -> Iterator[Job]:
        """Do the jobs, all unless some are given, that have no result yet; yield each when it has one.

        Raises
        ------
        OmnistereoError
            If a picture or a ground truth cannot be read, or a result cannot be written.
        """
        todo: dict[tuple[str, int], dict[int, list[Method]]] = {}
        for job in self.missing(jobs):
            frames = todo.setdefault((job.data, job.method.num_spheres), {})
            frames.setdefault(job.frame, []).append(job.method)
        for (name, num_spheres), frames in todo.items():
            sweep = self._sweep(name, num_spheres)  # its tables serve all of these frames
            for number, methods in frames.items():
                for method, errors in evaluate_frame(sweep, self.sets[name].frame(number), methods, self.load_cost):
                    job = Job(name, number, method)
                    write_record(self.path(job), self._record(job, errors))
                    yield job

    def results(self) -> Record:
        """Return the union of all jobs' records, with a checksum of the settings.

        Returns
        -------
        dict
            "config": the scale, the rig and the networks' precision; "methods": their settings by name;
            "config_sha256": of both; "data", "weights": SHA-256 of the files; "frames": set → number → method →
            what `evaluate_frame` yields.

        Raises
        ------
        OmnistereoError
            If results are missing, damaged or of another evaluation.
        """
        missing = self.missing()
        if missing:
            raise OmnistereoError(
                f"{len(missing)} of {len(self.jobs)} results are missing, such as {self.path(missing[0])}: "
                "run the other shards, or the same command again"
            )
        results: Record = {}
        for job in self.jobs:
            add_record(results, self.check(self.path(job)))
        return results | {"config_sha256": config_checksum(results)}

    def _sweep(self, name: str, num_spheres: int) -> SphereSweep:
        rig, N = self.rigs[name], num_spheres or self.scale.num_spheres
        grid = SphereGrid(self.scale.width, self.scale.height, num_spheres=N, min_depth=rig.min_depth)
        return SphereSweep(rig, grid, device=self.device)

    def _record(self, job: Job, errors: Record) -> Record:
        """Return a job's errors with all that they depend on."""
        config, weights = asdict(self.scale) | {"rig": self._rig}, {}
        path = job.method.weights_file(self.weights)
        if path is not None:
            config["precision"] = "bfloat16" if uses_bfloat16(self.precision, self.device) else "float32"
            weights[path.name] = self._weights[path.name]
        return {
            "config": config,
            "methods": {job.method.name: asdict(job.method)},
            "data": self._data[job.data, job.frame],
            "weights": weights,
            "frames": {job.data: {f"{job.frame:05d}": {job.method.name: errors}}},
        }


def _check_weights(methods: Sequence[Method], folder: Path) -> None:
    paths = {method: method.weights_file(folder) for method in methods}
    missing = {method: path for method, path in paths.items() if path is not None and not path.is_file()}
    if missing:
        files = ", ".join(dict.fromkeys(map(str, missing.values())))
        others = " ".join(method.name for method in methods if method not in missing)
        raise OmnistereoError(
            f"weights are missing: {files}, for {', '.join(method.name for method in missing)}. Make them with "
            f"python -m omnistereo_lib train, or leave these methods out: --methods {others or 'zncc zncc+sgm'}"
        )


def _chosen(data: Dataset, numbers: Sequence[int] | None) -> list[Frame]:
    """Return the frames of these numbers, or all that have ground truth."""
    if data.rig.min_depth is None:
        raise OmnistereoError(f"the rig of {data.folder} does not state its nearest depth: add it to config.yaml")
    frames = list(data) if numbers is None else [data.frame(number) for number in dict.fromkeys(numbers)]
    known = [frame for frame in frames if frame.truth_path is not None]
    if not known or (numbers is not None and len(known) < len(frames)):
        raise OmnistereoError(f"{data.folder} has no ground truth for {'some of ' * bool(known)}the frames asked for")
    return known


def _placed(path: str | Path, data: Dataset) -> Rig:
    """Read a rig and put its first camera where a data set has its first one; the spheres stay the data set's."""
    own, rig = data.rig, load_rig(path)
    sizes = [[camera.image_size for camera in one.cameras] for one in (own, rig)]
    if sizes[0] != sizes[1]:
        raise OmnistereoError(f"{path} has cameras of {sizes[1]} pixels, {data.folder} of {sizes[0]}: another rig")
    return replace(rig.moved(own.T_rig_cam[0] @ rig.T_rig_cam[0].inverse()), min_depth=own.min_depth)


def _rig_files(path: Path) -> list[Path]:
    """Return the files that describe a rig: of a folder, all that may; else the one."""
    if path.is_file():
        return [path]
    return [inside for inside in sorted(path.iterdir()) if inside.suffix in _RIG_FILES and inside.is_file()]


def _checksums(name: str, folder: Path, frame: Frame) -> dict[str, str]:
    """Return the SHA-256 of the files behind a frame: the rig's, the pictures, the ground truth."""
    inside = {f"{name}/{path.name}": path for path in _rig_files(folder)}
    inside |= {f"{name}/{path.parent.name}/{path.name}": path for path in [*frame.image_paths, frame.truth_path]}
    return {key: checksum(read_bytes(path)) for key, path in inside.items()}
