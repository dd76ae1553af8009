"""The paper's table, and the one by strata, as text, Markdown and CSV, with intervals by bootstrap over frames."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_lib.evaluate.records import Record, write_record
from omnistereo_lib.evaluate.strata import FIGURES, STRATA, SUMS, figures
from omnistereo_lib.files import atomic_write, make_folder
from omnistereo_lib.stereo.methods import Method

LIGHTS = ("sunny", "cloudy", "sunset")  # the paper's order
_RESAMPLES, _SEED = 10_000, 0


@dataclass(frozen=True)
class Table:
    """Rows of figures with their intervals.

    Attributes
    ----------
    heads : list of str
        What the first columns say in words.
    columns : list of str
        What the figures are.
    rows : list of (list of str, array)
        The words, and the figures (columns, 3): value, lower and upper end; NaN is left open.
    caption : str
        What all rows have in common.
    """

    heads: list[str]
    columns: list[str]
    rows: list[tuple[list[str], NDArray[np.float64]]]
    caption: str = ""

    def text(self) -> str:
        """Return the table as aligned text, the intervals on a line of their own."""
        lines = [[*self.heads, *self.columns]]
        for words, cells in self.rows:
            lines.append([*words, *(self._value(k, cell[0]) for k, cell in enumerate(cells))])
            lines.append([*("" for _ in words), *(self._interval(k, cell) for k, cell in enumerate(cells))])
        widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
        align = [str.ljust] * len(self.heads) + [str.rjust] * len(self.columns)
        rows = ["  ".join(a(*pair) for a, *pair in zip(align, line, widths, strict=True)).rstrip() for line in lines]
        return "".join(f"{row}\n" for row in [*rows, self.caption] if row)

    def markdown(self) -> str:
        """Return the table in Markdown, the intervals below the figures."""
        lines = [[*self.heads, *(column.replace(">", "&gt;") for column in self.columns)]]
        lines.append(["---"] * len(self.heads) + ["---:"] * len(self.columns))
        for words, cells in self.rows:
            both = ((self._value(k, cell[0]), self._interval(k, cell)) for k, cell in enumerate(cells))
            lines.append(
                [*words, *(f"{value}<br><sub>{interval}</sub>" if interval else value for value, interval in both)]
            )
        return "".join(f"| {' | '.join(line)} |\n" for line in lines) + (f"\n{self.caption}\n" if self.caption else "")

    def csv(self) -> str:
        """Return the table as comma-separated values with six digits, three columns for each figure."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        ends = [f"{column}{end}" for column in self.columns for end in ("", " low", " high")]
        writer.writerow([*self.heads, *ends])
        for words, cells in self.rows:
            writer.writerow([*words, *("" if np.isnan(x) else f"{x:.6g}" for x in cells.ravel())])
        return file.getvalue()

    def _value(self, column: int, value: float) -> str:
        """Return a figure, percents of rays as the paper prints them, errors with a digit more."""
        return "–" if np.isnan(value) else f"{value:.{1 if '>' in self.columns[column] else 2}f}"

    def _interval(self, column: int, cell: NDArray[np.float64]) -> str:
        return "" if np.isnan(cell[1]) else "–".join(self._value(column, end) for end in cell[1:])


def bootstrap(
    samples: ArrayLike, statistic: Callable[[NDArray], NDArray], level: float = 0.95, count: int = _RESAMPLES
) -> NDArray[np.float64]:
    """Return a statistic of frames and its interval by percentile bootstrap (Efron 1979).

    Parameters
    ----------
    samples : array, shape (frames, K)
        What is known of each frame.
    statistic : callable
        Takes the mean of samples over frames, (..., K), and returns the statistic, (..., C).
    level : float
        Share of resamples, drawn with replacement, within the interval. Of few frames it is too narrow: the true
        mean of 8 normal values is in about 89 % of such intervals of 95 %.
    count : int
        Number of resamples; their seed is always the same.

    Returns
    -------
    array, shape (C, 3)
        Statistic, lower and upper end. The ends are NaN with fewer than two frames.
    """
    samples = np.asarray(samples, np.float64)
    value, n = statistic(samples.mean(0)), len(samples)
    if n < 2:
        return np.stack([value, np.full_like(value, np.nan), np.full_like(value, np.nan)], -1)
    times = np.random.default_rng(_SEED).multinomial(n, np.full(n, 1 / n), count)  # how often a frame is drawn
    drawn = statistic(times @ samples / n)
    low, high = np.nanpercentile(drawn, [50 - 50 * level, 50 + 50 * level], axis=0)
    return np.stack([value, low, high], -1)


