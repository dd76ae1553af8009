"""Draw a checkerboard to print in its true size, PDF or SVG.

Examples:
  omnistereo board board.pdf
      9 x 6 inner corners, which fit a sheet of A4
  omnistereo board large.svg --board 12x10 --square 0.06
      for a large print
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.commands.calibrate_command import read_board
from omnistereo_tools.parser import Options, option

if TYPE_CHECKING:
    from matplotlib.patches import Rectangle

_INCH = 0.0254  # m
_MARGIN = 0.011  # m of white around the squares, without which corners at the rim are not found
_BAR = 0.1  # m, to be measured on the print


@dataclass(frozen=True, kw_only=True)
class BoardOptions(Options):
    """Options of `omnistereo board`."""

    out: Path = option(
        "file to write", MISSING, positional=True, metavar="OUT", suffixes=(".pdf", ".svg")
    )
    board: str = option("inner corners, columns x rows", "9x6")
    square: float = option("edge of a square in metres", 0.025, between=(0.001, 1))


def run(options: BoardOptions) -> None:
    """Write the board, and say how to use it."""
    from matplotlib.figure import Figure

    from omnistereo_rigs.boards.checkerboard import Checkerboard
    from omnistereo_tools.outputs import save_figure

    board = read_board(options.board, options.square)
    if not isinstance(board, Checkerboard):
        raise OmnistereoError(f"--board is {options.board}; expected columns x rows, such as 9x6")
    (columns, rows), edge = board.corners, options.square
    # Axes in metres, y down, that fill a page of the same size: what is drawn is as large as it is.
    width, height = (columns + 1) * edge + 2 * _MARGIN, (rows + 1) * edge + 3 * _MARGIN
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    for row in range(rows + 1):
        for column in range(row % 2, columns + 1, 2):
            corner = (_MARGIN + column * edge, _MARGIN + row * edge)
            axes.add_patch(_black(corner, edge, edge))
    use = f"--board {columns}x{rows} --square {edge:g}"
    text = f"{columns} × {rows} inner corners, squares of {1000 * edge:g} mm: {use}"
    bottom = height - _MARGIN
    if width > _BAR + 2 * _MARGIN:
        axes.add_patch(_black((_MARGIN, bottom - 0.003), _BAR, 0.001))
        text += ". The line above is 100 mm long if the print is to scale."
    axes.text(_MARGIN, bottom + 0.004, text, fontsize=min(9, 9 * width / 0.25), va="center")
    save_figure(options.out, figure)
    print(
        f"Written: {columns} × {rows} inner corners on {1000 * width:.0f} × {1000 * height:.0f} mm."
    )
    print("Print it without scaling, glue it onto something flat, measure a square, and pass:")
    print(use)


def _black(corner: tuple[float, float], width: float, height: float) -> Rectangle:
    from matplotlib.patches import Rectangle

    return Rectangle(corner, width, height, facecolor="black", edgecolor="none", clip_on=False)
