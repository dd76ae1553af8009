"""Result tables, as in Table II and by region: text, Markdown, CSV, bootstrap intervals."""

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from omnistereo_learn.evaluate.methods import EvaluatedMethod
from omnistereo_learn.evaluate.records import Record, write_record
from omnistereo_learn.evaluate.regions import METRICS, REGIONS, SUMS, sums_to_metrics
from omnistereo_lib.files import make_folder, write_text
from omnistereo_lib.geometry.pose import Floats
from omnistereo_lib.stereo.methods import penalties
from omnistereo_lib.stereo.zncc import default_window

WITHOUT_SKY = "without sky"
LIGHTS = ("sunny", "cloudy", "sunset")  # the paper's order
_RESAMPLES = 10_000


@dataclass(frozen=True)
class Table:
    """Rows of words, under `heads`, and numbers, under `columns`: (columns, 3), value and ends.

    NaN is left open. The caption has the settings of all rows.
    """

    heads: list[str]
    columns: list[str]
    rows: list[tuple[list[str], Floats]]
    caption: str = ""

    def text(self) -> str:
        """Return the table as aligned text, the intervals on a line of their own."""
        lines = [[*self.heads, *self.columns]]
        for words, cells in self.rows:
            values, intervals = self._texts(cells)
            lines += [[*words, *values], [*[""] * len(words), *intervals]]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        align = [str.ljust] * len(self.heads) + [str.rjust] * len(self.columns)
        rows = [
            "  ".join(
                pad(cell, width) for pad, cell, width in zip(align, line, widths, strict=True)
            ).rstrip()
            for line in lines
        ]
        return "".join(f"{row}\n" for row in [*rows, self.caption] if row)

    def markdown(self) -> str:
        """Return the table in Markdown, the intervals below the values."""
        lines = [[*self.heads, *(column.replace(">", "&gt;") for column in self.columns)]]
        lines.append(["---"] * len(self.heads) + ["---:"] * len(self.columns))
        for words, cells in self.rows:
            pairs = zip(*self._texts(cells), strict=True)
            lines.append(
                [
                    *words,
                    *(f"{value}<br><sub>{ends}</sub>" if ends else value for value, ends in pairs),
                ]
            )
        return "".join(f"| {' | '.join(line)} |\n" for line in lines) + (
            f"\n{self.caption}\n" if self.caption else ""
        )

    def csv(self) -> str:
        """Return the table as CSV with six digits, three columns for each number."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            [
                *self.heads,
                *(f"{column}{end}" for column in self.columns for end in ("", " low", " high")),
            ]
        )
        for words, cells in self.rows:
            writer.writerow([*words, *("" if np.isnan(x) else f"{x:.6g}" for x in cells.ravel())])
        return file.getvalue()

    def _texts(self, cells: Floats) -> tuple[list[str], list[str]]:
        """Return values and intervals, percents with the paper's digits, errors with one more."""
        texts = [
            ["" if np.isnan(x) else f"{x:.{1 if '>' in column else 2}f}" for x in cell]
            for column, cell in zip(self.columns, cells, strict=True)
        ]
        return [c[0] or "–" for c in texts], ["–".join(filter(None, c[1:])) for c in texts]


def bootstrap(samples: ArrayLike, statistic: Callable[[NDArray[Any]], NDArray[Any]]) -> Floats:
    """Return a statistic of frames with its percentile bootstrap interval of 95 %, (C, 3).

    `samples` has shape (frames, K); `statistic` maps its mean over frames, (..., K), to (..., C).
    Frames are drawn with replacement and a fixed seed (Efron 1979). With few frames the interval is
    too narrow: the true mean of 8 normal values is in about 89 % of them. The ends are NaN with
    fewer than two frames.
    """
    samples = np.asarray(samples, np.float64)
    value, n = statistic(samples.mean(0)), len(samples)
    if n < 2:
        return np.stack([value, *np.full((2, *value.shape), np.nan)], -1)
    # how often a frame is drawn
    times = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), _RESAMPLES)
    drawn = statistic(times @ samples / n)
    low, high = np.nanpercentile(drawn, [2.5, 97.5], axis=0)
    return np.stack([value, low, high], -1)


