"""The pages of Markdown: lists and pictures as they are made, links that work on a code host."""

import base64
import json
import re
import shutil
import zlib

import cv2
import numpy as np
import pytest

import omnistereo_lib as osl
from course import nbtools
from omnistereo_tools.output import viewer
from workshop.publish import notation as figures
from workshop.publish import pages, readme

ROOT = nbtools.ROOT
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "book").glob("*.md"))]
TEXTS = {path: path.read_text(encoding="utf-8") for path in PAGES}
each_page = pytest.mark.parametrize(
    "path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix()
)


@each_page
def test_its_lists_are_as_they_are_made(path):
    assert pages.with_lists(TEXTS[path]) == TEXTS[path], "python -m workshop pages"


def test_every_list_is_on_a_page():
    assert sorted(
        name for text in TEXTS.values() for name, _ in pages.LIST.findall(text)
    ) == sorted(pages.LISTS)


@each_page
def test_every_link_leads_to_a_file_and_a_heading_of_the_clone(path):
    links = re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", without_code(TEXTS[path]))
    assert [name for name, _ in links if not (path.parent / name).exists()] == []
    fragments = [
        ((path.parent / name).resolve() if name else path, heading)
        for name, heading in links
        if heading
    ]
    assert [heading for target, heading in fragments if heading not in headings(target)] == []


@each_page
def test_a_code_host_shows_all_of_it(path):
    """No role or directive, which only the website knows; no place for a program to fill."""
    text = without_code(TEXTS[path])
    assert re.findall(r"\{\w+\}`|^```+\{|^:::", text, re.MULTILINE) == []
    left = re.findall(r"<!-- (.*?) -->", text, re.DOTALL)
    assert [
        note
        for note in left
        if not note.startswith("not run: ")
        and note.strip("/ ") not in {*pages.LISTS, "mistakes-planted"}
    ] == []


def without_code(text):
    return re.sub(r"^```\w+\n.*?^```$|`[^`\n]+`", "", text, flags=re.DOTALL | re.MULTILINE)


def headings(path):
    """The anchors of a page's headings, as code hosts and the website make them."""
    titles = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_the_figures_of_the_notation_are_as_they_are_drawn(tmp_path):
    for name, drawn in figures.draw_figures().items():
        shutil.copy(ROOT / "book" / name, tmp_path)
        assert not readme.renew(tmp_path / name, drawn), f"{name}: python -m workshop pages"


def test_the_picture_is_written_only_when_it_shows_something_else(tmp_path):
    rng = np.random.default_rng(0)
    shown = cv2.GaussianBlur(rng.uniform(0, 255, (60, 80, 3)), (0, 0), 3).astype(np.uint8)
    path = tmp_path / "picture.jpg"
    first = _jpeg(shown)
    path.write_bytes(first)
    speck = shown.copy()
    speck[30, 40] += 9
    readme.renew(path, _jpeg(speck))
    assert _jpeg(speck) != first and path.read_bytes() == first
    readme.renew(path, _jpeg(255 - shown))
    assert path.read_bytes() == _jpeg(255 - shown)


def test_its_viewer_is_what_omnistereo_depth_writes():
    page = readme.STREET.read_text(encoding="utf-8")
    data = readme.data_of(page)
    assert viewer.page_of(data) == page, "python -m workshop pages"
    told = json.loads(json.dumps(readme.for_the_page()))  # what its script explains a ray by
    assert data["ray"] == told, "python -m workshop pages"
    sample = osl.load_dataset("omnistereo_lib/sample")
    grid = osl.SphereGrid(
        640, 320, phi_deg=(-90, 90), num_spheres=192, min_depth=sample.rig.min_depth
    )
    assert data["title"] == "Depth from 4 cameras by VolumeNet"
    exact = sample[0].gt_index(grid)
    estimate, truth = (
        grid.inverse_depth_to_index(inverse_depth(data, name)) for name in ("steps", "truth")
    )
    np.testing.assert_allclose(truth, exact, atol=0.01)
    assert np.nanmean(np.abs(estimate - exact)) * 100 / 192 < 1.3  # percent, as `make depth` prints
    assert len(data["cameras"]) == 4 and len(page.encode()) < 1_500_000


def inverse_depth(data, name):
    planes = np.frombuffer(zlib.decompress(base64.b64decode(data[name])), np.uint8)
    low, high = planes.reshape(2, data["height"], data["width"]).astype(np.uint16)
    steps = np.cumsum(low + 256 * high, axis=1, dtype=np.uint16)
    return np.where(steps > 0, (steps - 1.0) * data["perStep"], np.nan)


def _jpeg(picture):
    return cv2.imencode(".jpg", picture)[1].tobytes()
