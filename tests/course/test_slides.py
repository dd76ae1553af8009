"""The slides: nothing is lost, nothing is cut off, and they can be projected as they are."""

import base64
import re
from itertools import pairwise

import cv2
import nbformat
import numpy as np
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output
from pages import Page, count_pictures, count_stills, foreign_or_missing, leads

from course import nbtools, slides, solve


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The folder of the slides."""
    out = tmp_path_factory.mktemp("slides")
    slides.make_slides(out)
    return out


notebooks = pytest.mark.parametrize("path", nbtools.notebooks(), ids=lambda path: path.stem)


@notebooks
def test_slides_are_many_and_none_is_a_wall(path):
    columns, heights = 0, []
    for cell in slides.deal(nbformat.read(path, as_version=4)).cells:
        place = cell.metadata.slideshow.slide_type
        columns += place == "slide"
        heights += [0.0] if place in ("slide", "subslide") else []
        heights[-1] += slides.height(cell)
    assert columns >= 5 and len(heights) >= 10
    assert max(heights) <= slides.FULL


@notebooks
def test_slides_lose_no_picture_link_or_script(shown, path):
    page = Page(shown / f"{path.stem}.slides.html")
    assert len(page.pictures) == count_pictures(path) + 2 * count_stills(path)  # stills for light pages and dark ones
    assert all(len(picture["alt"]) >= 20 for picture in page.pictures)
    assert list(foreign_or_missing(page)) == []
    assert [link for link in page.links if not leads(page, link, {})] == []
    assert {"reveal.js/dist/reveal.js", "tex-svg.js", "stills.js"} <= set(page.fetched)


@notebooks
def test_slides_lose_no_text(path):
    nb = nbformat.read(path, as_version=4)
    prose = [
        re.sub(r"<details>.*?\n```\n|</details>", "", c.source, flags=re.DOTALL)
        for c in nb.cells
        if c.cell_type == "markdown"
    ]  # but for solutions, which are code there
    kept = [cell.source for cell in slides.deal(nb).cells if cell.cell_type == "markdown"]
    assert "".join("".join(kept).split()) == "".join("".join(prose).split())


@notebooks
def test_a_solution_follows_its_exercise_at_the_next_step(path):
    nb = nbformat.read(path, as_version=4)
    asked = [stub.name for cell in nbtools.code_cells(nb) for stub in solve.stubs(cell.source)]
    cells = slides.deal(nb).cells
    solutions = [(before, cell) for before, cell in pairwise(cells) if slides.SOLUTION in cell.metadata.get("tags", [])]
    assert len(solutions) >= len(asked) - 2  # what is taller than a slide is left out
    for before, cell in solutions:
        assert cell.metadata.slideshow.slide_type in ("fragment", "subslide")
        in_flow = f"{cell.source.split('(')[0].removeprefix('def ')} = nb" in before.source
        assert in_flow or before.cell_type == "markdown"
        assert cell.source.split()[-1] != "..." and "check_" not in cell.source
        assert any(f"def {name}(" in cell.source for name in asked)


def test_a_sentence_stands_with_the_picture_that_it_introduces():
    """Text, then more text, then a picture: not all fits, so the last sentence moves to the picture."""
    png = base64.b64encode(cv2.imencode(".png", np.zeros((60, 100), np.uint8))[1]).decode()
    picture = new_output("display_data", {"image/png": png, "text/plain": "a picture"})
    cells = [new_markdown_cell("# Title"), *(new_markdown_cell(f"{name} " * 100) for name in ("first", "second"))]
    dealt = slides.deal(new_notebook(cells=[*cells, new_code_cell("draw()", outputs=[picture])])).cells
    assert [cell.metadata.slideshow.slide_type for cell in dealt] == ["slide", "-", "subslide", "-"]
    assert dealt[2].source.startswith("second")


def test_code_becomes_narrow_and_its_comments_stay():
    code = "a = function(first, second)  # " + "why " * 20 + "\nb = [\n    1,  # one\n    2,\n]"
    narrow = slides.narrow([code, "c = " + "'" + "x" * 100 + "'"])
    assert narrow[0].splitlines()[0].startswith("# why why") and "b = [\n    1,  # one" in narrow[0]
    assert narrow[0].splitlines()[1] == "a = function(first, second)" and len(narrow[1]) == 106


def test_the_first_page_leads_to_all_slides(shown):
    page = Page(shown / "index.html")
    assert page.links == [f"{path.stem}.slides.html" for path in nbtools.notebooks()]
    assert [link for link in page.links if not leads(page, link, {})] == []


# What ends beyond the slide, what is cut off, and code that is too small to read from the last row.
WRONG = """() => {
    const slide = Reveal.getCurrentSlide(), scale = Reveal.getScale(), found = []
    const { left, top } = document.querySelector(".slides").getBoundingClientRect()
    const { width, height } = Reveal.getConfig()
    for (const e of slide.querySelectorAll("*")) {
        const box = e.getBoundingClientRect(), style = getComputedStyle(e)
        if (!box.width || !box.height) continue
        const [right, bottom] = [(box.right - left) / scale, (box.bottom - top) / scale].map(Math.floor)
        if (right > width || bottom > height) found.push(`${e.className} ends at ${right}, ${bottom}`)
        if (style.overflowX !== "visible" && e.scrollWidth > e.clientWidth + 1) found.push(`${e.className} is cut off`)
        if (e.localName === "pre" && parseFloat(style.fontSize) < 24) found.push(`code of ${style.fontSize}`)
        if (e.localName === "img" && box.height / scale < 100) found.push(`a picture ${box.height / scale} px high`)
    }
    return found
}"""


def test_no_slide_overflows(shown, open_page):
    page, wrong, seen = open_page(1280, 800), {}, 0
    page.goto((shown / "03_sphere_sweep.slides.html").as_uri())
    page.evaluate("async () => window.MathJax.startup.promise")
    while True:
        seen += 1
        if found := page.evaluate(WRONG):
            wrong[page.url] = found
        before = page.evaluate("JSON.stringify(Reveal.getState())")
        page.evaluate("Reveal.next()")
        if page.evaluate("JSON.stringify(Reveal.getState())") == before:
            break
    assert wrong == {} and seen > 30 and page.complaints == []


def test_a_slider_on_a_slide_shows_another_picture(shown, open_page):
    page = open_page(1280, 800)
    page.goto((shown / "03_sphere_sweep.slides.html").as_uri())
    page.evaluate(
        "Reveal.slide(...Object.values(Reveal.getIndices(document.querySelector('.stills').closest('section'))))"
    )
    slider, shown_picture = page.locator(".present .stills input"), page.locator(".present .stills img:visible")
    before = shown_picture.get_attribute("src")
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert shown_picture.get_attribute("src") != before and shown_picture.count() == 1
    assert page.locator(".present .stills output").text_content() == "16"


def test_a_sentence_shares_its_slide_with_code_or_with_what_the_code_printed():
    """Heading and sentence, then code and output that need a slide, then a sentence: two slides, not three."""
    long = "\n".join(f"a{k} = {k}" for k in range(16))
    printed = new_output("stream", text="\n".join("line" for _ in range(3)))
    cells = [new_markdown_cell("## Section"), new_markdown_cell("Before."), new_code_cell(long, outputs=[printed])]
    dealt = slides.deal(new_notebook(cells=[*cells, new_markdown_cell("After.")])).cells
    assert [cell.metadata.slideshow.slide_type for cell in dealt] == ["slide", "-", "-", "subslide", "-"]
    assert dealt[2].source == long and not dealt[2].outputs
    assert dealt[3].outputs and slides.HIDDEN in dealt[3].metadata.tags and dealt[4].source == "After."
