"""Every command and every block of Python on every page runs as it stands, in the order of the
page.

Commands run in a copy of the clone if they are of the clone (`make`, `.venv/bin/python -m course`),
else in a folder that holds what the pages speak of. What cannot run here is marked in the page's
source with the reason: `<!-- not run: REASON; instead: ITS SMALLEST FORM -->`, before its block or
paragraph, once for all pages."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
import scene
import yaml
from printed_boards import APRIL_FILE, april_pictures
from served_commands import Server
from typed_commands import HELP, NOTEBOOKS, PAGES, ROOT, commands_of

import omnistereo_lib as osl
from omnistereo_lib.files import unpack
from omnistereo_lib.pictures import write_image
from omnistereo_rigs.formats.write import export_rig

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="the commands run in forked processes"
)
SIDES = ("front", "right", "back", "left")
FOREVER = ("omnistereo live", "omnistereo demo", "make demo")  # until Ctrl-C
# What this machine has in place of what a page speaks of.
REPLACED = {"--cameras 0 1 2 3": "--cameras front.mp4 right.mp4 back.mp4 left.mp4"}
# others, such as pip and docker, must not run in tests
PROGRAMS = {"omnistereo", "make", "python", "torchrun"}
SECONDS = 120  # for one command
ALL = {page: commands_of(page) for page in [*PAGES, *NOTEBOOKS, *HELP]}
# A mark holds for all pages; one that says what runs instead goes before one that does not.
MARKED = {c.text: c for commands in ALL.values() for c in commands if c.reason}
MARKED |= {c.text: c for commands in ALL.values() for c in commands if c.instead}
BLOCKS = {c.text for commands in ALL.values() for c in commands if c.language == "python"}
# Pictures of a checkerboard on which OpenCV finds it at once, by camera: a few for each pair of
# neighbours.
BOARDS = {
    1: "0001 0004 0035 0036",
    2: "0028 0035 0036 0040",
    3: "0005 0026 0028 0040 0048",
    4: "0001 0004 0048",
}


def test_every_command_is_run_or_marked():
    for command in (
        command for commands in ALL.values() for command in commands if command.language != "python"
    ):
        program = Path((_to_run(command) or "make").split()[0]).name
        assert program in PROGRAMS, f"{command}: nobody runs {program}; mark it"


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A copy of the clone, its environment installed; data and compiled library are links."""
    folder = tmp_path_factory.mktemp("copy") / "omnistereo"
    linked = ("data_samples", "omnistereo_")
    tracked = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout.decode()
    for name in filter(None, tracked.split("\0")):
        if not name.startswith(linked) and (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    for path in (ROOT / "data_samples", *ROOT.glob("omnistereo_*")):
        if path.suffix != ".egg-info":
            (folder / path.name).symlink_to(path)
    environment = Path(sys.executable).parents[1]
    (folder / ".venv").mkdir()
    for path in environment.iterdir():
        (folder / ".venv" / path.name).symlink_to(path)
    for stamp in (".installed", ".installed-dev"):
        (folder / ".venv" / stamp).unlink(missing_ok=True)
        (folder / ".venv" / stamp).touch()
    hand_in = folder / "folder" / "04_zncc.ipynb"
    hand_in.parent.mkdir()
    shutil.copy2(ROOT / "notebooks" / "04_zncc.ipynb", hand_in)
    shutil.copy2(hand_in, folder / "my_notebook.ipynb")
    return folder


@pytest.fixture(scope="module")
def shell(clone):
    """The environment of the commands: this one's programs, the copy's modules, small grids."""
    return os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(clone),
        "OMNISTEREO_TINY": "1",
        "BROWSER": "true",
    }


