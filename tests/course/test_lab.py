"""JupyterLab as `make lab` opens it, in a real browser: the first cells of notebook 00, and its
points, which turn.

Screenshots of what was seen are left in out/browser, to look at.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import nbformat
import pytest
from scene import refused

from course import nbtools
from course.classroom import lab as lab_module
from course.figures import stills

sync_api = pytest.importorskip(
    "playwright.sync_api", reason="Playwright is not installed: environment-dev.txt has it"
)

ROOT = nbtools.ROOT
STORED = Path("notebooks") / "00_quickstart.ipynb"
QUICKSTART = Path("my_notebooks") / "00_quickstart.ipynb"
SEEN = ROOT / "out" / "browser"
PATIENCE_S = 600  # for what takes seconds on an idle machine
expect = sync_api.expect

# The environment is there already, or this test would not run: make need not look after it.
MAKE = ["make", "-o", ".venv/.installed"]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make on the PATH")

# Nobody's own settings; nothing is saved unless a reader does it.
SETTINGS = {"docmanager-extension/plugin": {"autosave": False}}
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
    """A folder like a clone, in which notebooks may be run."""
    folder = tmp_path_factory.mktemp("clone")
    for entry in ROOT.iterdir():
        if entry.name in ("notebooks", "course"):
            shutil.copytree(entry, folder / entry.name, ignore=shutil.ignore_patterns(".*"))
        elif not entry.name.startswith(".") and entry.name not in ("out", "my_notebooks"):
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
    arguments = ["--no-browser", "--LabApp.extension_manager=readonly"]
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
    """Wait for the file that the server hands to a browser, with the token."""
    deadline = time.monotonic() + PATIENCE_S
    while server.poll() is None and time.monotonic() < deadline:
        for page in folder.glob("jpserver-*-open.html"):
            if "token=" in page.read_text(encoding="utf-8"):
                return page.as_uri()
        time.sleep(0.1)
    pytest.fail(
        f"JupyterLab did not start:\n{log.read_text(encoding='utf-8', errors='replace')[-3000:]}"
    )


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


# WebGL keeps no picture after the frame
PICTURE = "canvas => { drawNow(); return canvas.toDataURL(); }"


def test_quickstart_opens_unchanged_runs_in_jupyterlab_and_its_points_turn(lab, clone, open_page):
    stored = (clone / STORED).read_bytes()
    cells = nbtools.code_cells(nbformat.reads(stored.decode(), as_version=4))
    page = open_page(1280, 900)
    page.goto(lab)
    prompts = page.locator(".jp-Notebook .jp-CodeCell .jp-InputPrompt")
    expect(prompts).to_have_count(len(cells))
    expect(page.locator("#jp-bottom-panel")).to_contain_text("| Idle")  # the kernel's state

    expect(page.locator(".lm-DockPanel-tabBar .lm-TabBar-tab.jp-mod-current")).to_have_count(1)
    expect(page.locator(".lm-DockPanel-tabBar .jp-mod-dirty")).to_have_count(0)
    choose(page, "Edit", "Clear Outputs of All Cells")
    # The input of a folded cell has no prompt.
    folded = [cell.metadata.get("jupyter", {}).get("source_hidden", False) for cell in cells]
    expect(prompts).to_have_text(["" if f else "[ ]:" for f in folded])
    # The first cells, and the one with the points: nbval runs all.
    points = next(n for n, cell in enumerate(cells) if "explore(depth" in cell.source)
    ran = [0, 1, 2, points]
    for n in ran:
        page.locator(".jp-CodeCell").nth(n).click()
        page.keyboard.press("Control+Enter")
    # errors, warnings
    wrong = page.locator('.jp-OutputArea-output[data-mime-type="application/vnd.jupyter.stderr"]')
    expect(
        prompts.nth(points).filter(has_text=re.compile(r"^\[\d+\]:$")).or_(wrong).first
    ).to_be_attached()
    page.screenshot(path=SEEN / "lab_run.png")
    assert wrong.all_text_contents() == []
    told = [f"[{1 + ran.index(n)}]:" if n in ran else "[ ]:" for n in range(len(cells))]
    expect(prompts).to_have_text(["" if f else text for f, text in zip(folded, told, strict=True)])

    view = page.locator(f"iframe[title='{stills.VIEW}']")
    view.scroll_into_view_if_needed()  # what is out of sight is not drawn
    view.content_frame.locator("body[data-drawn=points]").wait_for()
    canvas = view.content_frame.locator("#view")
    page.screenshot(path=SEEN / "lab_points_before.png")
    before = canvas.evaluate(PICTURE)
    # below the title and its buttons
    canvas.drag_to(
        canvas, source_position={"x": 300, "y": 300}, target_position={"x": 500, "y": 350}
    )
    assert canvas.evaluate(PICTURE) != before
    page.screenshot(path=SEEN / "lab_points_after.png")

    # it asks its readers nothing
    expect(page.locator(".jp-Dialog, .Toastify__toast")).to_have_count(0)
    assert page.complaints == []
    page.close()
    assert (clone / STORED).read_bytes() == (clone / QUICKSTART).read_bytes() == stored


def test_make_alone_lists_its_targets():
    targets = re.search(
        r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )[1].split()
    said = subprocess.run(["make"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert re.findall(r"^make ([\w-]+) +\w", said, re.MULTILINE) == targets


def test_a_class_can_be_graded_in_a_container():
    """The command alone: few machines that run the tests have Docker."""
    words = ["make", "-n", "grade", "HANDED_IN=notebooks", "CONTAINER=podman"]
    said = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert ".venv" not in said and "podman build" in said
    limits = ("--network none", "--read-only", "--memory", "--pids-limit", "--cap-drop ALL")
    for limit in (*limits, ":/handed-in:ro"):
        assert limit in said.partition("podman run")[2]


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Two stored notebooks, and the folder of their working copies."""
    monkeypatch.setattr(nbtools, "NOTEBOOKS", tmp_path / "notebooks")
    monkeypatch.setattr(lab_module, "WORKING", tmp_path / "my_notebooks")
    monkeypatch.setattr("jupyterlab.labapp.LabApp.launch_instance", lambda arguments: arguments)
    nbtools.NOTEBOOKS.mkdir()
    for name in ("00_a", "01_b"):
        nbformat.write(nbformat.v4.new_notebook(), nbtools.NOTEBOOKS / f"{name}.ipynb")
    return nbtools.NOTEBOOKS, lab_module.WORKING