def errors_table(results: Record) -> Table:
    """Return the table of the paper (Table II): each method and set, means over the frames.

    Frames without rays to evaluate are left out.
    """
    sets = _sets(results)
    rows = []
    for method in _methods(results):
        cells = []
        for frames in (results["frames"][name].values() for name in sets):
            found = [[frame[method.name]["figures"][key] for key in METRICS] for frame in frames]
            known = [row for row in found if None not in row]
            cells.append(
                bootstrap(known, lambda mean: mean) if known else np.full((len(METRICS), 3), np.nan)
            )
        rows.append(([method.label], np.concatenate(cells)))
    columns = [f"{name.capitalize()} {metric}" for name in sets for metric in METRICS]
    return Table(["method"], columns, rows, _caption(results, "Means over frames"))


def regions_table(results: Record) -> Table:
    """Return the metrics of all rays of each region, of all but the sky, of a set's frames."""
    methods, rows = _methods(results), []
    for name in _sets(results):
        frames = results["frames"][name].values()
        found = set().union(*(frame[methods[0].name]["strata"] for frame in frames))
        for region in ["all", WITHOUT_SKY, *REGIONS[1:], *sorted(found - {*REGIONS})]:
            for method in methods:
                sums = [frame[method.name]["strata"] for frame in frames]
                samples = np.array([_sums(frame, region) for frame in sums])
                rays = samples[:, 0].sum()
                if rays > 0:
                    percent = 100 * rays / sum(frame["all"]["rays"] for frame in sums)
                    words = [name, region, f"{percent:.1f} %", method.label]
                    rows.append((words, bootstrap(samples, sums_to_metrics)))
    caption = _caption(results, "All rays of all frames together")
    return Table(["set", "region", "rays", "method"], list(METRICS), rows, caption)


def _sums(regions: dict[str, dict[str, float]], name: str) -> Floats:
    """Return the `SUMS` of a region; without the sky, of all rays less those of the sky.

    A frame of fewer cameras has no rays that are seen by more.
    """
    if name == WITHOUT_SKY:
        return _sums(regions, "all") - _sums(regions, "sky")
    return np.array([regions.get(name, dict.fromkeys(SUMS, 0))[key] for key in SUMS], np.float64)


def write_results(folder: str | Path, results: Record) -> list[str]:
    """Write results.json and both tables in three formats; return the names of the files."""
    folder = make_folder(folder)
    write_record(folder / "results.json", results)
    texts: dict[str, str] = {}
    for name, table in (("errors", errors_table(results)), ("regions", regions_table(results))):
        texts |= {
            f"{name}.txt": table.text(),
            f"{name}.md": table.markdown(),
            f"{name}.csv": table.csv(),
        }
    for name, text in texts.items():
        write_text(folder / name, text)
    return ["results.json", *texts]


def _caption(results: Record, what: str) -> str:
    config, default = results["config"], EvaluatedMethod(cost="zncc")
    frames = ", ".join(f"{len(results['frames'][name])} of {name}" for name in _sets(results))
    p1, p2 = penalties(config["width"], config["num_spheres"])
    rig = "" if config["rig"] == "own" else f" Not the sets' own rig, but {config['rig'][:12]}…."
    return (
        f"{what} ({frames}), in % of the N spheres swept, with 95 % intervals by bootstrap over"
        f" frames. {config['width']} × {config['height']}, N = {config['num_spheres']}, pairs ="
        f" {default.pairs}, window = {default_window(config['width'])}, p1 = {p1:.2g}, p2 ="
        f" {p2:.2g}, whole indices, unless a row says otherwise.{rig}"
    )


def _sets(results: Record) -> list[str]:
    """Return the names of the sets, those of the paper first and in its order."""
    return [
        *(name for name in LIGHTS if name in results["frames"]),
        *sorted(set(results["frames"]) - {*LIGHTS}),
    ]


def _methods(results: Record) -> list[EvaluatedMethod]:
    """Return the methods in the order of Table II."""
    methods = (EvaluatedMethod(**settings) for settings in results["methods"].values())
    return sorted(methods, key=lambda method: method.sort_key)
