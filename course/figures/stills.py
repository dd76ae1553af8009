"""Stills: what the website and the slides show in place of live figures. `python -m workshop stills
notebooks/*.ipynb`.

The notebook runs with the environment variable `VARIABLE` set to a folder. Its live figures then
show nothing and write into that folder instead: an image for each of a few values of each slider,
or the data of the viewer. The file index.json lists them in order.
"""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from course.figures.dark_mode import picture
from omnistereo_lib.errors import OmnistereoError

if TYPE_CHECKING:
    from ipywidgets import Widget

STILLS = Path(__file__).resolve().parents[2] / "book" / "stills"
VARIABLE = "COURSE_STILLS"
LIVE = re.compile(r"^(interactive|pick_ray|explore)\(", re.MULTILINE)
SHOWN = "In Jupyter this computes; here it shows stored pictures, one slider at a time."
VIEW = "The points of a depth panorama, to rotate, tilt and zoom"
_WIDTH = 900  # pixels
_PLACES = {1: 7, 2: 5}  # number of sliders → stills of each


# --- Record


def recording() -> bool:
    """Tell whether live figures are to be stored."""
    return VARIABLE in os.environ


def record_sliders(draw: Callable[..., list[bytes]], sliders: dict[str, Widget]) -> None:
    """Store stills: `draw` returns the images for values of the sliders by name."""
    folder, index = _open()
    start = {name: slider.value for name, slider in sliders.items()}
    shown: list[dict[str, Any]] = []
    for name, slider in sliders.items():
        values = places(slider, _PLACES[len(sliders)])
        first = values.index(start[name])
        for place, value in enumerate(values):
            if place != first or not shown:  # all sliders share the first still
                still = _stack(draw(**start | {name: value}))
                still.save(folder / f"{len(index)}-{name}-{place}.webp", quality=36, method=6)
        entry = {"name": name, "values": values, "start": first}
        if names := {value: label for label, value in getattr(slider, "options", ())}:
            entry["labels"] = [names[value] for value in values]
        shown.append(entry)
    _close(folder, [*index, {"sliders": shown}])


def record_view(data: dict[str, Any]) -> None:
    """Store the data that a page of the viewer shows."""
    folder, index = _open()
    name = f"{len(index)}.json"
    (folder / name).write_text(json.dumps(data) + "\n", encoding="utf-8")
    _close(folder, [*index, {"view": name}])


def places(slider: Widget, count: int) -> list[float]:
    """Return about `count` even values of a slider, its present value among them."""
    base = getattr(slider, "base", None)  # logarithmic sliders have one
    if options := getattr(slider, "options", None):  # of a slider over labels: (label, value)
        stands, low, high, step = slider.index, 0, len(options) - 1, 1
    else:
        stands, low, high, step = slider.value, slider.min, slider.max, slider.step
    stands = np.log(stands) / np.log(base) if base else stands
    steps = round((high - low) / step)
    at = [low + step * round(k) for k in np.linspace(0, steps, min(count, steps + 1))]
    nearest = int(np.argmin(np.abs(np.array(at) - stands)))
    # both ends stay
    at[nearest if np.isclose(at[nearest], stands) else min(max(nearest, 1), len(at) - 2)] = stands
    if options:
        return [options[x][1] for x in at]
    values = [base**x if base else x for x in at]
    return [
        slider.value if x == stands else type(slider.value)(f"{v:.4g}")
        for x, v in zip(at, values, strict=True)
    ]


def _open() -> tuple[Path, list[Any]]:
    folder = Path(os.environ[VARIABLE])
    folder.mkdir(parents=True, exist_ok=True)
    index = folder / "index.json"
    return folder, json.loads(index.read_text(encoding="utf-8")) if index.exists() else []


def _close(folder: Path, index: list[Any]) -> None:
    (folder / "index.json").write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")


def _stack(pictures: list[bytes]) -> Image.Image:
    images = [Image.open(io.BytesIO(data)).convert("RGB") for data in pictures]
    sizes = [(_WIDTH, round(image.height * _WIDTH / image.width)) for image in images]
    images = [
        image.resize(size, Image.Resampling.LANCZOS)
        for image, size in zip(images, sizes, strict=True)
    ]
    stacked = Image.new("RGB", (_WIDTH, sum(image.height for image in images)))
    top = 0
    for image in images:
        stacked.paste(image, (0, top))
        top += image.height
    return stacked


# --- Show


def stored(stem: str) -> list[dict[str, Any]]:
    """Return the entries of index.json for the live figures of a notebook, in order."""
    index = STILLS / stem / "index.json"
    return json.loads(index.read_text(encoding="utf-8")) if index.exists() else []


def shown(stem: str, number: int, out: Path, up: str = "") -> str:
    """Write the stills or the viewer of one live figure into a folder; return the HTML that shows
    them.

    Args:
        stem: Name of the notebook, without ending.
        number: Number of the live figure, from 0.
        out: Folder of the website or of the slides.
        up: Path from the page to `out`: "../" or nothing.
    """
    if number >= len(stored(stem)):
        raise OmnistereoError(
            f"{stem}: live figure {number + 1} has no stills. Run: python -m workshop stills"
            f" notebooks/{stem}.ipynb"
        )
    about = stored(stem)[number]
    if "view" in about:
        from omnistereo_tools.output.viewer import page_of

        page = out / "views" / f"{stem}-{number}.html"
        page.parent.mkdir(parents=True, exist_ok=True)
        data = json.loads((STILLS / stem / about["view"]).read_text(encoding="utf-8"))
        page.write_text(page_of(data), encoding="utf-8")
        return (
            f'<iframe class="view" src="{up}views/{page.name}" title="{VIEW}"'
            ' loading="lazy"></iframe>'
        )
    rows, pictures = [], []
    for k, slider in enumerate(about["sliders"]):
        name, start = slider["name"], slider["start"]
        values = slider.get("labels") or [f"{value:.4g}" for value in slider["values"]]
        rows.append(
            f'<label><span>{name}</span> <input type="range" max="{len(values) - 1}"'
            f' value="{start}"'
            f" data-values='{json.dumps(values)}'> <output>{values[start]}</output></label>"
        )
        for place, value in enumerate(values):
            still = STILLS / stem / f"{number}-{name}-{place}.webp"
            if k == 0 or place != start:
                hidden = "" if place == start else " hidden"
                image = picture(
                    still.read_bytes(), f"The live figure at {name} = {value}", out, up, 1
                )
                pictures.append(
                    f'<div data-slider="{k}" data-place="{place}"{hidden}>{image}</div>'
                )
    return f'<div class="stills"><p>{SHOWN}</p>{"".join(rows)}{"".join(pictures)}</div>'
