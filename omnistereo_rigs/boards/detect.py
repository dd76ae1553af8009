"""Boards in images: in one, and in all those of a camera."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from numpy.typing import ArrayLike

from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.progress import Progress, counted, silent
from omnistereo_rigs.boards.board import Board, Gray, as_gray


def find_corners(image: ArrayLike, board: Board) -> Floats | None:
    """Find all inner corners of a checkerboard, or what is visible of a board of markers.

    Args:
        image (array, shape (H, W) or (H, W, 3)): uint8, or float in 0 to 255; colour in any order.

    Returns:
        array, shape (K, 2), or None: Pixels in the order of `board.points`; NaN for corners that
        are not visible.
    """
    return board.find_corners(as_gray(image))


def detect_views(
    images: Sequence[ArrayLike | None],
    board: Board,
    progress: Progress = silent,
    names: Sequence[str] | None = None,
) -> list[Floats | None]:
    """Find the board in each image of a camera, on all cores; None without image or board.

    Messages call views by `names`, or else by index.

    Raises:
        OmnistereoError: If an array is not an image, the images differ in size, or none shows the
            board; then it says which size of board would fit, if one does.
    """
    names = [str(k) for k in range(len(images))] if names is None else names
    grays: dict[int, Gray] = {}
    for k, image in enumerate(images):
        try:
            grays |= {} if image is None else {k: as_gray(image)}
        except OmnistereoError as error:
            raise OmnistereoError(f"view {names[k]}: {error}") from error
    # Of each size the first view that has it, so that a message can name two views that differ.
    sizes = {gray.shape[::-1]: names[k] for k, gray in reversed(grays.items())}
    if len(sizes) > 1:
        (second, b), (first, a) = list(sizes.items())[-2:]
        raise OmnistereoError(
            f"views {a} and {b} have different image sizes, {first} and {second} px; expected one"
            " size per camera. Pass the images as captured: not cropped, resized or rotated"
        )
    none = f"no board {board} found in {len(grays)} images. "
    if another := board.another([*grays.values()]):
        raise OmnistereoError(none + another)
    found: dict[int, Floats | None] = {}
    step = counted(progress, len(grays))
    # One image per thread; the results come in the order of the images.
    with ThreadPoolExecutor() as pool:
        for k, corners in zip(
            grays, pool.map(lambda gray: find_corners(gray, board), grays.values()), strict=True
        ):
            step("boards")
            found[k] = corners
    step("")
    if all(corners is None for corners in found.values()):
        raise OmnistereoError(none + board.advice([*grays.values()]))
    return [found.get(k) for k in range(len(images))]
