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
        keys = {"idea", "say", "figure", "rows", "columns", "formula", "function"}
        assert {*slide} <= keys, slide["idea"]
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
        const { h } = Reveal.getIndices(slide)
        Reveal.slide(h)
        const { left, top } = document.querySelector(".slides").getBoundingClientRect()
        const note = (what) => found.push(`slide ${h}: ${what}`)
        for (const e of slide.querySelectorAll("*")) {
            const box = e.getBoundingClientRect(), style = getComputedStyle(e)
            // what is wider than a telephone moves below a finger
            const moves = "pre *, svg, svg *, mjx-assistive-mml, mjx-assistive-mml *, [style*=overflow] *, .phone :is(.picture, pre) *"
            if (!box.width || !box.height || e.matches(moves)) continue
            const [right, bottom] = [box.right - left, box.bottom - top].map(
                px => Math.floor(px / scale))
            if (right > width || bottom > height) note(`${e.className} ends at ${right}, ${bottom}`)
            if (!["visible", "auto"].includes(style.overflowX) && e.scrollWidth > e.clientWidth + 1)
                note(`${e.className} is cut off`)
            const least = e.closest(".phone") ? 19 : 24
            if (e.localName === "pre" && parseFloat(style.fontSize) < least)
                note(`code of ${style.fontSize}`)
            if (e.matches(".picture > *") && box.height / scale < 100)
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
    small = [size for size in page.evaluate(LABELS) if size < 14]
    # eight pictures of 225 that do not come apart, and title slides; none is below 10
    assert len(small) <= 2 and all(size > 10 for size in small), small


# Of every picture, the px on the screen of the 10 pt in which Matplotlib labels axes.
LABELS = """() => Reveal.getSlides().flatMap(slide => {
    Reveal.slide(Reveal.getIndices(slide).h)
    return [...slide.querySelectorAll(".picture > :is(img, svg)")].map(shown => {
        const of = (side) => +shown.getAttribute(side) || shown.viewBox.baseVal[side]
        const box = shown.getBoundingClientRect()
        const label = +shown.parentElement.dataset.label
        return label * Math.min(box.width / of("width"), box.height / of("height"))
    })
})"""


def opened(shown, open_page, stem, size=(1366, 768)):
    page = open_page(*size)
    page.goto((shown / f"{stem}.slides.html").as_uri())
    page.wait_for_function("window.Reveal && Reveal.isReady()")
    return page


# figures in columns, and code wider than a telephone
@pytest.mark.parametrize("stem", ["02_rig_calibration", "15_gallery"])
def test_slides_fit_a_telephone(shown, open_page, stem):
    page = opened(shown, open_page, stem, (390, 844))
    assert page.evaluate("document.querySelector('meta[name=viewport]').content") == (
        "width=device-width, initial-scale=1"
    )
    assert page.evaluate(WRONG) == []
    assert min(page.evaluate(LABELS)) > 6
    # what is wider, code most of all, moves to its end before the next slide comes
    wide = "(slide, h) => { Reveal.slide(h, 0, 99); const p = slide.querySelector('pre')"
    wide += "; return p && p.scrollWidth > p.clientWidth + 1 }"
    page.evaluate(f"Reveal.getSlides().findIndex({wide})")
    at = page.evaluate("Reveal.getIndices().h")
    swipe = """end => {
        const box = document.querySelector(".present pre")
        box.scrollLeft = end ? box.scrollWidth : 0
        const touch = (clientX) => new Touch({ identifier: 1, target: box, clientX })
        for (const [kind, list, x] of [["start", "touches", 300], ["end", "changedTouches", 100]])
            box.dispatchEvent(
                new TouchEvent(`touch${kind}`, { [list]: [touch(x)], bubbles: true }))
        return Reveal.getIndices().h
    }"""
    assert [page.evaluate(swipe, end) for end in (False, True)] == [at, at + 1]


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


def test_a_figure_is_cut_between_its_panels():
    """Also where JPEG leaves noise between an axis label and the next title."""
    (page,) = (path for path in nbtools.notebooks() if nbtools.number(path) == "10")
    text = "\n".join(cell.source for cell in slides.shown(nbformat.read(page, as_version=4), "10"))
    (rows,) = {found for found in re.findall(r"data-rows='(.*?)'", text) if found.count("[") == 4}
    heights = [end - start for start, end in ast.literal_eval(rows)]
    assert max(heights) - min(heights) <= 2
