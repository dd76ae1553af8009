"""The website: built once; every link leads somewhere, every image shows, every name exists.

A browser also opens every page, as wide as a desktop and as a telephone, and leaves screenshots in
out/browser."""

import html
import importlib
import json
import os
import re
import subprocess
import sys
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import nbformat
import pytest
from pages import Page, count_pictures, count_stills, foreign_or_missing, leads

import omnistereo_learn
import omnistereo_lib as osl
import omnistereo_rigs
from course import nbtools
from course.figures import stills
from workshop.publish import slides, website

pytestmark = pytest.mark.slow  # Sphinx takes a minute

BOOK = nbtools.ROOT / "book"

PAGES = nbtools.ROOT / "omnistereo_tools" / "output" / "page"

SEEN = nbtools.ROOT / "out" / "browser"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The book, built as `make book` does; its folder, and what the build said."""
    out = tmp_path_factory.mktemp("website") / "book"
    for path in (out / "searchindex.js", out / "notebooks" / "99_old.html"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    command = [sys.executable, "-m", "workshop", "book", str(out)]
    return out, subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def pages(built):
    return {path: Page(path) for path in sorted(built[0].rglob("*.html"))}


# --- The book


def test_it_builds_without_a_warning_and_says_where_it_is(built):
    out, said = built
    assert (said.returncode, said.stderr.strip()) == (0, "")
    written = f"Written: {out / 'index.html'}"
    assert said.stdout == f"{written}. Open it in a browser; it needs no network.\n"


def test_pages_of_an_older_book_are_gone(built):
    assert not (built[0] / "notebooks" / "99_old.html").exists()


def test_every_notebook_and_every_page_is_there(built):
    names = ["index", *(path.stem for path in BOOK.glob("*.md"))]
    names += [f"notebooks/{path.stem}" for path in nbtools.notebooks()]
    assert [name for name in names if not (built[0] / f"{name}.html").is_file()] == []


def test_an_old_number_leads_on(built, pages):
    for old, stem in nbtools.MOVED.items():
        page = built[0] / "notebooks" / f"{old}.html"
        assert f"url={stem}.html" in page.read_text(encoding="utf-8")
        assert page.with_name(f"{stem}.html") in pages


def test_every_link_leads_somewhere(built, pages):
    dead = [
        f"{page.path.name} → {link}"
        for page in pages.values()
        for link in page.links
        if not leads(page, link, pages)
    ]
    assert dead == []


def test_everything_that_a_page_fetches_is_in_the_folder(pages):
    assert [lacking for page in pages.values() for lacking in foreign_or_missing(page)] == []


def test_every_picture_says_what_it_shows(pages):
    pictures = [(page.path.name, picture) for page in pages.values() for picture in page.pictures]
    assert pictures
    assert [
        (name, has["src"])
        for name, has in pictures
        if len(has.get("alt", "")) < 20 or "_images" in has["alt"]
    ] == []


def test_the_front_page_has_the_viewer_and_a_figure_of_each_notebook(built):
    front = (built[0] / "index.html").read_text(encoding="utf-8")
    assert front.index("<h1>omnistereo") < front.index('<iframe class="view" src="street.html"')
    assert '<a href="#the-notebooks">the notebooks</a>' in front and 'id="the-notebooks"' in front
    assert "A code host" not in front and "A code host" in website.README.read_text("utf-8")
    cards = front.split('<div class="card">')[1:]
    assert len(cards) == len(nbtools.notebooks())
    for card, path in zip(cards, nbtools.notebooks(), strict=True):
        assert f'href="notebooks/{path.stem}.html"' in card and "<img" in card


@pytest.mark.parametrize(
    ("origin", "found"),
    [
        ("https://github.com/ann/street.git", "https://github.com/ann/street.git"),
        ("https://ann:secret@github.com/ann/street", "https://github.com/ann/street"),
        ("/home/ann/street", None),
        ("", None),
    ],
)
def test_the_address_of_the_clone_is_that_of_the_repository(monkeypatch, tmp_path, origin, found):
    said = subprocess.CompletedProcess([], 0, stdout=f"{origin}\n")
    monkeypatch.setattr(website.subprocess, "run", lambda *_, **__: said)
    assert website.repository_address() == found
    readme = website.README.read_text(encoding="utf-8")
    page = website.front_page(readme, tmp_path, found)
    assert f"git clone --depth 1 {found or 'ADDRESS'}" in page
    assert page.count("https://colab") == (0 if found is None else len(nbtools.notebooks()))
    if found:
        assert "/github/ann/street/blob/main/notebooks/00_quickstart.ipynb" in page
        assert "mybinder.org/v2/gh/ann/street/main?labpath=notebooks%2F00_quickstart.ipynb" in page


def test_no_picture_of_a_notebook_is_lost(built, pages):
    for path in nbtools.notebooks():
        page = pages[built[0] / "notebooks" / f"{path.stem}.html"]
        # light and dark
        assert len(page.pictures) == 2 * (1 + count_pictures(path) + count_stills(path)), path.stem


def test_every_live_figure_has_stills_of_its_sliders_or_a_view():
    for path in nbtools.notebooks():
        code = "\n".join(
            cell.source for cell in nbtools.code_cells(nbformat.read(path, as_version=4))
        )
        calls, found = stills.LIVE.findall(code), stills.stored(path.stem)
        assert len(found) == len(calls), f"python -m workshop stills notebooks/{path.name}"
        for call, live in zip(calls, found, strict=True):
            assert ("view" in live) == (call == "explore")
            assert all(slider["name"] in code for slider in live.get("sliders", []))


def test_every_formula_can_be_drawn(pages, tmp_path, open_page):
    formulas = sorted({formula for page in pages.values() for formula in page.formulas})
    assert formulas
    lines = "".join(f"<p>{html.escape(formula)}</p>" for formula in formulas)
    path = tmp_path / "formulas.html"
    path.write_text(
        f"<meta charset='utf-8'><script src='{slides.MATHJAX}'></script>{lines}", encoding="utf-8"
    )
    page = open_page(1280, 844)
    page.goto(path.as_uri())
    page.evaluate("async () => window.MathJax.startup.promise")
    assert page.locator("mjx-container").count() == len(formulas)
    errors = page.locator("[data-mjx-error]").evaluate_all(
        "found => found.map(e => e.dataset.mjxError)"
    )
    assert (errors, page.complaints) == ([], [])


# --- The book in a browser


@pytest.fixture(scope="module")
def served(built):
    """The address of the book on this machine."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=built[0]))
    Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


