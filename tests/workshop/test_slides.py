"""The slides: no picture or formula is lost, nothing is cut off, and they can be projected as they
are."""

import ast
import re

import nbformat
import pytest
import yaml
from pages import Page, count_pictures, count_stills, foreign_or_missing, leads

from course import exercises, nbtools
from course.classroom import solve
from workshop.publish import slides


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The folder of the slides."""
    out = tmp_path_factory.mktemp("slides")
    slides.make_slides(out)
    return out


WRITTEN = {path.stem: yaml.safe_load(path.read_text("utf-8")) for path in slides.WRITTEN.glob("*")}
CUT = [path for path in nbtools.notebooks() if nbtools.number(path) not in WRITTEN]
notebooks = pytest.mark.parametrize("path", nbtools.notebooks(), ids=lambda path: path.stem)
cut = pytest.mark.parametrize("path", CUT, ids=lambda path: path.stem)


@pytest.mark.parametrize("number", WRITTEN)
def test_written_slides_show_what_they_name_and_ask_for_every_function(number, tmp_path):
    (path,) = (path for path in nbtools.notebooks() if nbtools.number(path) == number)
    nb = nbformat.read(path, as_version=4)
    cells = list(slides.shown(nbformat.read(path, as_version=4), path.stem, tmp_path))
    for slide in WRITTEN[number]:
        assert {*slide} <= {"idea", "say", "figure", "formula", "function"}, slide["idea"]
        assert len(slide["say"]) <= 240, slide["idea"]
    pictures = sum(len(cell.get("outputs", ())) for cell in cells if "show(" in cell.source)
    assert pictures == sum("figure" in slide for slide in WRITTEN[number])
    asked = [slide["function"] for slide in WRITTEN[number] if "function" in slide]
    assert asked == [s.name for cell in nbtools.code_cells(nb) for s in solve.stubs(cell.source)]
    text = "\n".join(cell.source for cell in cells)
    assert re.findall(r"A solution: <code>(\w+)</code>", text) == asked


@cut
def test_slides_lose_no_picture_link_or_script(shown, path):
    page = Page(shown / f"{path.stem}.slides.html")
    stills_shown = 2 * count_stills(path)  # for light pages and dark ones
    assert (
        len(page.pictures) == count_pictures(path, slides=True) + stills_shown + 1
    )  # on the title slide
    assert all(len(picture["alt"]) >= 20 for picture in page.pictures)
    assert list(foreign_or_missing(page)) == []
    assert [link for link in page.links if not leads(page, link, {})] == []
    assert {"reveal.js/dist/reveal.js", "tex-svg.js", "stills.js", "deal.js"} <= set(page.fetched)


@cut
def test_slides_show_headings_formulas_first_sentences_and_open_functions(tmp_path, path):
    nb = nbformat.read(path, as_version=4)
    cells = list(slides.shown(nbformat.read(path, as_version=4), path.stem, tmp_path))
    notebook, shown = (
        "\n\n".join(cell.source for cell in some if cell.cell_type == "markdown")
        for some in (nb.cells, cells)
    )
    flow = notebook.partition("## Exercises")[0]
    for piece in (r"^#+ .*", r"\$\$.*?\$\$", r"^\*\*You will\*\* [^.]*"):
        found = [
            re.findall(piece, text, re.DOTALL if "$" in piece else re.MULTILINE)
            for text in (flow, shown)
        ]
        assert [text for text in found[0] if text not in found[1]] == []
    assert "## Takeaways" in shown and not any(heading in shown for heading in slides.LEFT_OUT)
    stubs = [stub.name for cell in nbtools.code_cells(nb) for stub in solve.stubs(cell.source)]
    turns = re.findall(r"^### Your turn: `(\w+)`", shown, re.MULTILINE)
    assert turns == stubs
    for function in exercises.functions(nbtools.number(path)):
        solution = re.search(
            rf"A solution: <code>{function.name}<.*?```python\n(.*?)\n```\n</details>",
            shown,
            re.DOTALL,
        )
        shown_body, body = (
            ast.parse(source).body[0].body for source in (solution[1], function.source)
        )
        # no docstring
        assert [ast.unparse(line) for line in shown_body] == [
            ast.unparse(line) for line in body[1:]
        ]
    code = [
        cell.source
        for cell in cells
        if cell.cell_type == "code" and "hide-input" not in cell.metadata.tags
    ]
    assert [stub.name for source in code for stub in solve.stubs(source)] == turns and len(
        code
    ) == len(turns)


@pytest.mark.parametrize(
    ("block", "short"),
    [
        ("One. Two? Three", "One."),
        ("Eq. 1 of the paper is it. Two.", "Eq. 1 of the paper is it."),
        (
            "*Expect what? Write it down:* a guess. More.",
            "*Expect what? Write it down:* a guess. More.",
        ),
        ("- A point. It has two.", "- A point. It has two."),
        ("**Write it:** in go rays. Out come points.", "**Write it:** in go rays."),
    ],
)
def test_a_paragraph_in_short(block, short):
    assert slides.in_short(block) == short


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
            const [right, bottom] = [(box.right - left) / scale, (box.bottom - top) / scale].map(Math.floor)
            if (right > width || bottom > height) note(`${e.className} ends at ${right}, ${bottom}`)
            if (style.overflowX !== "visible" && e.scrollWidth > e.clientWidth + 1) note(`${e.className} is cut off`)
            if (e.localName === "pre" && parseFloat(style.fontSize) < 24) note(`code of ${style.fontSize}`)
            if (e.localName === "img" && box.height / scale < 100) note(`a picture ${box.height / scale} px high`)
        }
    }
    return found
}"""


@notebooks
def test_no_slide_overflows(shown, open_page, path):
    page = opened(shown, open_page, path.stem)
    assert page.evaluate(WRONG) == []
    # left sooner than they could load
    assert [said for said in page.complaints if "/views/" not in said] == []
    assert page.evaluate("Reveal.getTotalSlides()") <= 25
    bare = "slide => [...slide.children].every(piece => piece.matches('.fragment'))"
    assert page.evaluate(f"Reveal.getSlides().filter({bare}).length") == 0


def opened(shown, open_page, stem):
    page = open_page(1280, 800)
    page.goto((shown / f"{stem}.slides.html").as_uri())
    page.wait_for_function("window.Reveal && Reveal.isReady()")
    return page


def test_a_slider_on_a_slide_shows_another_picture(shown, open_page):
    page = opened(shown, open_page, "10_evaluation")
    page.evaluate(
        "Reveal.slide(...Object.values(Reveal.getIndices(document.querySelector('.stills').closest('section'))))"
    )
    live = page.locator(".present .stills").first
    slider, shown_picture = live.locator("input").first, live.locator("img:visible")
    before = shown_picture.get_attribute("src")
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert shown_picture.get_attribute("src") != before and shown_picture.count() == 1
    assert live.locator("output").first.text_content()


def test_a_solution_comes_at_the_next_step(shown, open_page):
    page = opened(shown, open_page, "04_zncc")
    page.evaluate(
        "Reveal.slide(...Object.values(Reveal.getIndices(document.querySelector('.fragment').closest('section'))))"
    )
    solution = page.locator(".present .fragment").first
    assert not solution.evaluate("e => e.classList.contains('visible')")
    page.keyboard.press("ArrowRight")
    assert solution.evaluate("e => e.classList.contains('visible')")
