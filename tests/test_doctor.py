"""The doctor: a line for each requirement, the fix with each failure, never a crash."""

import hashlib
import importlib
import json
import subprocess
import sys
from importlib import metadata

import pytest

from omnistereo_lib import cli
from omnistereo_lib.doctor import check_installation

doctor = importlib.import_module("omnistereo_lib.doctor")  # the module; the package has the function under this name


@pytest.fixture
def healthy(tmp_path, monkeypatch):
    """A clone with one pinned package and one data file, both correct."""
    (tmp_path / "environment.txt").write_text(f"# pins\nnumpy=={metadata.version('numpy')}  # arrays\n")
    (tmp_path / "data_samples").mkdir()
    (tmp_path / "data_samples" / "a.txt").write_text("data")
    manifest = {"files": {"a.txt": hashlib.sha256(b"data").hexdigest()}}
    (tmp_path / "data_samples" / "manifest.json").write_text(json.dumps(manifest))
    monkeypatch.setattr(doctor, "_ROOT", tmp_path)
    monkeypatch.setattr(doctor, "opengl_works", lambda: True)
    return tmp_path


def test_all_is_well(healthy, capsys):
    assert check_installation() is True
    lines = capsys.readouterr().out.splitlines()
    assert all(line[:6] in ("OK    ", "NOTE  ") for line in lines)
    text = "\n".join(lines)
    for word in ("Python 3.", "numpy", "data_samples: 1 files", "OpenGL", "cores", "GiB memory free", "GPU"):
        assert word in text


def test_the_short_form_is_the_same_everywhere(healthy, capsys):
    """It is the first output of every notebook, and compared."""
    assert check_installation(short=True) is True
    assert capsys.readouterr().out == "OK    Python, packages and data are in place\n"


def test_a_package_that_is_missing_or_another_version(healthy, capsys):
    (healthy / "environment.txt").write_text("no-such-package-here==1.0\nnumpy==0.1  # old\n")
    assert check_installation(short=True) is False
    assert capsys.readouterr().out.splitlines() == [
        "FAIL  no-such-package-here is missing, the course is tested with 1.0: pip install -r environment.txt",
        f"FAIL  numpy is {metadata.version('numpy')}, the course is tested with 0.1: pip install -r environment.txt",
    ]


def test_a_local_build_counts_as_its_version(healthy, monkeypatch):
    (healthy / "environment.txt").write_text("torch==2.0.0\n")
    monkeypatch.setattr(doctor.metadata, "version", lambda name: "2.0.0+cpu")
    assert check_installation(short=True) is True


@pytest.mark.parametrize("change", ["other", None], ids=["changed", "missing"])
def test_data_that_is_not_what_was_released(healthy, capsys, change):
    file = healthy / "data_samples" / "a.txt"
    file.write_text(change) if change else file.unlink()
    assert check_installation(short=True) is False
    expected = "FAIL  1 of 1 data files are missing or changed (a.txt): git checkout data_samples\n"
    assert capsys.readouterr().out == expected


def test_a_manifest_that_is_missing_or_broken(healthy, capsys):
    manifest = healthy / "data_samples" / "manifest.json"
    manifest.write_text("{")
    assert check_installation(short=True) is False
    assert "manifest.json is broken: git checkout data_samples" in capsys.readouterr().out
    manifest.unlink()
    assert check_installation(short=True) is False
    assert "manifest.json is missing from data_samples: git checkout data_samples" in capsys.readouterr().out


def test_without_the_clone_the_requirements_of_the_distribution_count(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_ROOT", tmp_path)
    requires = ["numpy>=1.2", 'no-such-package-here>=3; extra == "course"', "PyYAML"]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: requires)
    assert check_installation(short=True) is True
    assert capsys.readouterr().out == "OK    Python and packages are in place\n"
    requires += ["numpy>=99.1", "no-such-package-here>=3.1"]
    assert check_installation() is False
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("FAIL")] == [
        f"FAIL  numpy is {metadata.version('numpy')}: pip install 'numpy>=99.1'",
        "FAIL  no-such-package-here is missing: pip install 'no-such-package-here>=3.1'",
    ]
    assert "NOTE  installed without the course: data_samples is not checked" in lines


def test_images_without_a_rig_are_not_ignored(tmp_path, capsys):
    assert cli.main(["doctor", "--images", str(tmp_path / "a.png")]) == 2
    assert "--images needs --rig" in capsys.readouterr().err


def test_an_old_python(healthy, monkeypatch, capsys):
    monkeypatch.setattr(doctor.sys, "version_info", (3, 10, 4))
    assert check_installation(short=True) is False
    assert "FAIL  Python 3.10.4: install 3.11 or newer" in capsys.readouterr().out


def test_what_is_only_a_note(healthy, monkeypatch, capsys):
    monkeypatch.setattr(doctor, "opengl_works", lambda: False)
    monkeypatch.setattr(doctor, "_MIN_MEMORY_GIB", 1e6)
    assert check_installation() is True
    out = capsys.readouterr().out
    assert "NOTE  no OpenGL: point clouds are drawn by NumPy; on Debian: apt install" in out
    assert "at least 1000000.0 GiB are needed, close other programs" in out


@pytest.mark.parametrize(
    "probe",
    ["import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "raise RuntimeError", "import time; time.sleep(99)"],
    ids=["crashes", "raises", "hangs"],
)
def test_a_probe_that_fails_does_not_take_us_along(monkeypatch, probe):
    monkeypatch.setattr(doctor, "_RENDER_PROBE", probe)
    monkeypatch.setattr(doctor, "_PROBE_SECONDS", 1)
    assert doctor.opengl_works() is False


def test_the_short_form_is_quick_to_start():
    """It loads neither torch nor PyVista."""
    code = "import sys, omnistereo_lib as osl; osl.doctor(short=True); print({'torch', 'pyvista'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
