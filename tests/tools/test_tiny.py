"""What tests of the pages run: the commands as they are typed, small."""

import argparse

import pytest

from omnistereo_lib.train import RECIPES
from omnistereo_tools.tiny import shrink


@pytest.mark.parametrize("tiny", ["", "1"])
def test_what_is_typed_is_capped(monkeypatch, capsys, tiny):
    monkeypatch.setenv("OMNISTEREO_TINY", tiny)
    typed = argparse.Namespace(width=1200, height=400, spheres=8, phi=[-60, 60], out="out")
    expected = argparse.Namespace(width=96, height=32, spheres=8, phi=[-60, 60], out="out") if tiny else typed
    assert shrink(typed) == expected
    assert ("OMNISTEREO_TINY is set" in capsys.readouterr().err) is bool(tiny)
    recipe = RECIPES["sweepnet"]["shipped"]
    assert (shrink(recipe).steps, shrink(recipe).height) == ((1, 24) if tiny else (recipe.steps, recipe.height))
