"""Where the board of the calibration captures is, who sees it, its corners; only NumPy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats, Pose
from workshop.render.camera.lens import MAX_FOV_DEG, REFERENCE_HEIGHT, REFERENCE_WIDTH, Lens
from workshop.render.camera.render_rig import RenderRig, RigCamera, make_rig

COLUMNS, ROWS, SQUARE = 12, 10, 0.060  # the paper's board: inner corners, metres
MARGIN = 0.020  # white around the outer squares
_MIDDLE = np.array([(COLUMNS - 1) / 2 * SQUARE, (ROWS - 1) / 2 * SQUARE, 0.0])

ROOM = np.array([[-4.3, -3.7, 0.0], [3.9, 4.1, 3.5]])  # opposite corners in the world, z up
T_WORLD_RIG = Pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, 0.0, 1.7]))
ARM = 0.12  # from the back of the board to its pole
STAND = _MIDDLE + np.array([0, 0, ARM])  # where the pole begins, in the board's frame

_WIDEST_DEG = 109.5  # from the axis, for the edge of the board; the field ends at 110°
_LEGIBLE_PX = 7.0  # between neighbouring corners
_CLEARANCE = 0.20  # between the board or its pole and any camera
_TRIES = 2000
_MISTAKES = ("blurred", "cut", "moved")


@dataclass(frozen=True)
class CaptureSet:
    """How many captures of which rig.

    Attributes:
        rim, field: Boards for each camera: at the rim of its field all around, and elsewhere.
        shared: Boards between each two neighbours.
        mistakes: Captures with each mistake: the board sways during the exposure ("blurred"),
            leaves the field ("cut"), or has moved when the second camera takes its picture
            ("moved").
        size: Width and height of the pictures.
        samples: Paths for each pixel.
    """

    rig: str
    rim: int
    field: int
    shared: int
    mistakes: int = 0
    size: tuple[int, int] = (800, 768)
    samples: int = 32
    first: int = 1

    @property
    def count(self) -> int:
        """How many captures there are."""
        return 4 * (self.rim + self.field + self.shared) + len(_MISTAKES) * self.mistakes

    @property
    def shipped(self) -> tuple[int, ...]:
        """Numbers of the captures that are rendered unless others are asked for: all."""
        return tuple(range(self.first, self.first + self.count))


CAPTURES = {
    "calibration/van": CaptureSet("van", rim=8, field=4, shared=4),
    "calibration/handheld": CaptureSet("handheld", rim=7, field=4, shared=2),
    "calibration/mistakes": CaptureSet("handheld", rim=4, field=3, shared=1, mistakes=2),
}


@dataclass(frozen=True, eq=False)
class Capture:
    """One moment.

    Attributes:
        T_rig_board: Camera number, from 1 → where the board stood when that camera took its
            picture: the same for all, unless the board was moved. Board frame: x right and y down
            as seen from the front, z into the board; the first inner corner is the origin.
        sway (array, shape (6,)): Axis-angle and metres that the board moves about its middle while
            the shutters are open.
    """

    T_rig_board: dict[int, Pose]
    sway: Floats
    mistake: str | None = None

    def pose(self, camera: int, moment: float) -> Pose:
        """Return T_rig_board at a moment of a camera's exposure, from −1/2 to 1/2."""
        return self.T_rig_board[camera] @ _about_middle(moment * self.sway)


