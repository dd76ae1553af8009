"""The examples in the docstrings of the public names: they run, and say what comes out."""

import doctest
from pathlib import Path

import numpy as np
import pytest

import omnistereo_lib as osl
import omnistereo_rigs

NAMES = [(osl, name) for name in osl.__all__]
NAMES += [(omnistereo_rigs, name) for name in omnistereo_rigs.__all__ if "_rig" not in name]
NAMES += [(omnistereo_rigs, name) for name in ("calibrate_rig", "read_any_rig")]


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_examples(package, name, tmp_path, monkeypatch):
    """An example may use `np`, `osl`, `data_samples`; it writes into an empty folder."""
    (tmp_path / "data_samples").symlink_to(Path(__file__).resolve().parents[1] / "data_samples")
    monkeypatch.chdir(tmp_path)
    value = getattr(package, name)
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    names = {"np": np, "osl": osl, "omnistereo_rigs": omnistereo_rigs}
    runner.run(parser.get_doctest(value.__doc__, names, name, value.__module__, None))
    assert runner.failures == 0
    assert runner.tries > 0, f"{name} has no example"
