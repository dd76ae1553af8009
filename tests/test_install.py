"""The wheel, installed apart from the clone: complete, without the course, and it runs from an empty folder."""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import metadata, requires
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import omnistereo_lib as osl

ROOT = Path(osl.__file__).resolve().parents[1]
SMALL = ["--width", "96", "--height", "24", "--spheres", "16"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel and the folder that it is installed into."""
    pytest.importorskip("hatchling", reason="hatchling is not installed: environment-dev.txt has it")
    folder = tmp_path_factory.mktemp("install")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run(wheel, check=True, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    target = [*pip, "install", "--no-deps", "--no-index", "--target", str(folder / "packages"), str(wheel)]
    subprocess.run(target, check=True, cwd=folder)
    return wheel, folder / "packages"


@pytest.fixture
def run(installed, tmp_path):
    """Run Python from an empty folder with the installed package before the clone."""

    def run_python(*arguments):
        environment = {**os.environ, "PYTHONPATH": str(installed[1])}
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert "Traceback" not in done.stderr
        return done

    return run_python


def test_what_is_in_the_wheel(installed):
    names = ZipFile(installed[0]).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"omnistereo_lib", "omnistereo_tools", next(name for name in tops if name.endswith(".dist-info"))}
    files = (path for folder in ("omnistereo_lib", "omnistereo_tools") for path in (ROOT / folder).rglob("*"))
    here = {path.relative_to(ROOT).as_posix() for path in files if path.is_file()}
    here = {name for name in here if "__pycache__" not in name}
    assert {name for name in names if name.startswith("omnistereo_")} - here == {
        name for name in names if ".dist-info/" in name
    }
    assert here <= set(names)
    assert {"omnistereo_lib/py.typed", "omnistereo_lib/weights/sweepnet.safetensors"} <= here
    assert sum(path.stat().st_size for path in (ROOT / "omnistereo_lib/sample").rglob("*")) < 700_000


PINS = dict(
    re.findall(
        r"^([\w.-]+)==(\S+)",
        "".join((ROOT / name).read_text() for name in ("environment.txt", "environment-dev.txt", "constraints.txt")),
        re.M,
    )
)


def test_every_pin_can_be_installed_on_the_oldest_python():
    """README promises 3.11; Debian 12 has 3.11.2."""
    needed = {name: metadata(name).get("Requires-Python", "") for name in PINS}
    assert {name: python for name, python in needed.items() if "3.11.0" not in SpecifierSet(python)} == {}


def test_the_pins_are_a_lock():
    """Pip and uv install the same versions today and in a year: no package brings one along that has no pin."""
    pinned = {canonicalize_name(name) for name in PINS}
    left, brought = [Requirement(name) for name in PINS], {}
    while left:
        asking = left.pop()
        for text in requires(asking.name) or []:
            asked = Requirement(text)
            extras = asking.extras or {""}
            if not asked.marker or any(asked.marker.evaluate({"extra": extra}) for extra in extras):
                name = canonicalize_name(asked.name)
                if name not in pinned and name not in brought:
                    brought[name] = asking.name
                if asked.extras:
                    left.append(asked)
    of_builds = re.compile(r"setuptools|triton|(nvidia|cuda)-.*")  # what a build of torch asks for
    assert {name: by for name, by in brought.items() if not of_builds.fullmatch(name)} == {}


def test_depth_of_the_sample_from_an_empty_folder(run, installed, tmp_path):
    where = run("-c", "import omnistereo_lib; print(omnistereo_lib.__file__)").stdout.strip()
    assert Path(where).is_relative_to(installed[1])
    done = run("-m", "omnistereo_tools", "depth", *SMALL)
    assert done.returncode == 0, done.stderr
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == ["data", "index.html", "overview.png"]
    assert json.loads((tmp_path / "out" / "data" / "errors.json").read_text())["MAE"] < 10


def test_doctor_without_the_clone(run):
    done = run("-m", "omnistereo_tools", "doctor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "NOTE  packages and data of the course are not checked" in done.stdout
    assert "OK    torch 2" in done.stdout and "jupyterlab" not in done.stdout


def test_what_needs_the_clone_says_so(run):
    done = run("-m", "omnistereo_tools", "evaluate", "--sets", "sunny")
    assert done.returncode == 2 and done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
