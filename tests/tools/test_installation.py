"""The check of the installation: a line for each requirement, and the fix with each failure."""

from importlib import metadata

import pytest

from omnistereo_tools import installation as doctor


@pytest.fixture
def requires(monkeypatch):
    """What the installed distribution says that it needs."""
    requires = ["numpy>=1.2", 'no-such-package-here>=3; extra == "course"', "PyYAML"]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: requires)
    return requires


def test_the_requirements_of_the_distribution(requires, capsys):
    assert doctor.doctor() is True
    text = capsys.readouterr().out
    verdict, *lines = text.splitlines()
    assert all(line[:6] in ("OK    ", "NOTE  ") for line in lines)
    assert verdict == "OK    Python and packages are in place"
    words = ("Python 3.", "numpy", "cores", "GiB memory free", "GPU", "python -m course doctor")
    for word in words:
        assert word in text
    requires += ["numpy>=99.1", "no-such-package-here>=3.1"]
    assert doctor.doctor() is False
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("FAIL")] == [
        f"FAIL  numpy is {metadata.version('numpy')}: pip install 'numpy>=99.1'",
        "FAIL  no-such-package-here is missing: pip install 'no-such-package-here>=3.1'",
    ]
    assert lines[0] == "2 things to fix, marked FAIL"


def test_an_old_python(requires, monkeypatch, capsys):
    monkeypatch.setattr(doctor.sys, "version_info", (3, 10, 4))
    assert doctor.doctor() is False
    assert "FAIL  Python 3.10.4: install 3.11 or newer" in capsys.readouterr().out
