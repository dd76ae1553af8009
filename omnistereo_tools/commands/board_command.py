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
_A4 = 0.297, 0.21  # m


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
    # Axes in metres, y down, as large as the page: what is drawn is as large as it is. The page is
    # A4 where that holds the board, which is in its middle: other sizes tempt printers to scale.
    width, height = (columns + 1) * edge + 2 * _MARGIN, (rows + 1) * edge + 3 * _MARGIN
    fitting = (page for page in (_A4, _A4[::-1]) if width <= page[0] and height <= page[1])
    page = next(fitting, (width, height))
    figure = Figure(figsize=(page[0] / _INCH, page[1] / _INCH))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, page[0]), ylim=(page[1], 0))
    axes.set_axis_off()
    left, top = (page[0] - width) / 2 + _MARGIN, (page[1] - height) / 2 + _MARGIN
    for row in range(rows + 1):
        for column in range(row % 2, columns + 1, 2):
            axes.add_patch(_black((left + column * edge, top + row * edge), edge, edge))
    # Below it, from the left margin: a line to measure and what to do, then what was drawn.
    left, bottom = min(left, max(_MARGIN, page[0] / 2 - 0.9 * _BAR)), top + height - 2 * _MARGIN
    use = f"--board {columns}x{rows} --square {edge:g}"
    text, size = "Print at 100 %, not “fit to page”.", min(9, 9 * page[0] / 0.25)
    start = left
    if page[0] > 2 * _BAR:
        axes.add_patch(_black((left, bottom - 0.003), _BAR, 0.001))
        start, text = left + _BAR + 0.003, f"is 100 mm long. {text}"
    axes.text(start, bottom - 0.0025, text, fontsize=size, va="center")
    text = f"{columns} × {rows} inner corners, squares of {1000 * edge:g} mm: {use}"
    axes.text(left, bottom + 0.004, text, fontsize=size, va="center")
    save_figure(options.out, figure)
    sheet = f"{1000 * page[0]:.0f} × {1000 * page[1]:.0f} mm"
    print(f"Written: {columns} × {rows} inner corners on {sheet}.")
    print("Print it at 100 %, glue it onto something flat, measure a square, and pass:")
    print(use)


def _black(corner: tuple[float, float], width: float, height: float) -> Rectangle:
    from matplotlib.patches import Rectangle

    return Rectangle(corner, width, height, facecolor="black", edgecolor="none", clip_on=False)
