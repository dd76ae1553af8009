"""The examples in the docstrings of the public names: they run, and say what comes out."""

import doctest
from pathlib import Path

import numpy as np
import pytest

import omnistereo_lib as osl


@pytest.mark.parametrize("name", osl.__all__)
def test_examples(name, tmp_path, monkeypatch):
    """An example may use `np`, `osl` and `data_samples`; what it writes goes into an empty
    folder.
    """
    (tmp_path / "data_samples").symlink_to(Path(__file__).resolve().parents[1] / "data_samples")
    monkeypatch.chdir(tmp_path)
    value = getattr(osl, name)
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    runner.run(
        parser.get_doctest(value.__doc__, {"np": np, "osl": osl}, name, value.__module__, None)
    )
    assert runner.failures == 0
    assert runner.tries > 0, f"{name} has no example"
