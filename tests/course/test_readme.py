"""The README: its table and picture as they are made, its links alive."""

import re

import cv2
import numpy as np
import pytest

from course import nbtools, readme

TEXT = readme.README.read_text(encoding="utf-8")


def test_it_lists_the_notebooks():
    assert readme.with_table(TEXT, nbtools.notebooks()) == TEXT, "python -m course readme"


@pytest.mark.parametrize("page", ["README.md", *sorted(f"book/{path.name}" for path in nbtools.ROOT.glob("book/*.md"))])
def test_every_file_that_it_links_to_is_there(page):
    path = nbtools.ROOT / page
    links = re.findall(r"\]\(([^)#:]+\.(?:md|ipynb|jpg|webp|cff))", path.read_text(encoding="utf-8"))
    made = {"rig.png", "camera.jpg", "panorama.jpg", "spheres.png"}  # with the book
    folders = (path.parent, nbtools.ROOT)  # the book's pages and the notebooks meet in one folder
    assert [
        link for link in links if link not in made and not any((folder / link).exists() for folder in folders)
    ] == []


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


def _jpeg(picture):
    return cv2.imencode(".jpg", picture)[1].tobytes()