def errors_table(results: Record) -> Table:
    """Return the paper's table: for each method and set the five figures, means over the frames.

    Frames of which no ray can be evaluated are left out.
    """
    sets = _sets(results)
    rows = []
    for method in _methods(results):
        cells = [_mean_figures(results["frames"][name], method.name) for name in sets]
        rows.append(([method.label], np.concatenate(cells)))
    columns = [f"{name.capitalize()} {figure}" for name in sets for figure in FIGURES]
    return Table(["method"], columns, rows, _caption(results, "Means over frames"))


def strata_table(results: Record) -> Table:
    """Return the five figures of all rays of each stratum, of all frames of a set together."""
    methods, rows = _methods(results), []
    for name in _sets(results):
        frames = results["frames"][name].values()
        for stratum in _strata(frames, methods[0].name):
            for method in methods:
                sums = [frame[method.name]["strata"] for frame in frames]
                samples = np.array([[frame[stratum][key] for key in SUMS] for frame in sums])
                rays = samples[:, 0].sum()
                if rays > 0:
                    share = 100 * rays / sum(frame["all"]["rays"] for frame in sums)
                    rows.append(([name, stratum, f"{share:.1f} %", method.label], bootstrap(samples, figures)))
    caption = _caption(results, "All rays of all frames together")
    return Table(["set", "stratum", "rays", "method"], list(FIGURES), rows, caption)


def write_results(folder: str | Path, results: Record) -> list[str]:
    """Write results.json and both tables in three forms; return the names of the files.

    Raises
    ------
    OmnistereoError
        If the folder cannot be written.
    """
    folder = make_folder(folder)
    write_record(folder / "results.json", results)
    texts = {}
    for name, table in (("errors", errors_table(results)), ("strata", strata_table(results))):
        texts |= {f"{name}.txt": table.text(), f"{name}.md": table.markdown(), f"{name}.csv": table.csv()}
    for name, text in texts.items():
        with atomic_write(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return ["results.json", *texts]


def _caption(results: Record, what: str) -> str:
    config, default = results["config"], Method(cost="zncc")
    frames = ", ".join(f"{len(results['frames'][name])} of {name}" for name in _sets(results))
    rig = "" if config["rig"] == "own" else f" Not the sets' own rig, but {config['rig'][:12]}…."
    return (
        f"{what} ({frames}), in % of the N spheres swept, with 95 % intervals by bootstrap over frames. "
        f"{config['width']} × {config['height']}, N = {config['num_spheres']}, pairs = {default.pairs}, "
        f"p1 = {default.p1}, p2 = {default.p2}, whole indices, unless a row says otherwise.{rig}"
    )


def _mean_figures(frames: Record, method: str) -> NDArray[np.float64]:
    """Return the five figures with their intervals, (5, 3)."""
    found = [[frame[method]["figures"][figure] for figure in FIGURES] for frame in frames.values()]
    known = [row for row in found if None not in row]
    return bootstrap(known, lambda mean: mean) if known else np.full((len(FIGURES), 3), np.nan)


def _strata(frames: Iterable[Record], method: str) -> list[str]:
    names = next(iter(frames))[method]["strata"]
    return [*STRATA, *sorted(names.keys() - {*STRATA})]


def _sets(results: Record) -> list[str]:
    """Return the names of the sets, the paper's first and in its order."""
    return [*(name for name in LIGHTS if name in results["frames"]), *sorted(set(results["frames"]) - {*LIGHTS})]


def _methods(results: Record) -> list[Method]:
    """Return the methods in the order of the paper's table."""
    return sorted((Method(**settings) for settings in results["methods"].values()), key=lambda method: method.sort_key)
