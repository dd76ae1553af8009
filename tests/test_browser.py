"""The course as a reader opens it: JupyterLab from `make lab` and the book from `make book`, in a real browser.

Skipped where there is no Chromium or Chrome. Screenshots of what was seen are left in out/browser, to look at.
"""

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import nbformat
import nbtools
import pytest

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: environment.txt has it")

ROOT = nbtools.ROOT
QUICKSTART = Path("notebooks") / "00_quickstart.ipynb"
SEEN = ROOT / "out" / "browser"
PATIENCE_S = 600  # for what takes seconds on an idle machine
expect = sync_api.expect
expect.set_options(timeout=1000 * PATIENCE_S)

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CHROMIUM = next(filter(None, map(shutil.which, BROWSERS)), None)
FLAGS = ["--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync"]  # fmt: skip
AS_ROOT = os.geteuid() == 0  # JupyterLab and Chromium's sandbox then need a word more
# The environment is there already, or this test would not run: make need not look after it.
MAKE = ["make", "-o", ".venv/.installed"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason=f"no browser on the PATH: {', '.join(BROWSERS)}"),
    pytest.mark.skipif(shutil.which("make") is None, reason="no make on the PATH"),
]


@pytest.fixture(scope="module")
def chromium():
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS, chromium_sandbox=not AS_ROOT)
        yield browser
        browser.close()


@pytest.fixture
def open_page(chromium):
    """Open an empty page of some size, with what went wrong on it in `page.complaints`."""
    contexts = []

    def open_one(width, height):
        contexts.append(chromium.new_context(viewport={"width": width, "height": height}))
        page = contexts[-1].new_page()
        page.set_default_timeout(1000 * PATIENCE_S)
        page.complaints = []
        note = page.complaints.append
        page.on("console", lambda message: message.type == "error" and note(f"console: {message.text}"))
        page.on("pageerror", lambda error: note(f"script: {error}"))
        page.on("requestfailed", lambda request: note(f"failed: {request.url}"))
        page.on("response", lambda response: response.status >= 400 and note(f"{response.status}: {response.url}"))
        page.on("request", lambda request: foreign(request.url) and note(f"not from this machine: {request.url}"))
        return page

    yield open_one
    for context in contexts:
        context.close()


def foreign(url):
    address = urlsplit(url)
    return address.scheme in ("http", "https", "ws", "wss") and address.hostname not in ("localhost", "127.0.0.1")


# --- JupyterLab ---------------------------------------------------------------------------------------------

