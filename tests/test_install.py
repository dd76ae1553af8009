"""The wheel, installed apart from the clone: complete, without the course."""

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

PACKAGES = ("omnistereo_lib", "omnistereo_rigs", "omnistereo_learn", "omnistereo_tools")
ROOT = Path(osl.__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel and the folder that it is installed into."""
    pytest.importorskip(
        "hatchling", reason="hatchling is not installed: environment-dev.txt has it"
    )
    folder = tmp_path_factory.mktemp("install")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        check=True,
        cwd=ROOT,
    )
    (wheel,) = folder.glob("*.whl")
    # as pip does, for a wheel without compiled files
    ZipFile(wheel).extractall(folder / "packages")
    return wheel, folder / "packages"


def test_what_is_in_the_wheel(installed):
    names = ZipFile(installed[0]).namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {*PACKAGES, next(name for name in tops if name.endswith(".dist-info"))}
    files = (path for folder in PACKAGES for path in (ROOT / folder).rglob("*"))
    here = {path.relative_to(ROOT).as_posix() for path in files if path.is_file()}
    here = {name for name in here if "__pycache__" not in name}
    assert {name for name in names if name.startswith("omnistereo_")} - here == {
        name for name in names if ".dist-info/" in name
    }
    assert here <= set(names)
    assert {"omnistereo_lib/py.typed", "omnistereo_lib/weights/sweepnet.safetensors"} <= here
    assert (
        sum(path.stat().st_size for path in (ROOT / "omnistereo_lib/sample").rglob("*")) < 1_300_000
    )


FILES = ("environment.txt", "environment-dev.txt", "constraints.txt")
PINNED = "".join((ROOT / name).read_text() for name in FILES)
PINS = dict(re.findall(r"^([\w.-]+)==(\S+)", PINNED, re.M))


def test_every_pin_can_be_installed_on_the_oldest_python():
    """README promises 3.11; Debian 12 has 3.11.2."""
    needed = {name: metadata(name).get("Requires-Python", "") for name in PINS}
    assert {
        name: python for name, python in needed.items() if "3.11.0" not in SpecifierSet(python)
    } == {}


def test_the_pins_are_a_lock():
    """Pip and uv install the same versions today and in a year: every package has a pin."""
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


SCRIPT = """
import omnistereo_lib as osl
from omnistereo_tools import cli
from omnistereo_tools.commands.options import SAMPLE
print(osl.__file__, len(osl.load_dataset(SAMPLE)[0].images), osl.VolumeNet.pretrained())
print("status", cli.main(["doctor"]), cli.main(["evaluate", "--sets", "sunny"]))
"""


def test_without_the_clone(installed, tmp_path):
    """The sample and the weights are found; what needs the clone says so."""
    environment = {**os.environ, "PYTHONPATH": str(installed[1])}
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    where, images, *_ = done.stdout.split()
    assert Path(where).is_relative_to(installed[1]) and images == "4"
    assert "NOTE  packages and data of the course are not checked" in done.stdout
    assert "OK    torch 2" in done.stdout and "jupyterlab" not in done.stdout
    assert done.stdout.endswith("status 0 2\n") and re.fullmatch("error: .*\n", done.stderr)
