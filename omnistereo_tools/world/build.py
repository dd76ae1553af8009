"""A recording on its way to one world: its frames, the path of the rig through them, and their
refined depth.

RECORDING/world/
  trajectory.txt                      for each frame its number, and the pose rig → world in TUM's
                                      format, metres
  trajectory_seconds.txt              the same with times for numbers, where the recording states
                                      them
  mesh.glb, mesh.ply                  the surface: y up for viewers, and in the axes of the world
  flight.mp4                          with --video: a flight along the path
  world.rrd                           with --rrd: images, points, path and surface for Rerun
  omnidepth_world_640/00001.tiff      refined inverse depth, 1/m, beside links to the rig and the
                                      images: a data set
  index.html                          the surface seen from the path, a plan, and frames before
                                      and after
  steps.json, world.json              the steps found so far, and what the rest was computed with

The world has the axes of the rig in its first frame: x right, y down, z forward.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from omnistereo_learn.provenance import (
    arrays_checksum,
    made_of,
    provenance,
    read_facts,
    rig_checksum,
)
from omnistereo_lib.dataset import Dataset, load_dataset, read_poses, write_poses
from omnistereo_lib.errors import OmnistereoError, check_number, error_context
from omnistereo_lib.files import checksum, make_folder, read_data, write_text
from omnistereo_lib.frame import Frame, read_inverse_depth, write_inverse_depth
from omnistereo_lib.geometry.pose import Pose
from omnistereo_lib.geometry.sphere import SphereGrid
from omnistereo_lib.parse import Section
from omnistereo_lib.pictures import check_image
from omnistereo_lib.rig_file import save_rig
from omnistereo_lib.stereo.depth import Depth
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_lib.stereo.threads import map_threads
from omnistereo_tools.input.masks import black_cameras
from omnistereo_tools.judge.trust import DOUBTFUL
from omnistereo_tools.output.blend import blended_panorama
from omnistereo_tools.progress import progress_bar, say
from omnistereo_tools.record.recordings import SETTINGS, TIMES
from omnistereo_tools.world.fusion import View, Volume
from omnistereo_tools.world.motion import Sighting, SightingFinder, Step, rig_step, step_anywhere
from omnistereo_tools.world.refine import mix, moving_rays

_FARTHEST = 1.5  # times the range: as far a surface is looked for
_JUMP, _BETWEEN = 2.5, 1.2  # of the median step; of a step, by way of another frame
_LOOP = 4.0  # a way of more times the distance, and of more metres, comes back
_ROUNDING = 1.001  # times the most that a recording stores
_LOST = 3  # frames without a sure step, after which the path begins anew
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class RecordedFrames:
    """The frames of a recording that are done, with what their depth was computed with."""

    folder: Path
    data: Dataset
    grid: SphereGrid
    sums: dict[int, str]  #: of each frame a checksum of its images, depth, confidence and rig
    channels: int  #: of the images: 1, or 3 where some are in colour

    @classmethod
    def open(cls, folder: Path) -> RecordedFrames:
        """Open what `omnistereo record` has written, and name the frames that have nothing to fuse.

        An `OmnistereoError` says what is missing.
        """
        if not (folder / SETTINGS).is_file():
            how = f"Make one: omnistereo record … --out {folder}"
            raise OmnistereoError(f"{folder} has no {SETTINGS}; expected a recording. {how}")
        data, grid = load_dataset(folder), _stored_grid(folder / SETTINGS)
        if empty := [str(frame.number) for frame in data if frame.gt_path is None]:
            say(f"without depth, and left out: {_some(empty)}. Run omnistereo record again")
        done, channels, shown = list[Frame](), 1, dict[str, int]()
        found = cls(folder, data, grid, {}, 1)
        for frame in data:
            if frame.gt_path is None:
                continue
            try:
                pictures, of_frame = found._check_pictures(frame)
                if (other := shown.setdefault(pictures, frame.number)) != frame.number:
                    raise OmnistereoError(f"its pictures are those of frame {other}")
                found.sums[frame.number] = f"{pictures}{found._check_depth(frame)}"
            except OmnistereoError as error:
                say(f"frame {frame.number} is left out: {error}")
                continue
            channels = max(channels, of_frame)
            done.append(frame)
        if len(done) < 2:
            few = f"{len(done)} frames with depth that can be fused"
            raise OmnistereoError(f"{folder} has {few}; a world needs two or more")
        return replace(found, data=Dataset(folder, data.rig, done), channels=channels)

    def _check_pictures(self, frame: Frame) -> tuple[str, int]:
        """Return a checksum of the pictures of a frame, and their channels.

        Raises an `OmnistereoError` if one is missing, torn, or of another size.
        """
        sums, channels = list[str](), 1
        for path, camera in zip(frame.image_paths, frame.rig.cameras, strict=True):
            content, picture = check_image(path, camera.image_size)
            sums.append(checksum(content))
            channels = max(channels, 1 if picture.mode in ("1", "L", "LA", "I;16", "I;16B") else 3)
        return checksum(" ".join(sums).encode())[:16], channels

    def _check_depth(self, frame: Frame) -> str:
        """Return a checksum of the panoramas of a frame and of its rig.

        Raises an `OmnistereoError` if one is missing, torn, empty, of another size, or holds what
        no recording does.
        """
        paths = Path(frame.gt_path or ""), self.confidence_path(frame), self._trust_path(frame)
        most = _ROUNDING / self.grid.min_depth, _ROUNDING, _ROUNDING
        panoramas = [read_inverse_depth(path, 1.0) for path in paths]
        for path, panorama, highest in zip(paths, panoramas, most, strict=True):
            if panorama.shape != self.grid.shape:
                (height, width), (rows, columns) = panorama.shape, self.grid.shape
                raise OmnistereoError(
                    f"{path} is {width} × {height}; expected {columns} × {rows}, as in {SETTINGS}"
                )
            if (found := np.nanmax(panorama, initial=0)) > highest:
                raise OmnistereoError(f"{path} holds {found:g}; expected at most {highest:.4g}")
        if not (np.isfinite(panoramas[0]) & (panoramas[1] > 0)).any():
            raise OmnistereoError(f"no ray of {paths[0]} has depth and confidence")
        sums = f"{rig_checksum(frame.rig)} {arrays_checksum(panoramas[:2])}"
        return checksum(sums.encode())[:16]

    @property
    def times(self) -> dict[int, int]:
        """When each frame was taken, ns; nothing where that is not known."""
        stored = read_facts(self.folder / TIMES)
        return {int(n): ns for n, ns in stored.items() if n.isdecimal() and isinstance(ns, int)}

    def confidence_path(self, frame: Frame) -> Path:
        """Return where the confidence of a frame is."""
        return self.folder / f"confidence_{self.grid.width}" / Path(frame.gt_path or "").name

    def _trust_path(self, frame: Frame) -> Path:
        return self.folder / f"trust_{self.grid.width}" / Path(frame.gt_path or "").name

    def doubtful_percent(self, numbers: Iterable[int]) -> float:
        """Return how many percent of the rays of some frames are doubtful."""
        paths = (self._trust_path(self.data.frame(number)) for number in numbers)
        shares = [np.mean(read_inverse_depth(path, 1.0) < DOUBTFUL) for path in paths]
        return 100 * float(np.mean(shares))

    @property
    def provenance(self) -> dict[str, Any]:
        """What the world is made from."""
        inputs = checksum(repr(sorted(self.sums.items())).encode())[:16]
        method = made_of(read_facts(self.folder / SETTINGS)).get("method", "depth")
        return provenance(self.data.rig, inputs, f"fusion of {method}")

    def sweep_of(self, frame: Frame) -> SphereSweep:
        """Return the sweep that a frame was recorded with, which has the origin of its panorama."""
        if frame.rig is self.data.rig:
            return self.sweep
        key = rig_checksum(frame.rig)
        if (sweep := self._turned.get(key)) is None:
            sweep = self.sweep.with_poses(frame.rig.T_rig_cam)
            self._turned.clear()
            self._turned[key] = sweep
        return sweep

    @cached_property
    def _turned(self) -> dict[str, SphereSweep]:
        """The last sweep of a rig whose cameras have turned on the way."""
        return {}

    @cached_property
    def sweep(self) -> SphereSweep:
        """The sweep of the recording; its rig has the origin of the panoramas."""
        return SphereSweep(self.data.rig, self.grid)

    def panorama(self, frame: Frame, inverse_depth: NDArray[Any]) -> NDArray[np.float32]:
        """Return what a frame shows at an inverse depth (H, W): (H, W, channels), 0 to 255."""
        # Gray images among colour ones are colour.
        color = blended_panorama(self.depth(frame, inverse_depth)).reshape(*self.grid.shape, -1)
        return np.broadcast_to(color, (*self.grid.shape, self.channels))

    def depth(self, frame: Frame, inverse_depth: NDArray[Any]) -> Depth:
        """Return an inverse depth (H, W) of a frame as a result; its confidence is 0."""
        index = self.grid.inverse_depth_to_index(inverse_depth).clip(0, self.grid.num_spheres - 1)
        confidence = np.zeros(self.grid.shape, np.float32)
        return Depth(index.astype(np.float32), confidence, self.sweep_of(frame), frame.images)

    def holes_percent(self, volume: Volume, poses: dict[int, Pose]) -> float:
        """Return how many percent of what frames see within the range has no surface behind it, of
        five frames along the path and one ray in four.
        """
        rays, numbers, shares = self.grid.rays()[::2, ::2], list(poses), []
        for k in np.unique(np.linspace(0, len(numbers) - 1, 5).astype(int)):
            near = self.data.frame(numbers[k]).inverse_depth[::2, ::2] > 1 / volume.reach
            fused, _ = volume.march(poses[numbers[k]], rays, _FARTHEST * volume.reach)
            shares.append(np.isnan(fused[near]).mean() if near.any() else 0.0)
        return 100 * float(np.mean(shares))

    def drift(self, poses: dict[int, Pose]) -> float | None:
        """Return by how many metres the path is off where it comes back to where it was, by what
        the two frames there show; None where it does not come back.
        """
        numbers, places = list(poses), np.stack([pose.t for pose in poses.values()])
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        metres = np.append(0, np.cumsum(steps))
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        way = np.abs(metres[:, None] - metres)
        near = (apart <= _JUMP * np.median(steps)) & (way > _LOOP * apart) & (way > _LOOP)
        if not near.any():
            return None
        k, late = sorted(np.unravel_index(np.where(near, way, 0).argmax(), way.shape))
        a, b = numbers[k], numbers[late]
        by_path = poses[a].inverse() @ poses[b]
        one, other = (self._sighting(self.data.frame(n)) for n in (a, b))
        found = rig_step(self.sweep.rig, one, other, by_path)
        return (by_path.inverse() @ found.T).magnitude()[1] if found.sure else None

    def _sighting(self, frame: Frame) -> Sighting:
        if told := black_cameras(frame.images):
            say(f"frame {frame.number}: {told}")
        return self._finder.find(frame.images, frame.inverse_depth, self.sweep_of(frame).rig)

    @cached_property
    def _finder(self) -> SightingFinder:
        """Where features are looked for, which takes a second to compute; poses do not matter."""
        return SightingFinder(self.sweep.rig, self.grid)

    def view(self, frame: Frame, pose: Pose) -> View:
        """Return what a frame knows of the world."""
        inverse = frame.inverse_depth
        confidence = read_inverse_depth(self.confidence_path(frame), 1.0)
        return View.of(pose, inverse, confidence, self.panorama(frame, inverse), self.grid.step)

    def find_poses(self, path: Path) -> dict[int, Pose]:
        """Return the pose rig → world of each frame whose step is sure; steps that `path` holds are
        not repeated.

        Where several frames in a row have no sure step the path is cut, and the longest part
        returned.
        """
        steps, progress = _StoredSteps(path, self.sums), progress_bar("frame")
        base, last, lost, total = self.data[0], Pose.identity(), 0, len(self.data)
        rig, parts = self.sweep.rig, [{base.number: Pose.identity()}]
        seen, matched = dict[int, Future[Sighting]](), dict[tuple[int, int], Future[Step]]()
        ahead = ThreadPoolExecutor(2)
        try:

            def match(a: Frame, b: Frame) -> Future[Step]:
                for frame in (a, b):
                    if frame.number not in seen:
                        seen[frame.number] = ahead.submit(self._sighting, frame)
                x, y, key = seen[a.number], seen[b.number], (a.number, b.number)
                if key not in matched:
                    matched[key] = ahead.submit(lambda: step_anywhere(rig, x.result(), y.result()))
                return matched[key]

            for k in range(1, total):
                frame = self.data[k]
                progress(k, total, f"path, frame {frame.number}")
                step = steps.get(base, frame)
                if step is None:
                    guess = last if len(parts[-1]) > 1 else None
                    found = match(base, frame)
                    # Meanwhile the next two, as if this step and those were sure.
                    following = [*self.data[k : k + 3]]
                    for one, other in pairwise(following):
                        match(one, other)
                    a, b = seen[base.number].result(), seen[frame.number].result()
                    step = rig_step(rig, a, b, guess, found.result())
                    steps.add(base, frame, step)
                    kept = {base.number, *(one.number for one in following)}
                    seen = {number: one for number, one in seen.items() if number in kept}
                    matched = {key: one for key, one in matched.items() if kept.issuperset(key)}
                if step.sure:
                    parts[-1][frame.number] = parts[-1][base.number] @ step.T
                    base, last, lost = frame, step.T, 0
                else:
                    lost += 1
                    agree = f"{step.inliers} of {step.matches} matches agree on a step"
                    say(f"frame {frame.number} is left out: {agree}, {step.rival} on another")
                if lost == _LOST:
                    base, lost = frame, 0
                    parts.append({base.number: Pose.identity()})
        finally:
            ahead.shutdown(cancel_futures=True)  # Ctrl-C waits only for what runs
        progress(total, total, "")
        poses = max(parts, key=len)
        for part in parts:
            if part is not poses:
                numbers = _some([str(number) for number in part])
                why = "no sure step leads to the longest part of the path"
                say(f"left out, since {why}: {numbers}")
        if len(poses) < 2:
            raise OmnistereoError(
                f"{self.folder}: no step between two frames is sure. Frames must share most of what"
                " they see: record with a smaller step of --frames, or more often."
            )
        if len(jumps := jumps_past_others(poses)) > 1:
            some = ", ".join(map(str, jumps[:8]))
            say(
                f"warning: the frames are out of order in space: at {some} the rig jumps past"
                " places that other frames show. Check how the pictures are named"
            )
        return poses

    def integrate(
        self,
        volume: Volume,
        views: dict[int, View],
        moving: dict[int, NDArray[np.bool_]] | None = None,
    ) -> None:
        """Fuse the frames, or take the rays that move, (H, W) of each, out of the volume again."""
        progress, words = progress_bar("frame"), "taking out what moves" if moving else "fusing"
        for done, (number, view) in enumerate(views.items()):
            progress(done, len(views), f"{words}, frame {number}")
            if moving is not None:
                view = replace(view, weight=np.where(moving[number], -view.weight, 0))
            volume.integrate(view, self.grid)
        progress(len(views), len(views), "")

    def refine(
        self, volume: Volume, poses: dict[int, Pose], out: Path
    ) -> dict[int, NDArray[np.bool_]]:
        """Write the depth of all frames as fused; return the rays that move, (H, W) of each."""
        rays = self.grid.rays()
        for path in make_folder(out).glob("*.tiff"):
            path.unlink()

        def refine(frame: Frame, pose: Pose) -> NDArray[np.bool_]:
            own = frame.inverse_depth
            fused, remembered = volume.march(pose, rays, _FARTHEST * volume.reach)
            seen = self.panorama(frame, np.where(np.isnan(fused), own, fused))
            moving = moving_rays(own, fused, seen, remembered, self.grid.step)
            write_inverse_depth(out / f"{frame.number:05}.tiff", mix(own, fused, moving))
            return moving

        return dict(self.each("refining", poses, refine))

    def each(
        self, words: str, poses: dict[int, Pose], function: Callable[[Frame, Pose], _Result]
    ) -> Iterator[tuple[int, _Result]]:
        """Yield the number of each frame, and what a function returns of it, in two threads."""
        progress = progress_bar("frame")
        found = map_threads(lambda number: function(self.data.frame(number), poses[number]), poses)
        for done, (number, result) in enumerate(zip(poses, found, strict=True)):
            progress(done, len(poses), f"{words}, frame {number}")
            yield number, result
        progress(len(poses), len(poses), "")

    def link(self, out: Path) -> None:
        """Put the rig and the images beside the refined depth, so that it is a data set."""
        save_rig(self.data.rig, out / "config.yaml")
        for frame in self.data:
            write_poses(out, frame.number, read_poses(self.folder, frame.number))
        for camera in self.folder.glob("cam[0-9]*"):
            if not (out / camera.name).exists():
                # where links are not allowed, the images stay where they are
                with suppress(OSError):
                    (out / camera.name).symlink_to(Path("..") / camera.name)


def _stored_grid(path: Path) -> SphereGrid:
    """Return the panorama of a recording, whose settings are in a file."""
    with error_context(path):
        settings = Section(read_data(path))
        width, height, spheres = (settings.number(name) for name in ("width", "height", "spheres"))
        check_number(width, "width", 2, 1 << 20)
        highest = 180.0 * height / width
        grid = int(width), int(height), (-highest, highest), int(spheres)
        return SphereGrid(*grid, settings.number("min_depth"))


def _some(names: Sequence[str]) -> str:
    """Return the first names of many."""
    return ", ".join(names[:12]) + " …" * (len(names) > 12)


class _StoredSteps:
    """The steps of a recording found so far, in a file that is written after each."""

    def __init__(self, path: Path, sums: dict[int, str]) -> None:
        self.path, self.sums, self.steps = path, sums, read_facts(path)

    def _key(self, a: Frame, b: Frame) -> str:
        """Return what tells a step between two frames from one between others of their numbers."""
        return " ".join(f"{frame.number} {self.sums[frame.number]}" for frame in (a, b))

    def get(self, a: Frame, b: Frame) -> Step | None:
        with suppress(TypeError, KeyError, ValueError):
            row = self.steps[self._key(a, b)]
            T = Pose(np.reshape(row[:9], (3, 3)), np.array(row[9:12]))
            return Step(T, *map(int, row[12:]))
        return None

    def add(self, a: Frame, b: Frame, step: Step) -> None:
        """Store a step, its pose in full: what is resumed is what would have been."""
        pose = [*step.T.R.ravel().tolist(), *step.T.t.tolist()]
        self.steps[self._key(a, b)] = [*pose, step.inliers, step.matches, step.rival]
        write_text(self.path, json.dumps(self.steps) + "\n")


def jumps_past_others(poses: Mapping[int, Pose]) -> list[int]:
    """Return the frames before which the rig makes a long step past the place of another frame."""
    numbers, places = list(poses), np.stack([pose.t for pose in poses.values()])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    found = []
    for k in np.flatnonzero(steps > _JUMP * np.median(steps)):
        others = np.delete(places, [k, k + 1], axis=0)
        by_way = sum(np.linalg.norm(others - end, axis=1) for end in (places[k], places[k + 1]))
        if np.min(by_way, initial=np.inf) < _BETWEEN * steps[k]:
            found.append(numbers[k + 1])
    return found