class Quiet(SimpleHTTPRequestHandler):
    """A server that does not tell what it serves."""

    def do_GET(self):
        if self.path == "/favicon.ico":  # browsers ask for it, pages do not
            self.send_response(HTTPStatus.NO_CONTENT)
            self.end_headers()
        else:
            super().do_GET()

    def log_message(self, *_):
        pass


# What sticks out to the right, less what scrolls inside a box of its own.
WIDE = """() => {
    const limit = window.innerWidth
    if (document.scrollingElement.scrollWidth <= limit) return []
    const end = e => Math.round(e.getBoundingClientRect().right)
    const boxed = e => e !== document.body
        && (getComputedStyle(e).overflowX !== "visible" || boxed(e.parentElement))
    return [...document.body.querySelectorAll("*")]
        .filter(e => end(e) > limit && !boxed(e.parentElement))
        .map(e => `${e.localName}.${e.className} ends at ${end(e)} of ${limit}`)
        .slice(0, 5).concat("scrolls sideways")
}"""
BROKEN = """async () => {
    const broken = []
    for (const picture of document.images) {
        if (!picture.offsetParent) continue  // for the other mode, or another place of a slider
        picture.loading = "eager"
        try { await picture.decode() } catch { broken.push(picture.src.slice(0, 100)) }
    }
    return broken
}"""
# What axe-core, a checker of accessibility, once found.
UNFIT = """() => [
    ...[...document.querySelectorAll("[role=heading]:not([aria-level])")].map(
        e => `no level: ${e.outerHTML}`),
    ...[...document.querySelectorAll("a[href]")]
        .filter(e => !e.textContent.trim() && !e.ariaLabel && !e.querySelector("img[alt], svg"))
        .map(e => `a link without a name: ${e.outerHTML}`),
    ...[...document.querySelectorAll("summary[aria-label]")]
        .filter(e => !e.ariaLabel.includes(e.innerText.trim()))
        .map(e => `not the name that is shown: ${e.outerHTML}`),
    ...[...document.querySelectorAll("article *")]
        .filter(e => e.checkVisibility() && e.scrollWidth > e.clientWidth + 1 && e.tabIndex < 0)
        .filter(e => ["auto", "scroll"].includes(getComputedStyle(e).overflowX))
        .map(e => `not to be scrolled by keys: ${e.outerHTML.slice(0, 80)}`),
]"""
AXE = """async () => (await axe.run()).violations
    .filter(rule => rule.impact !== "minor")
    .map(rule => `${rule.id}: ${rule.nodes.map(node => node.html.slice(0, 80))}`)"""
DRAWN = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


def heard(page, axe):
    """What axe-core finds on a page, asked again where it does not answer, as seen once."""
    from playwright.sync_api import TimeoutError as NoAnswer

    for tried in range(2):
        page.evaluate(Path(axe).read_text(encoding="utf-8"))
        try:
            return page.wait_for_function(AXE, timeout=60_000).json_value()
        except NoAnswer:
            if tried:
                raise
            page.reload(wait_until="load")