def test_what_only_draws_is_known_from_what_is_needed_later():
    sources = ["a = nb00.check_f(f); show(a)", "fig = plot()\nshow(fig)", "b = 1; show(b)", "b + 1"]
    nb = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(one) for one in sources])
    assert [cell.source for cell in nbtools.drawing_cells(nb)] == [sources[1]]


def test_a_copy_with_an_old_number_is_kept_and_named(folders, capsys):
    lab_module.WORKING.mkdir()
    old = lab_module.WORKING / "06b_what_sweepnet_knows.ipynb"
    old.write_text("mine")
    lab_module.start([])
    assert old.read_text() == "mine"
    assert "06b_what_sweepnet_knows is now 09_what_sweepnet_knows" in capsys.readouterr().out


def test_working_copies_are_kept_until_one_is_renewed(folders, capsys):
    stored, working = folders
    lab_module.start([])
    original = (stored / "00_a.ipynb").read_text()
    assert [(working / path.name).read_text() for path in nbtools.notebooks()] == [original] * 2
    for mine in ("once", "twice"):
        (working / "00_a.ipynb").write_text(mine)
        lab_module.start([])
        assert (working / "00_a.ipynb").read_text() == mine
        lab_module.renew("00")
        assert (working / "00_a.ipynb").read_text() == original
    assert [(working / f"00_a-{k}.ipynb").read_text() for k in (1, 2)] == ["once", "twice"]
    assert capsys.readouterr().out.splitlines()[-2:] == [
        "your work is kept as 00_a-2.ipynb",
        "a fresh copy is in my_notebooks/00_a.ipynb",
    ]
    with refused("there is no notebook '7'; expected one of 00, 01"):
        lab_module.renew("7")