@pytest.fixture(scope="module")
def server(tmp_path_factory, shell):
    server = Server(tmp_path_factory.mktemp("server"), env=shell)
    yield server
    server.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The files that pages speak of, by the names that they use."""
    folder = tmp_path_factory.mktemp("files")
    frame = osl.load_dataset(ROOT / "data_samples/sunny", split="test").frame(831)
    small = frame.reduced(2.0)
    rig, images = small.rig, small.images
    for k, (side, image, whole) in enumerate(zip(SIDES, images, frame.images, strict=True), 1):
        # a frame whose pictures are those of another one is no frame of a drive
        darker = (0.9 * image).astype(np.uint8)
        for name in (f"{side}.png", f"{k}.png", f"{side}/0001.png", f"{side}/0002.png"):
            (folder / name).parent.mkdir(exist_ok=True)
            write_image(folder / name, darker if "0002" in name else image)
        write_image(folder / f"cam{k}.png", whole)
        scene.write_video(folder / f"{side}.mp4", [image] * 2, 5, "mp4v")
    for name in ("rig.yaml", "lenses.yaml"):
        osl.save_rig(rig if name == "rig.yaml" else frame.rig, folder / name)
    export_rig(rig, folder)
    (folder / "calibration.json").write_text(
        json.dumps(yaml.safe_load((folder / "kalibr.yaml").read_text()))
    )
    shutil.copy(folder / "kalibr.yaml", folder / "camchain.yaml")
    unpack(ROOT / "data_samples/sunny/train")
    (folder / "my_frames").symlink_to(ROOT / "data_samples/sunny/train")
    for k, names in BOARDS.items():
        (folder / "pictures" / f"cam{k}").mkdir(parents=True)
        for name in names.split():
            shutil.copy(
                ROOT / f"data_samples/calibration/van/cam{k}/{name}.jpg",
                folder / "pictures" / f"cam{k}",
            )
    shutil.copytree(folder / "pictures", folder / "my_rig" / "boards")
    (folder / "my_rig" / "scene").mkdir()
    for k in range(1, 5):
        shutil.copy(folder / f"cam{k}.png", folder / "my_rig" / "scene")
    (folder / "aprilgrid.yaml").write_text(APRIL_FILE)
    (folder / "april" / "cam1").mkdir(parents=True)
    for k, picture in enumerate(april_pictures(8)):
        cv2.imwrite(str(folder / "april" / "cam1" / f"{k:04}.jpg"), picture)
    return folder


@pytest.fixture(scope="module")
def run(server, shell, clone):
    """Return a function that runs a line in a folder: exit status and what it prints."""

    def run(line, folder):
        server.log_path.write_text("")
        if line in BLOCKS:
            return server.run("python", line, folder=folder), server.log()
        words = shlex.split(line.replace("\\\n", ""))
        if line.startswith(FOREVER) and "--help" not in line:
            return _run_until_stopped(line, folder, shell)
        if words[0] == "omnistereo" and not re.search("[|<>&;]", line):
            return server.run(*words[1:], folder=folder), server.log()
        done = subprocess.run(
            ["bash", "-e", "-c", line],
            cwd=folder,
            env=shell,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=SECONDS,
        )
        return done.returncode, done.stdout + done.stderr

    return run


def _run_until_stopped(line, folder, shell):
    """Start what serves a page, open the page, and stop it by Ctrl-C; return as `run`."""
    process = subprocess.Popen(
        ["bash", "-c", f"exec {line}"], cwd=folder, env=shell, stdout=subprocess.PIPE, text=True
    )
    address = next(found[0] for text in process.stdout if (found := re.search(r"http://\S+", text)))
    assert b"<html" in urlopen(address, timeout=60).read()
    process.send_signal(signal.SIGINT)
    return process.wait(60), process.stdout.read()


def _is_of_the_clone(line):
    ours = ("make ", ".venv", "python -m course", "python -m workshop")
    return line.startswith(ours) or line in BLOCKS


def _to_run(command):
    """Return the line that is run for a command; None if another test runs it, or nothing can."""
    if command.text in MARKED:
        return MARKED[command.text].instead
    if command.language == "python":
        return command.text
    line = command.text
    for words, here in REPLACED.items():
        line = line.replace(words, here)
    # An `omnistereo depth` that is only named within a sentence is none that anybody types.
    return (
        f"{line} --help"
        if re.fullmatch("omnistereo [a-z]+", line) and command.language == "inline"
        else line
    )


RUN: set[str] = set()  # of all pages so far, lines and kinds of commands


@pytest.mark.parametrize(
    "page",
    [
        page if page == "README.md" else pytest.param(page, marks=pytest.mark.slow)
        for page in ALL
        if ALL[page]
    ],
)
def test_page(page, run, files, clone, tmp_path):
    folder = tmp_path / "empty"
    shutil.copytree(files, folder, symlinks=True)
    failed = []
    for command in ALL[page]:
        line = _to_run(command)
        # Once for all pages, but for a block of a page, whose lines need each other.
        alone = (
            command.language == "inline"
            or {command.text, page} & {*MARKED, *HELP}
            or _is_of_the_clone(line or "")
        )
        if line is None or (line in RUN and alone):
            continue
        _choose_boards(folder, "april" if "aprilgrid.yaml" in line else "pictures")
        where = clone if _is_of_the_clone(line) else folder
        # A second run meets what the first has left: once for each command that writes; of
        # calibrate in `test_kills`.
        kind = " ".join(re.findall("^omnistereo [a-z]+", line))
        once = (
            kind in RUN
            or not kind
            or line.startswith((*FOREVER, "omnistereo doctor", "omnistereo calibrate"))
        )
        for attempt in ("at first",) if once else ("at first", "again"):
            began = time.perf_counter()
            status, said = run(line, where)
            print(f"{time.perf_counter() - began:5.1f} s  {line!r}", flush=True)
            failed += (
                [f"{line}\n  exit status {status} {attempt}: {said[-2000:]}"] if status else []
            )
        # What a command proposes to run, run at once.
        for advice in re.findall("^omnistereo .*$", said, re.MULTILINE):
            status, said = run(advice, where)
            failed += (
                [f"{advice}\n  advice of {line}: exit status {status}: {said[-2000:]}"]
                if status
                else []
            )
        RUN.update((line, kind))
    assert not failed, "\n\n".join(failed)


def _choose_boards(folder, name):
    """Let `boards`, as pages call it, hold the pictures of one kind of board."""
    (folder / "boards").unlink(missing_ok=True)
    (folder / "boards").symlink_to(folder / name)


def test_an_error_says_what_to_type(run, files, tmp_path):
    folder = shutil.copytree(files, tmp_path / "empty", symlinks=True)
    line = "omnistereo rig opencv.yaml own.yaml"
    status, said = run(line, folder)
    assert status == 2 and "--unit" in said, said
    status, said = run(f"{line} --unit m", folder)
    assert status == 0, said