def test_book_fits_shows_every_picture_and_is_read_by_keyboard_and_by_ear(built, served, open_page):
    """By what axe-core once found, and by itself where AXE names its file, as in CI."""
    axe = os.environ.get("AXE")
    page, wrong = open_page(1280, 844), {}
    names = {path.relative_to(built[0]).as_posix() for path in built[0].rglob("*.html")}
    # old addresses lead on at once
    names = sorted(names - {f"notebooks/{old}.html" for old in nbtools.MOVED})
    # listings of code, one like the other
    sources = [name for name in names if name.startswith("_modules/")]
    for name in sorted({*names} - {*sources[2:]}):
        page.goto(f"{served}/{name}", wait_until="load")
        # formulas take their room late
        page.evaluate("async () => window.MathJax?.startup?.promise")
        for width in (1280, 390):
            page.set_viewport_size({"width": width, "height": 844})
            page.evaluate(DRAWN)
            found = [line for script in (BROKEN, WIDE, UNFIT) for line in page.evaluate(script)]
            if axe and width == 1280:
                found += heard(page, axe)
            found += page.complaints
            if found:
                wrong[f"{name} at {width}"] = found
            page.complaints.clear()
            if name.startswith("notebooks/"):
                page.screenshot(path=SEEN / f"book_{width}" / Path(name).with_suffix(".png"))
    assert not wrong, json.dumps(wrong, indent=1)


@pytest.mark.skipif("AXE" not in os.environ, reason="axe-core is not there")
@pytest.mark.parametrize("name", ["page", "world", "live"])
def test_controls_have_names_before_the_script_has_run(name, open_page):
    still = re.sub(
        "<script.*?</script>", "", (PAGES / f"{name}.html").read_text(encoding="utf-8"), flags=re.S
    )
    page = open_page(1280, 844)
    page.set_content(still.replace("{{TITLE}}", "a street"))
    assert heard(page, os.environ["AXE"]) == []


CUT = r"""found => found
    .filter(e => e.scrollWidth > e.clientWidth + 1
        && e.textContent.split("\n").every(line => line.length <= 120))
    .map(e => e.textContent)"""


def test_code_of_120_letters_is_not_cut_off_at_1400_pixels(served, open_page):
    page = open_page(1400, 900)
    for name in ("02_rig_calibration", "05_sgm"):
        page.goto(f"{served}/notebooks/{name}.html")
        assert page.locator(".cell_input pre").evaluate_all(CUT) == []


def test_figures_are_dark_on_a_dark_page(served, open_page):
    page = open_page(1280, 844)
    for mode in ("dark", "light"):
        page.emulate_media(color_scheme=mode)
        page.goto(f"{served}/notation.html")
        shown = page.locator("article .picture img:visible")
        assert shown.count() == 4
        assert {"dark" in shown.nth(k).get_attribute("src") for k in range(4)} == {mode == "dark"}


def test_book_search_finds_a_word(served, open_page):
    page = open_page(1280, 844)
    # a picture that is left half loaded has failed
    page.goto(f"{served}/index.html", wait_until="networkidle")
    page.locator("input[name=q]:visible").first.fill("panorama")
    page.keyboard.press("Enter")
    found = page.locator("#search-results li a")
    found.first.wait_for()
    page.wait_for_load_state("networkidle")  # it reads the pages that it has found
    pages = page.locator("#search-results li:not(.kind-object):visible > a").evaluate_all(
        "links => links.map(link => link.pathname)"
    )
    assert len(pages) > 10 and len(set(pages)) == len(pages)
    page.screenshot(path=SEEN / "book_search.png")
    with page.expect_navigation():
        found.first.click()
    assert "panorama" in page.locator("article").inner_text().lower()
    assert page.complaints == []


# --- What is generated, and what it is generated from


def test_notation_names_what_the_library_has():
    text = (BOOK / "notation.md").read_text(encoding="utf-8")
    names = [
        name
        for row in re.findall(r"^\| .*\| ([^|]*) \|$", text, re.MULTILINE)
        for name in re.findall(r"`([^`]+)`", row)
    ]
    assert len(names) > 30
    assert [name for name in names if name != "@" and not exists(name)] == []


def exists(name):
    """Tell whether a name is one of the library's: `load_rig`, `metrics.error_map`."""
    first, *rest = name.split(".")
    faces = (osl, omnistereo_rigs, omnistereo_learn)
    home = next((face for face in faces if first in face.__all__), None)
    if home is not None:
        thing = getattr(home, first)
    else:
        packages = [face.__name__ for face in faces]
        module = first if first in packages else f"omnistereo_lib.{first}"
        thing = importlib.import_module(module)
    for part in rest:
        if part in getattr(thing, "__dataclass_fields__", {}):
            return True  # a field, whose type is not known here
        if not hasattr(thing, part) and not hasattr(thing, "__path__"):
            return False
        thing = (
            getattr(thing, part)
            if hasattr(thing, part)
            else importlib.import_module(f"{thing.__name__}.{part}")
        )
    return True
