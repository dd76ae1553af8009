"""The README: its table and picture as they are made, its links alive."""

import base64
import re
import zlib

import cv2
import numpy as np
import pytest

import omnistereo_lib as osl
from course import nbtools, readme
from omnistereo_tools import viewer

TEXT = readme.README.read_text(encoding="utf-8")


def test_it_lists_the_notebooks():
    assert readme.with_table(TEXT, nbtools.notebooks()) == TEXT, "python -m course readme"


@pytest.mark.parametrize("page", ["README.md", *sorted(f"book/{path.name}" for path in nbtools.ROOT.glob("book/*.md"))])
def test_every_file_that_it_links_to_is_there(page):
    path = nbtools.ROOT / page
    links = re.findall(r"\]\(([^)#:]+\.(?:md|ipynb|jpg|webp|html|cff))", path.read_text(encoding="utf-8"))
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


def test_its_viewer_is_what_omnistereo_depth_writes():
    page = readme.STREET.read_text(encoding="utf-8")
    data = readme.data_of(page)
    assert viewer.page_of(data) == page, "python -m course readme"
    sample = osl.load_dataset("omnistereo_lib/sample")
    grid = osl.SphereGrid(640, 320, phi_deg=(-90, 90), num_spheres=192, min_depth=sample.rig.min_depth)
    assert data["title"] == "volumenet: 4 cameras, 640 × 320 rays, 192 spheres"
    exact = sample[0].gt_index(grid)
    estimate, truth = (grid.inverse_depth_to_index(inverse_depth(data, name)) for name in ("steps", "truth"))
    np.testing.assert_allclose(truth, exact, atol=0.01)
    assert np.nanmean(np.abs(estimate - exact)) * 100 / 192 < 1.3  # percent, as `make depth` prints
    assert len(data["cameras"]) == 4 and len(page.encode()) < 1_000_000


def inverse_depth(data, name):
    planes = np.frombuffer(zlib.decompress(base64.b64decode(data[name])), np.uint8)
    low, high = planes.reshape(2, data["height"], data["width"]).astype(np.uint16)
    steps = np.cumsum(low + 256 * high, axis=1, dtype=np.uint16)
    return np.where(steps > 0, (steps - 1.0) * data["perStep"], np.nan)


def _jpeg(picture):
    return cv2.imencode(".jpg", picture)[1].tobytes()
