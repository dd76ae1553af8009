"""Which examples Hypothesis draws, limits of time and memory, and a real browser."""

import os
import shutil
import sys
from urllib.parse import urlsplit

import hypothesis
import psutil
import pytest

# No deadline: a busy machine is no mistake. In CI the same examples every time: a search for new
# ones belongs where somebody can follow it up.
hypothesis.settings.register_profile("course", deadline=None)
hypothesis.settings.register_profile("ci", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ci" if os.environ.get("CI") else "course")

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DISABLED = ("gpu", "quic", "background-networking", "component-update", "sync")
FLAGS = ["--no-first-run", *(f"--disable-{part}" for part in DISABLED)]
PATIENCE_S = 600  # for what takes seconds on an idle machine


@pytest.fixture
def limits():
    """Return a function that renews the limits of this process: seconds of the processor, and
    further memory.

    A process that takes longer ends; one that asks for more gets a MemoryError.
    """
    if sys.platform != "linux":
        pytest.skip("limits of memory are Linux's")
    import resource

    kinds = (resource.RLIMIT_CPU, resource.RLIMIT_AS)
    before = [resource.getrlimit(kind) for kind in kinds]
    had = psutil.Process().memory_info().vms

    def renew(memory, seconds=5):
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        for kind, limit, (_, most) in zip(
            kinds, (int(used) + 1 + seconds, had + memory), before, strict=True
        ):
            resource.setrlimit(kind, (limit, most))

    yield renew
    for kind, limit in zip(kinds, before, strict=True):
        resource.setrlimit(kind, limit)


@pytest.fixture
def small(monkeypatch):
    """Commands that draw small pictures, and a small VolumeNet."""
    from command_server import make_small

    make_small(monkeypatch.setattr)


@pytest.fixture(scope="session")
def pycolmap():
    """COLMAP's module, installed apart: behind what is here, so that NumPy stays ours."""
    from workshop.peers import __main__ as peers

    found = peers.install("pycolmap")
    sys.path.append(str(found and found[1]))
    yield pytest.importorskip("pycolmap", exc_type=ImportError)
    sys.path.pop()


@pytest.fixture(scope="module")
def chromium():
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="Playwright is missing: environment-dev.txt has it"
    )
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip(f"no browser on the PATH: {', '.join(BROWSERS)}")
    sync_api.expect.set_options(timeout=1000 * PATIENCE_S)
    with sync_api.sync_playwright() as playwright:
        sandbox = os.geteuid() != 0  # root has none
        browser = playwright.chromium.launch(
            executable_path=path, args=FLAGS, chromium_sandbox=sandbox
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def open_page(chromium):
    """Open an empty page of some size, with what went wrong on it in `page.complaints`."""
    contexts = []

    def open_one(width, height, **options):
        contexts.append(
            chromium.new_context(
                viewport={"width": width, "height": height},
                **{"reduced_motion": "reduce"} | options,
            )
        )
        page = contexts[-1].new_page()
        page.set_default_timeout(1000 * PATIENCE_S)
        page.complaints = []
        note = page.complaints.append
        page.on(
            "console", lambda message: message.type == "error" and note(f"console: {message.text}")
        )
        page.on("pageerror", lambda error: note(f"script: {error}"))
        page.on("requestfailed", lambda request: note(f"failed: {request.url}"))
        page.on(
            "response",
            lambda response: response.status >= 400 and note(f"{response.status}: {response.url}"),
        )
        page.on(
            "request",
            lambda request: foreign(request.url) and note(f"not from this machine: {request.url}"),
        )
        return page

    yield open_one
    for context in contexts:
        context.close()


def foreign(url):
    address = urlsplit(url)
    return address.scheme in ("http", "https", "ws", "wss") and address.hostname not in (
        "localhost",
        "127.0.0.1",
    )
