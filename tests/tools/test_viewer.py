"""The viewer in a real browser, without any network: what it says is the depth."""

import re
from itertools import pairwise

import numpy as np
import pytest
import scene

import omnistereo_lib as osl
from omnistereo_lib.stereo.sweep import SphereSweep
from omnistereo_tools.points import Limits
from omnistereo_tools.viewer import page_of, viewer_data, viewer_page

GRID = osl.SphereGrid(160, 40, num_spheres=64, min_depth=0.6)


@pytest.fixture
def depth():
    rig = scene.rig(width=200, height=192)
    index = scene.true_index(rig, GRID).astype(np.float32)
    return osl.Depth(index, np.full_like(index, 0.75), SphereSweep(rig, GRID))


def test_it_looks_around_and_tells_the_depth(depth, open_page, tmp_path):
    panorama = np.full((80, 320, 3), (200, 60, 40), np.uint8)
    (tmp_path / "index.html").write_text(viewer_page(depth, panorama, Limits(50.0, 0.0), "a <box>"), encoding="utf-8")
    page = open_page(1200, 900)
    page.goto(f"file://{tmp_path}/index.html")
    page.wait_for_selector("body[data-drawn=look]")
    assert page.inner_text("#title") == "a <box>"
    middle = page.evaluate("[...document.getElementById('view').getContext('2d').getImageData(560, 315, 1, 1).data]")
    np.testing.assert_allclose(middle, [200, 60, 40, 255], atol=4)  # JPEG
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2 + 2, box["y"] + box["height"] / 2 + 2)
    told = re.fullmatch(r"(\d+\.\d+) m, confidence 0.75", page.inner_text("#readout"))
    assert float(told[1]) == pytest.approx(depth.depth[20, 80], abs=0.01)
    page.check("input[value=points]")
    page.wait_for_selector("body[data-drawn=points]")
    shown = page.evaluate("owner.reduce((count, k) => count + (k >= 0), 0)")
    assert shown > 10_000 and page.complaints == []


@pytest.mark.parametrize("width", [390, 1200])
def test_the_labels_of_its_scale_do_not_touch(depth, open_page, tmp_path, width):
    page = open_page(width, 900)
    ticks = [[0.0, "∞"], [0.05, "40 m"], [0.11, "20 m"], [0.22, "10 m"], [0.31, "7 m"], [0.73, "3 m"], [1.0, "2 m"]]
    data = viewer_data(depth, np.zeros((80, 320, 3), np.uint8), Limits(50.0, 0.0), "labels") | {"ticks": ticks}
    (tmp_path / "index.html").write_text(page_of(data), encoding="utf-8")
    page.goto(f"file://{tmp_path}/index.html")
    page.wait_for_selector("body[data-drawn=look]")
    labels = [label.bounding_box() for label in page.locator("#scale span:visible").all()]
    assert len(labels) >= 4 and labels[0]["x"] >= 0 and labels[-1]["x"] + labels[-1]["width"] <= width
    assert all(left["x"] + left["width"] < right["x"] for left, right in pairwise(labels))


def test_it_is_small_and_asks_no_network(depth):
    rng = np.random.default_rng(0)
    large = osl.SphereGrid(2048, 1024, (-90, 90), min_depth=0.6)
    index = rng.uniform(0, 191, large.shape).astype(np.float32)
    index[:9] = np.nan
    noisy = osl.Depth(index, np.ones_like(index), SphereSweep(depth.sweep.rig, large))
    panorama = np.clip(rng.normal(128, 20, (1024, 2048, 3)), 0, 255).astype(np.uint8)  # no photograph is worse
    page = viewer_page(noisy, panorama, Limits(50.0, 0.0), "large")
    assert len(page.encode()) < 5_000_000 and not re.search(r"https?://|src=\"|href=", page)
