"""Evaluation runs: any methods on any data sets at any scale, frame by frame.

Every result is a file of its own, written atomically, with a checksum of the data, weights and
settings that it depends on. So an interrupted run resumes, the machines of a Dask cluster share the
frames, and the merged file is always the same.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import torch

from omnistereo_learn.evaluate.methods import METHODS, EvaluatedMethod
from omnistereo_learn.evaluate.records import (
    Record,
    config_checksum,
    read_errors,
    rounded,
    write_record,
)
from omnistereo_learn.evaluate.regions import error_sums, find_regions
from omnistereo_learn.provenance import (
    PROVENANCE,
    differences,
    kept_precision,
    made_of,
    provenance,
    read_facts,
    write_facts,
)
from omnistereo_lib.dataset import Dataset, load_dataset
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import checksum, make_folder, read_bytes, unpack
from omnistereo_lib.frame import Frame
from omnistereo_lib.geometry.rig import Rig
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.stereo.cost import Cost
from omnistereo_lib.stereo.device import select_device
from omnistereo_lib.stereo.learned import Precision, choose_precision
from omnistereo_lib.stereo.metrics import index_error
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.volume import cost_volume
from omnistereo_lib.stereo.weights import BUNDLED_WEIGHTS
from omnistereo_rigs.formats.read import read_any_rig

DATA = Path(__file__).resolve().parents[2] / "data_samples"
_RIG_FILES = {".yaml", ".yml", ".json", ".txt", ".png"}  # including masks


@dataclass(frozen=True)
class Scale:
    """Size of the panorama and number of spheres; φ from -45° to 45°."""

    width: int
    height: int
    num_spheres: int


SCALES = {
    "teaching": Scale(320, 80, 64),
    "training": Scale(600, 150, 192),
    "paper": Scale(1200, 300, 192),
}


class Job(NamedTuple):
    """One method on one frame of one data set."""

    data: str
    frame: int
    method: EvaluatedMethod


def find_sets(names: Sequence[str]) -> dict[str, Path]:
    """Return the folders of data sets by name; refuse a missing one, or two of one name.

    "sunny" means data_samples/sunny/test. Anything else is a folder, called by its own name or, if
    it is a split, also by that of its parent, such as city-train.
    """
    sets: dict[str, Path] = {}
    for text in names:
        name, folder = text, DATA / text / "test"
        if Path(text).name == text:
            unpack(folder)
        if Path(text).name != text or not folder.is_dir():
            folder = Path(text).resolve()
            unpack(folder)
            is_split = folder.name in ("train", "test")
            name = f"{folder.parent.name}-{folder.name}" if is_split else folder.name
        if not folder.is_dir():
            places = f"{DATA / text / 'test'} or {folder}"
            raise OmnistereoError(
                f"data set {text!r} not found in {places}. Pass a bundled name or a data set"
                " folder."
            )
        if sets.setdefault(name, folder) != folder:
            raise OmnistereoError(
                f"{sets[name]} and {folder} are both called {name!r}. Evaluate them separately."
            )
    return sets


def evaluate_frame(
    sweep: SphereSweep,
    frame: Frame,
    methods: Sequence[EvaluatedMethod],
    load_cost: Callable[[EvaluatedMethod], Cost],
) -> Iterator[tuple[EvaluatedMethod, Record]]:
    """Evaluate methods on one frame with ground truth; methods with equal cost volumes share them.

    The sweep has the number of spheres of these methods; `load_cost` returns the matching cost of a
    method. Yields each method and its errors, "figures": what `index_error` returns, None for NaN;
    "strata": what `error_sums` returns.
    """
    gt_index, N = frame.gt_index(sweep.grid), sweep.grid.num_spheres
    regions = find_regions(gt_index, sweep)
    for key in dict.fromkeys(method.volume_key for method in methods):
        volume = cost_volume(sweep, frame, load_cost(key), key.pairs)
        for method in (method for method in methods if method.volume_key == key):
            index = method.read_out(method.smooth(volume))[0].cpu().numpy()
            metrics = index_error(index, gt_index, N)
            figures = {name: value if value == value else None for name, value in metrics.items()}
            yield method, {"figures": figures, "strata": error_sums(index, gt_index, N, regions)}


class Evaluation:
    """Methods × frames of data sets × one scale (the `jobs`), with the results in a folder.

    Args:
        out: Output folder, made if missing; frames/SET/NUMBER/METHOD.json are the single results.
        sets: Folders with ground truth by name, as `find_sets` returns them.
        frames: Frame numbers, the same in every set; default: all with ground truth.
        weights, device, precision: Folder of the weights; see `select_device` and `LearnedCost`.
        rig: Another rig, such as a calibrated one, in place of the rig of every set: anything that
            `load_rig` reads. Its first camera gets the pose of the first camera of the set.

    Raises:
        OmnistereoError: If data, weights, rig or device are missing, the rig has other cameras than
            a set, or a result in the folder comes from another scale or rig, other data or other
            weights.
    """

    def __init__(
        self,
        out: str | Path,
        sets: Mapping[str, Path],
        methods: Sequence[EvaluatedMethod] = METHODS,
        scale: Scale = SCALES["teaching"],
        frames: Sequence[int] | None = None,
        weights: str | Path = BUNDLED_WEIGHTS,
        device: torch.device | str = "cpu",
        precision: Precision = "auto",
        rig: str | Path | None = None,
    ) -> None:
        methods = tuple(dict.fromkeys(methods))
        self.scale = scale
        self.weights = Path(weights)
        self.device = select_device(device)
        self.out = Path(out)
        stored = read_facts(self.out / PROVENANCE)
        self.precision = choose_precision(kept_precision(precision, stored), self.device)
        self.sets = {name: load_dataset(path) for name, path in sets.items()}
        self._rigs = (
            {} if rig is None else {name: _read_rig(rig, data) for name, data in self.sets.items()}
        )
        chosen = [
            (name, frame)
            for name, data in self.sets.items()
            for frame in _select_frames(data, frames)
        ]
        self.jobs = [Job(name, f.number, method) for name, f in chosen for method in methods]
        rig_text = (
            "own" if rig is None else checksum(b"".join(map(read_bytes, _rig_files(Path(rig)))))
        )
        self._config = asdict(scale) | {"rig": rig_text}
        self._data = {
            (name, frame.number): _checksums(name, self.sets[name].folder, frame)
            for name, frame in chosen
        }
        self._weights = _weights_checksums(methods, self.weights)
        self._compare(stored)
        make_folder(out)
        # Reads all that there is.
        self.missing()
        facts = self.facts
        facts["provenance"] = made_of(stored) | facts["provenance"]
        if differences(stored, facts):
            write_facts(self.out / PROVENANCE, facts)

    @property
    def facts(self) -> Record:
        """What decides the numbers, as `provenance.json` holds it."""
        inputs, network = self.inputs, bool(self._weights)
        made = provenance(
            self._config["rig"],
            checksum(json.dumps([inputs["data"], inputs["weights"]], sort_keys=True).encode())[:16],
            " ".join(inputs["methods"]),
            self.precision if network else None,
            torch.get_num_threads() if network else None,
        )
        return asdict(self.scale) | {"provenance": made}

    def _compare(self, stored: Record) -> None:
        """Refuse a folder of another scale, rig or precision; methods and frames may join it."""
        made = self.facts["provenance"]
        # The precision counts once there are networks on both sides.
        there = {name: fact for name, fact in made_of(stored).items() if name in made}
        there |= {name: made[name] for name in ("inputs", "method")}
        other = differences(stored | {"provenance": made | there}, self.facts)
        if stored and other:
            raise OmnistereoError(
                f"{self.out} holds another evaluation: {'; '.join(other)}. Use another folder."
            )

    def path(self, job: Job) -> Path:
        """Return the file of a result."""
        return self.out / "frames" / job.data / f"{job.frame:05d}" / f"{job.method.name}.json"

    def missing(self, jobs: Sequence[Job] | None = None) -> list[Job]:
        """Return the jobs (default: of all) that have no result yet, or one that cannot be read."""
        return [job for job in (self.jobs if jobs is None else jobs) if self._errors(job) is None]

    def _errors(self, job: Job) -> Record | None:
        return read_errors(self.path(job), self._inputs_sha256(job))

    def run(self, jobs: Sequence[Job] | None = None) -> Iterator[Job]:
        """Do the jobs (default: all) without a result; yield each once its result is written."""
        load_cost = cache(
            partial(EvaluatedMethod.load_cost, folder=self.weights, precision=self.precision)
        )
        order = attrgetter("data", "method.num_spheres", "frame")
        todo = sorted(self.missing(jobs), key=order)
        for (name, num_spheres), of_sweep in groupby(todo, lambda job: order(job)[:2]):
            sweep, swept = None, None
            for number, of_frame in groupby(of_sweep, attrgetter("frame")):
                frame, methods = self.sets[name].frame(number), [job.method for job in of_frame]
                rig = self._rigs.get(name, frame.rig)
                # the sweep's lookup tables serve all frames of a rig
                if sweep is None or rig is not swept:
                    sweep = SphereSweep(rig, self._grid(rig, num_spheres), device=self.device)
                    swept = rig
                for method, errors in evaluate_frame(sweep, frame, methods, load_cost):
                    job = Job(name, number, method)
                    write_record(
                        self.path(job),
                        {"inputs": self._inputs_sha256(job), "errors": rounded(errors)},
                    )
                    yield job

    def _grid(self, rig: Rig, num_spheres: int) -> SphereGrid:
        scale = self.scale
        assert rig.min_depth is not None  # `_select_frames` refuses others
        return SphereGrid(
            scale.width,
            scale.height,
            num_spheres=num_spheres or scale.num_spheres,
            min_depth=rig.min_depth,
        )

    @property
    def inputs(self) -> Record:
        """What the results depend on.

        "config": the scale, the rig and the precision of the networks; "methods": their settings by
        name; "data", "weights": SHA-256 of the files.
        """
        methods = {job.method.name: job.method for job in self.jobs}
        return {
            "config": self._config | (self._precision if self._weights else {}),
            "methods": {name: asdict(method) for name, method in methods.items()},
            "data": {key: sha for files in self._data.values() for key, sha in files.items()},
            "weights": self._weights,
        }

    def results(self) -> Record:
        """Return `inputs`, "config_sha256", and "frames": set → number → method → its errors.

        Raises an `OmnistereoError` if a result is missing or does not fit.
        """
        if missing := self.missing():
            found = (
                f"{len(missing)} of {len(self.jobs)} results are missing, such as"
                f" {self.path(missing[0])}"
            )
            raise OmnistereoError(f"{found}. Run the same command again.")
        frames: Record = {}
        for job in self.jobs:
            results = frames.setdefault(job.data, {}).setdefault(f"{job.frame:05d}", {})
            results[job.method.name] = self._errors(job)
        inputs = self.inputs
        return inputs | {"frames": frames, "config_sha256": config_checksum(inputs)}

    def _inputs_sha256(self, job: Job) -> str:
        """Return the SHA-256 of all that a result depends on."""
        config, weights = self._config, None
        if job.method.has_weights:
            config = config | self._precision
            weights = self._weights[job.method.weights_file(self.weights).name]
        method, data = asdict(job.method), self._data[job[:2]]
        inputs = {"config": config, "method": method, "data": data, "weights": weights}
        return checksum(json.dumps(inputs, sort_keys=True).encode())

    @property
    def _precision(self) -> dict[str, str]:
        return {"precision": self.precision}


def _weights_checksums(methods: Sequence[EvaluatedMethod], folder: Path) -> dict[str, str]:
    """Return the SHA-256 of the weights files by name; all of them must be there."""
    paths = {method: method.weights_file(folder) for method in methods if method.has_weights}
    missing = {method: path for method, path in paths.items() if not path.is_file()}
    if missing:
        files = ", ".join({str(path): "" for path in missing.values()})
        names = ", ".join(m.name for m in missing)
        others = (
            " ".join(method.name for method in methods if method not in missing) or "zncc zncc+sgm"
        )
        remedy = f"Make them with omnistereo train, or leave these methods out: --methods {others}"
        raise OmnistereoError(f"weights are missing: {files}, for {names}. {remedy}")
    return {path.name: checksum(read_bytes(path)) for path in {*paths.values()}}


def _select_frames(data: Dataset, numbers: Sequence[int] | None) -> list[Frame]:
    """Return the frames of these numbers, or all that have ground truth."""
    frames = (
        list(data) if numbers is None else [data.frame(number) for number in dict.fromkeys(numbers)]
    )
    if any(frame.rig.min_depth is None for frame in frames):
        raise OmnistereoError(
            f"the rig of {data.folder} does not state its nearest depth. Add it to config.yaml."
        )
    with_gt = [frame for frame in frames if frame.gt_path is not None]
    if not with_gt or (numbers is not None and len(with_gt) < len(frames)):
        part = "some of " if with_gt else ""
        raise OmnistereoError(f"{data.folder} has no ground truth for {part}the frames requested")
    return with_gt


def _read_rig(path: str | Path, data: Dataset) -> Rig:
    """Read a rig and give its first camera the pose of that of a data set: the spheres stay."""
    own, rig = data.rig, read_any_rig(path, keep_frame=True)
    sizes = [[camera.image_size for camera in one.cameras] for one in (own, rig)]
    if sizes[0] != sizes[1]:
        raise OmnistereoError(
            f"{path} has cameras of {sizes[1]} pixels; expected {sizes[0]}, as in {data.folder}"
        )
    return replace(
        rig.transformed(own.T_rig_cam[0] @ rig.T_rig_cam[0].inverse()), min_depth=own.min_depth
    )


def _rig_files(path: Path) -> list[Path]:
    """Return the files that describe a rig: of a folder, all that may; else the one."""
    if path.is_file():
        return [path]
    return [
        inside
        for inside in sorted(path.iterdir())
        if inside.suffix in _RIG_FILES and inside.is_file()
        if inside.name != "trajectory.txt"  # where the rig was
    ]


def _checksums(name: str, set_folder: Path, frame: Frame) -> dict[str, str]:
    """Return the SHA-256 of the input files of a frame: rig, images, ground truth."""
    folder = frame.image_paths[0].parents[1]
    if folder.parent == set_folder:  # the frame has a rig of its own
        name = f"{name}/{folder.name}"
    files = {f"{name}/{path.name}": path for path in _rig_files(folder)}
    depth = [frame.gt_path] if frame.gt_path is not None else []
    files |= {f"{name}/{p.parent.name}/{p.name}": p for p in [*frame.image_paths, *depth]}
    return {key: checksum(read_bytes(path)) for key, path in files.items()}
