"""The slides: each shows what it names, nothing is cut off, and they can be projected as they are."""

import ast
import re

import nbformat
import pytest
import yaml
from pages import Page, foreign_or_missing, leads

from course import exercises, nbtools
from course.classroom import solve
from workshop.publish import slides


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The folder of the slides."""
    out = tmp_path_factory.mktemp("slides")
    slides.make_slides(out)
    return out


notebooks = pytest.mark.parametrize("path", nbtools.notebooks(), ids=nbtools.number)


@notebooks
def test_slides_show_what_they_name_and_ask_for_every_function(shown, path):
    nb, number = nbformat.read(path, as_version=4), nbtools.number(path)
    written = yaml.safe_load((slides.WRITTEN / f"{number}.yaml").read_text("utf-8"))
    for slide in written:
        assert {*slide} <= {"idea", "say", "figure", "formula", "function"}, slide["idea"]
        assert len(slide["say"]) <= 240, slide["idea"]
    page = Page(shown / f"{path.stem}.slides.html")
    # one more on the title slide
    assert len(page.pictures) == 1 + sum("figure" in slide for slide in written)
    assert all(len(picture["alt"]) >= 20 for picture in page.pictures)
    assert list(foreign_or_missing(page)) == []
    assert [link for link in page.links if not leads(page, link, {})] == []
    assert {"reveal.js/dist/reveal.js", "tex-svg.js", "deal.js"} <= set(page.fetched)

    asked = [slide["function"] for slide in written if "function" in slide]
    assert asked == [s.name for cell in nbtools.code_cells(nb) for s in solve.stubs(cell.source)]
    text = "\n".join(cell.source for cell in slides.shown(nb, number))
    for function in exercises.functions(number):
        fold = rf"A solution: <code>{function.name}<.*?```python\n(.*?)\n```\n</details>"
        sources = re.search(fold, text, re.DOTALL)[1], function.source
        body, right = (ast.parse(source).body[0].body for source in sources)
        # no docstring
        assert [*map(ast.unparse, body)] == [*map(ast.unparse, right[1:])]


def test_the_first_page_leads_to_all_slides(shown):
    page = Page(shown / "index.html")
    assert page.links == [f"{path.stem}.slides.html" for path in nbtools.notebooks()]
    assert [link for link in page.links if not leads(page, link, {})] == []


# Of every slide: what ends beyond it, what is cut off, and what is too small to be read from the
# last row.
WRONG = """() => {
    const found = [], { width, height } = Reveal.getConfig(), scale = Reveal.getScale()
    for (const slide of Reveal.getSlides()) {
        const { h, v } = Reveal.getIndices(slide)
        Reveal.slide(h, v)
        const { left, top } = document.querySelector(".slides").getBoundingClientRect()
        const note = (what) => found.push(`slide ${h}/${v}: ${what}`)
        for (const e of slide.querySelectorAll("*")) {
            const box = e.getBoundingClientRect(), style = getComputedStyle(e)
            if (!box.width || !box.height || e.matches("pre *, [style*=overflow] *")) continue
            const [right, bottom] = [box.right - left, box.bottom - top].map(
                px => Math.floor(px / scale))
            if (right > width || bottom > height) note(`${e.className} ends at ${right}, ${bottom}`)
            if (style.overflowX !== "visible" && e.scrollWidth > e.clientWidth + 1)
                note(`${e.className} is cut off`)
            if (e.localName === "pre" && parseFloat(style.fontSize) < 24)
                note(`code of ${style.fontSize}`)
            if (e.localName === "img" && box.height / scale < 100)
                note(`a picture ${box.height / scale} px high`)
        }
    }
    return found
}"""


@notebooks
def test_no_slide_overflows(shown, open_page, path):
    page = opened(shown, open_page, path.stem)
    assert page.evaluate(WRONG) == []
    assert page.complaints == []
    assert page.evaluate("Reveal.getTotalSlides()") <= 32
    bare = "slide => [...slide.children].every(piece => piece.matches('.fragment'))"
    assert page.evaluate(f"Reveal.getSlides().filter({bare}).length") == 0


def opened(shown, open_page, stem):
    page = open_page(1280, 800)
    page.goto((shown / f"{stem}.slides.html").as_uri())
    page.wait_for_function("window.Reveal && Reveal.isReady()")
    return page


def test_a_solution_comes_at_the_next_step(shown, open_page):
    page = opened(shown, open_page, "04_zncc")
    page.evaluate(
        """() => {
        const at = document.querySelector('.fragment').closest('section')
        Reveal.slide(...Object.values(Reveal.getIndices(at)))
        }"""
    )
    solution = page.locator(".present .fragment").first
    assert not solution.evaluate("e => e.classList.contains('visible')")
    page.keyboard.press("ArrowRight")
    assert solution.evaluate("e => e.classList.contains('visible')")