def board_corners() -> Floats:
    """Return the inner corners in the board's frame, (120, 3): row by row."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS]
    return SQUARE * np.stack([columns, rows, 0 * rows], -1).reshape(-1, 3).astype(float)


def _outline() -> Floats:
    """Return points all along the edge of the board."""
    low, high = -SQUARE - MARGIN, np.array([COLUMNS, ROWS]) * SQUARE + MARGIN
    steps = np.linspace(0, 1, 9)[:-1]
    ends = np.array([[low, low], [high[0], low], [high[0], high[1]], [low, high[1]]])
    edges = ends[:, None] + steps[:, None] * (np.roll(ends, -1, axis=0) - ends)[:, None]
    return np.pad(edges.reshape(-1, 2), ((0, 0), (0, 1)))


_CORNERS, _OUTLINE = board_corners(), _outline()


def project(lens: Lens, points: ArrayLike, width: int = REFERENCE_WIDTH) -> tuple[NDArray, NDArray]:
    """Project with the lens itself, not with a polynomial that was fitted to it.

    Args:
        points (array, shape (..., 3)): Camera frame, metres.
        width: Of the picture, pixels.

    Returns:
        uv (array, shape (..., 2)): Pixels.
        theta (array, shape (...)): Angle from the axis, radians.
    """
    x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
    across = np.hypot(x, y)
    theta = np.arctan2(across, z)
    ratio = lens.radius(theta) / np.maximum(across, 1e-12)
    uv = np.stack([x * ratio, y * ratio], -1) + lens.center
    return (uv + 0.5) * (width / REFERENCE_WIDTH) - 0.5, theta


def true_corners(camera: RigCamera, T_rig_board: Pose, width: int = REFERENCE_WIDTH) -> Floats:
    """Return where a camera sees the corners, shape (120, 2) in pixels; NaN outside its field."""
    uv, theta = project(camera.lens, camera.T_rig_cam.inverse() @ T_rig_board @ _CORNERS, width)
    return np.where((theta <= np.radians(MAX_FOV_DEG / 2))[:, None], uv, np.nan)


# Which boards can be used


def sees(camera: RigCamera, T_rig_board: Pose) -> bool:
    """Return whether a camera sees the whole front of the board, its squares large enough."""
    T_cam_board = camera.T_rig_cam.inverse() @ T_rig_board
    uv, theta = project(camera.lens, T_cam_board @ _OUTLINE)
    if T_cam_board.inverse().t[2] >= 0 or theta.max() > np.radians(_WIDEST_DEG):
        return False
    inside = (uv >= 2).all() and (uv <= (REFERENCE_WIDTH - 3, REFERENCE_HEIGHT - 3)).all()
    return bool(inside and _spacing(camera, T_rig_board) >= _LEGIBLE_PX)


def _spacing(camera: RigCamera, T_rig_board: Pose) -> float:
    """Return the smallest distance between neighbouring visible corners in the picture."""
    grid = true_corners(camera, T_rig_board).reshape(ROWS, COLUMNS, 2)
    steps = (np.linalg.norm(np.diff(grid, axis=axis), axis=-1) for axis in (0, 1))
    return float(min(map(np.nanmin, steps)))


def stands_clear(rig: RenderRig, T_rig_board: Pose) -> bool:
    """Return whether board and pole are in the room and away from all cameras."""
    T_world_board = T_WORLD_RIG @ T_rig_board
    points = T_world_board @ np.concatenate([_OUTLINE, [STAND]])
    if not ((points > ROOM[0] + 0.1) & (points < ROOM[1] - 0.1)).all():
        return False
    eyes = np.stack([T_WORLD_RIG @ camera.T_rig_cam.t for camera in rig.cameras])
    on_board = T_world_board.inverse() @ eyes
    nearest = np.clip(on_board, _OUTLINE.min(0), _OUTLINE.max(0))
    from_board = np.linalg.norm(on_board - nearest, axis=1)
    from_pole = np.linalg.norm(eyes[:, :2] - points[-1, :2], axis=1)
    return bool(min(from_board.min(), from_pole.min()) > _CLEARANCE)


# Where the boards stand


@lru_cache
def plan_captures(captures: CaptureSet, seed: int) -> tuple[Capture, ...]:
    """Return the captures of a set in their order; the first has the number `captures.first`."""
    return tuple(_Planner(captures, seed).plan())


class _Planner:
    """Draws boards at random until each fulfils what its place asks for."""

    def __init__(self, captures: CaptureSet, seed: int) -> None:
        self.captures, self.rig = captures, make_rig(seed, captures.rig)
        self.rng = np.random.default_rng([seed, 30, len(captures.rig), captures.mistakes])

    def plan(self) -> list[Capture]:
        wanted = self.captures
        rim, field = wanted.rim, wanted.field
        boards = [self._at_the_rim(c, k / rim) for c in range(4) for k in range(rim)]
        boards += [self._in_the_field(c, k / field) for c in range(4) for k in range(field)]
        boards += [self._between(c) for c in range(4) for _ in range(wanted.shared)]
        plan = [self._capture(board) for board in boards]
        for k in range(wanted.mistakes):
            plan += [self._blurred(k), self._cut(k), self._moved(k)]
        return [plan[i] for i in self.rng.permutation(len(plan))]

    def _capture(
        self, T_rig_board: Pose, sway: ArrayLike = (0,) * 6, mistake: str | None = None
    ) -> Capture:
        rig = enumerate(self.rig.cameras, start=1)
        seen = [i for i, camera in rig if sees(camera, T_rig_board)]
        return Capture(dict.fromkeys(seen, T_rig_board), np.asarray(sway, float), mistake)

    # Places

    def _at_the_rim(self, c: int, turn: float) -> Pose:
        """Move a board to the edge of the view; `turn`, 0 to 1, says where along it."""
        camera = self.rig.cameras[c]
        for _ in range(_TRIES):
            azimuth = 2 * np.pi * turn + self.rng.uniform(-0.15, 0.15)
            roll = self.rng.integers(4) * np.pi / 2 - azimuth + self.rng.uniform(-0.25, 0.25)
            distance, tilt = self.rng.uniform(0.50, 0.70), self.rng.uniform(0, 0.6)
            about = self._angle()
            for theta in np.radians(np.arange(100, 50, -1)):
                board = _before(camera, theta, azimuth, distance, roll, tilt, about)
                if sees(camera, board) and stands_clear(self.rig, board):
                    break
            else:
                continue
            if _largest_angle(camera, board) > np.radians(102):
                return board
        raise OmnistereoError(f"no board reaches the rim of camera {c + 1}: another seed may do")

    def _in_the_field(self, c: int, share: float) -> Pose:
        """Put a board before a camera, further from the axis for a larger `share`; the last far."""
        last = share >= 1 - 1.5 / self.captures.field
        nearest, farthest = (1.2, 1.6) if last else (0.45, 0.9)

        def draw() -> Pose:
            theta = np.radians(70 * share + self.rng.uniform(0, 15))
            distance = self.rng.uniform(nearest, farthest)
            tilt, azimuth, roll = self.rng.uniform(0, np.radians(50)), self._angle(), self._angle()
            camera = self.rig.cameras[c]
            return _before(camera, theta, azimuth, distance, roll, tilt, self._angle())

        return self._draw(draw, [c])

    def _between(self, c: int) -> Pose:
        """Put a board on the diagonal between a camera and the next, so that both see it."""
        following = (c + 1) % 4
        a, b = (self.rig.cameras[i].T_rig_cam for i in (c, following))
        forward = a.R[:, 2] + b.R[:, 2]
        apart = np.linalg.norm(a.t - b.t)

        def draw() -> Pose:
            between = (a.t + b.t) / 2
            away = forward / np.linalg.norm(forward) * (self.rng.uniform(0.35, 0.75) + 0.2 * apart)
            along = (a.t - b.t) * self.rng.uniform(-0.2, 0.2) + (0, self.rng.uniform(-0.5, 0.5), 0)
            center = between + away + along
            roll, tilt = self._angle(), self.rng.uniform(0, np.radians(30))
            return _facing(center, between, roll, tilt, self._angle())

        return self._draw(draw, [c, following])

    def _angle(self) -> float:
        return float(self.rng.uniform(0, 2 * np.pi))

    def _draw(self, draw: object, cameras: list[int]) -> Pose:
        for _ in range(_TRIES):
            board = draw()
            seen = all(sees(self.rig.cameras[c], board) for c in cameras)
            if seen and stands_clear(self.rig, board):
                return board
        names = [c + 1 for c in cameras]
        raise OmnistereoError(f"no board is in view of cameras {names}: another seed may do")

    # Mistakes

    def _motion(self, metres: float, degrees: float) -> Floats:
        directions = self.rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.round((directions * [[np.radians(degrees)], [metres]]).ravel(), 6)

    def _blurred(self, k: int) -> Capture:
        board = self._between(k % 4) if k % 2 else self._in_the_field(k % 4, 0.3)
        return self._capture(board, self._motion(0.02 + 0.01 * k, 2.0), "blurred")

    def _cut(self, k: int) -> Capture:
        """Let a third to a tenth of the corners leave the field."""
        camera = self.rig.cameras[k % 4]
        for _ in range(_TRIES):
            theta, distance = np.radians(self.rng.uniform(80, 105)), self.rng.uniform(0.5, 0.8)
            azimuth, roll, about = self._angle(), self._angle(), self._angle()
            board = _before(camera, theta, azimuth, distance, roll, 0.2, about)
            missing = np.isnan(true_corners(camera, board)[:, 0]).mean()
            legible = 0.1 < missing < 0.35 and _spacing(camera, board) > _LEGIBLE_PX
            if legible and stands_clear(self.rig, board):
                return Capture({k % 4 + 1: board}, np.zeros(6), "cut")
        raise OmnistereoError(
            f"no board leaves the field of camera {k % 4 + 1}: another seed may do"
        )

    def _moved(self, k: int) -> Capture:
        for _ in range(_TRIES):
            capture = self._capture(self._between((k + 1) % 4))
            first, *others = capture.T_rig_board
            moved = _rounded(capture.T_rig_board[first] @ _about_middle(self._motion(0.03, 5.0)))
            if all(sees(self.rig.cameras[i - 1], moved) for i in others):
                poses = {first: capture.T_rig_board[first], **dict.fromkeys(others, moved)}
                return Capture(poses, np.zeros(6), "moved")
        raise OmnistereoError("no moved board stays in view: another seed may do")


def _before(
    camera: RigCamera,
    theta: float,
    azimuth: float,
    distance: float,
    roll: float,
    tilt: float,
    about: float,
) -> Pose:
    """Return T_rig_board of a board in a direction from a camera, facing it but for `tilt`."""
    ray = np.array(
        [np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)]
    )
    # Turned from the axis to the ray along the meridian, so that a roll means the same all along
    # it.
    turned = Pose.from_vector([-theta * np.sin(azimuth), theta * np.cos(azimuth), 0, 0, 0, 0])
    R = turned.R @ _tilted(roll, tilt, about)
    return _rounded(camera.T_rig_cam @ Pose(R, distance * ray - R @ _MIDDLE))


def _facing(center: NDArray, viewer: NDArray, roll: float, tilt: float, about: float) -> Pose:
    """Return T_rig_board of a board at `centre` that faces a viewer but for `tilt`."""
    z = (center - viewer) / np.linalg.norm(center - viewer)
    x = np.cross([0, 1, 0], z)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], axis=1) @ _tilted(roll, tilt, about)
    return _rounded(Pose(R, center - R @ _MIDDLE))


def _tilted(roll: float, tilt: float, about: float) -> Floats:
    axis = tilt * np.array([np.cos(about), np.sin(about), 0])
    return Pose.from_vector([*axis, 0, 0, 0]).R @ Pose.from_vector([0, 0, roll, 0, 0, 0]).R


def _about_middle(motion: ArrayLike) -> Pose:
    middle = Pose(np.eye(3), _MIDDLE)
    return middle @ Pose.from_vector(motion) @ middle.inverse()


def _rounded(pose: Pose) -> Pose:
    """Return the pose that stands on file: to a micrometre and a microradian, exactly."""
    return Pose.from_vector(np.round(pose.as_vector(), 6))


def _largest_angle(camera: RigCamera, T_rig_board: Pose) -> float:
    return float(project(camera.lens, camera.T_rig_cam.inverse() @ T_rig_board @ _CORNERS)[1].max())