# Nobody's own settings; nothing is saved, and nothing asked for, unless a reader does it.
SETTINGS = {
    "docmanager-extension/plugin": {"autosave": False},
    "apputils-extension/notification": {"fetchNews": "false"},
}
FOLDERS = {
    "JUPYTER_CONFIG_DIR": "config",
    "JUPYTER_DATA_DIR": "data",
    "JUPYTER_RUNTIME_DIR": "runtime",
    "JUPYTERLAB_SETTINGS_DIR": "settings",
    "JUPYTERLAB_WORKSPACES_DIR": "workspaces",
    "IPYTHONDIR": "ipython",
}


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A folder like a clone, in which notebooks may be run and a book be built."""
    folder = tmp_path_factory.mktemp("clone")
    for entry in ROOT.iterdir():
        if entry.name in ("notebooks", "book"):
            shutil.copytree(entry, folder / entry.name, ignore=shutil.ignore_patterns(".*", "_build"))
        elif not entry.name.startswith(".") and entry.name != "out":
            (folder / entry.name).symlink_to(entry)
    (folder / ".venv").symlink_to(sys.prefix)
    return folder


@pytest.fixture
def lab(clone):
    """JupyterLab as `make lab` starts it; the page that it would open."""
    own = clone / "jupyter"
    for name, setting in SETTINGS.items():
        path = own / "settings" / "@jupyterlab" / f"{name}.jupyterlab-settings"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(setting), encoding="utf-8")
    arguments = ["--no-browser", "--LabApp.extension_manager=readonly", *(["--allow-root"] if AS_ROOT else [])]
    log = clone / "lab.log"
    with log.open("wb") as sink:
        server = subprocess.Popen(
            [*MAKE, "lab", f"LAB_ARGS={' '.join(arguments)}"],
            cwd=clone,
            env=os.environ | {name: str(own / folder) for name, folder in FOLDERS.items()},
            stdout=sink,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield page_to_open(server, own / "runtime", log)
    finally:
        end(server)


def page_to_open(server, folder, log):
    """Wait for the file that the server hands to a browser: it leads to the notebook, with the token."""
    deadline = time.monotonic() + PATIENCE_S
    while server.poll() is None and time.monotonic() < deadline:
        for page in folder.glob("jpserver-file-to-run-*-open.html"):
            if "token=" in page.read_text(encoding="utf-8"):
                return page.as_uri()
        time.sleep(0.1)
    pytest.fail(f"JupyterLab did not start:\n{log.read_text(encoding='utf-8', errors='replace')[-3000:]}")


def end(server):
    """End the server and what it started; a kernel ends with its server."""
    for sent in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(server.pid, sent)
            server.wait(30)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def choose(page, menu, entry):
    page.get_by_role("menuitem", name=menu, exact=True).click()
    page.get_by_role("menuitem", name=entry, exact=True).click()


def bytes_of(picture):
    """The file that a picture on the page shows."""
    return base64.b64decode(
        picture.evaluate("""async picture => {
            const bytes = new Uint8Array(await (await fetch(picture.src)).arrayBuffer())
            return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ""))
        }""")
    )


def test_quickstart_runs_in_jupyterlab_and_its_slider_turns_the_picture(lab, clone, open_page):
    stored = (clone / QUICKSTART).read_bytes()
    cells = nbtools.code_cells(nbformat.reads(stored.decode(), as_version=4))
    page = open_page(1280, 900)
    page.goto(lab)
    prompts = page.locator(".jp-Notebook .jp-CodeCell .jp-InputPrompt")
    expect(prompts).to_have_count(len(cells))
    expect(page.locator("#jp-bottom-panel")).to_contain_text("| Idle")  # the kernel's state

    choose(page, "Edit", "Clear Outputs of All Cells")
    expect(prompts).to_have_text(["[ ]:"] * len(cells))
    choose(page, "Run", "Run All Cells")
    numbered = prompts.filter(has_text=re.compile(r"^\[\d+\]:$"))
    wrong = page.locator('.jp-OutputArea-output[data-mime-type="application/vnd.jupyter.stderr"]')  # errors, warnings
    expect(numbered.nth(len(cells) - 1).or_(wrong).first).to_be_attached()
    page.screenshot(path=SEEN / "lab_run.png")
    assert wrong.all_text_contents() == []
    expect(prompts).to_have_text([f"[{n}]:" for n in range(1, len(cells) + 1)])

    handle, picture = page.locator(".widget-slider .noUi-handle"), page.locator("img.widget-image")
    handle.scroll_into_view_if_needed()
    page.screenshot(path=SEEN / "lab_slider_before.png")
    before, address = bytes_of(picture), picture.get_attribute("src")
    handle.drag_to(page.locator(".widget-slider .noUi-base"))  # its middle
    expect(picture).not_to_have_attribute("src", address)
    assert bytes_of(picture) != before
    page.screenshot(path=SEEN / "lab_slider_after.png")

    assert page.complaints == []
    page.close()
    assert (clone / QUICKSTART).read_bytes() == stored


# --- The book -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def book(clone):
    """The book as `make book` builds it, served from this machine; its address."""
    if not (clone / "book" / "conf.py").exists():
        pytest.skip("there is no book to build: book/conf.py")
    subprocess.run([*MAKE, "book"], cwd=clone, check=True)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=clone / "out" / "book"))
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
    const boxed = e => e !== document.body && (getComputedStyle(e).overflowX !== "visible" || boxed(e.parentElement))
    return [...document.body.querySelectorAll("*")]
        .filter(e => end(e) > limit && !boxed(e.parentElement))
        .map(e => `${e.localName}.${e.className} ends at ${end(e)} of ${limit}`)
        .slice(0, 5).concat("scrolls sideways")
}"""
BROKEN = """async () => {
    const broken = []
    for (const picture of document.images) {
        picture.loading = "eager"
        try { await picture.decode() } catch { broken.push(picture.src.slice(0, 100)) }
    }
    return broken
}"""


@pytest.mark.parametrize("width", [1280, 390])
def test_book_fits_and_every_picture_shows(book, clone, open_page, width):
    page = open_page(width, 844)
    wrong = {}
    for path in sorted((clone / "out" / "book").rglob("*.html")):
        name = path.relative_to(clone / "out" / "book").as_posix()
        page.goto(f"{book}/{name}", wait_until="load")
        page.evaluate("async () => window.MathJax?.startup?.promise")  # formulas take their room late
        found = [*page.evaluate(BROKEN), *page.evaluate(WIDE), *page.complaints]
        if found:
            wrong[name] = found
        page.complaints.clear()
        page.screenshot(path=SEEN / f"book_{width}" / Path(name).with_suffix(".png"))
    assert not wrong, json.dumps(wrong, indent=1)


def test_book_search_finds_a_word(book, open_page):
    page = open_page(1280, 844)
    page.goto(f"{book}/index.html")
    page.locator("input[name=q]:visible").first.fill("panorama")
    page.keyboard.press("Enter")
    found = page.locator("#search-results li a")
    expect(found.first).to_be_visible()
    page.wait_for_load_state("networkidle")  # it reads the pages that it has found
    page.screenshot(path=SEEN / "book_search.png")
    with page.expect_navigation():
        found.first.click()
    expect(page.locator("article")).to_contain_text("panorama", ignore_case=True)
    assert page.complaints == []
