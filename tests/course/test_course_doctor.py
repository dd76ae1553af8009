"""The doctor of the clone: a line for each requirement, with its fix, never a crash."""

import hashlib
import json
import os
import subprocess
import sys
import venv
from importlib import metadata

import pytest

from course import __main__, nbtools
from course.classroom import doctor
from course.classroom.doctor import check_clone

ROOT = nbtools.ROOT


@pytest.fixture
def healthy(tmp_path, monkeypatch):
    """A clone with one pinned package and one data file, both correct."""
    (tmp_path / "environment.txt").write_text(
        f"# pins\nnumpy=={metadata.version('numpy')}  # arrays\n"
    )
    (tmp_path / "data_samples").mkdir()
    (tmp_path / "data_samples" / "a.txt").write_text("data")
    manifest = {"files": {"a.txt": hashlib.sha256(b"data").hexdigest()}}
    (tmp_path / "data_samples" / "manifest.json").write_text(json.dumps(manifest))
    monkeypatch.setattr(doctor, "_ROOT", tmp_path)
    return tmp_path


def test_all_is_well(healthy, capsys):
    assert __main__.main(["doctor"]) == 0
    text = capsys.readouterr().out
    verdict, *lines = text.splitlines()
    assert all(line[:6] in ("OK    ", "NOTE  ") for line in lines)
    assert verdict.endswith("are in place")
    for word in ("Python 3.", "numpy", "data_samples: 1 files", "cores"):
        assert word in text


def test_ctrl_c_is_one_line(monkeypatch, capsys):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "check_clone", stop)
    assert __main__.main(["doctor"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_without_the_pins(healthy, capsys):
    (healthy / "environment.txt").unlink()
    assert check_clone() is False
    said = capsys.readouterr().out
    assert "FAIL  environment.txt is missing: git checkout environment.txt\n" in said


def test_a_package_that_is_missing_or_another_version(healthy, capsys):
    (healthy / "environment.txt").write_text("no-such-package-here==1.0\nnumpy==0.1  # old\n")
    assert check_clone(short=True) is False
    fix = f"{sys.executable} -m pip install -r environment.txt"
    assert capsys.readouterr().out.splitlines() == [
        f"FAIL  no-such-package-here is missing, the course is tested with 1.0: {fix}",
        f"FAIL  numpy is {metadata.version('numpy')}, the course is tested with 0.1: {fix}",
    ]


@pytest.mark.parametrize("change", ["other", None], ids=["changed", "missing"])
def test_data_that_is_not_what_was_released(healthy, capsys, change):
    file = healthy / "data_samples" / "a.txt"
    file.write_text(change) if change else file.unlink()
    assert check_clone(short=True) is False
    expected = "FAIL  1 of 1 data files are missing or changed (a.txt): git checkout data_samples\n"
    assert capsys.readouterr().out == expected


def test_a_manifest_that_is_missing_or_broken(healthy, capsys):
    manifest = healthy / "data_samples" / "manifest.json"
    for content in ("{", "[]", '{"files": 3}', "[" * 100_000):
        manifest.write_text(content)
        assert check_clone(short=True) is False
        assert "manifest.json is broken: git checkout data_samples" in capsys.readouterr().out
    manifest.unlink()
    assert check_clone(short=True) is False
    said = capsys.readouterr().out
    assert "manifest.json is missing from data_samples: git checkout data_samples" in said


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    """A Python without any package, as after an installation that failed."""
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, with_pip=False)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def run_bare(command):
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)


def test_it_needs_no_package(bare):
    done = run_bare([bare, "-m", "course", "doctor"])
    assert done.returncode == 1 and done.stderr == ""
    assert f"packages of environment.txt is installed for {bare}: make lab\n" in done.stdout
    assert "OK    data_samples: " in done.stdout


def test_other_commands_without_packages_are_one_line_that_names_it(bare):
    done = run_bare([bare, "-m", "course", "lab"])
    assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: No module named ")
    assert "python -m course doctor" in done.stderr


def test_the_short_form_is_quick_to_start():
    """It does not load torch."""
    code = (
        "import sys; from course.classroom.doctor import doctor; doctor(True); print('torch' in"
        " sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False"
