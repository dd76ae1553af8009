"""What tests of the pages run: the commands as they are typed, small."""

from dataclasses import replace
from pathlib import Path

import pytest

from omnistereo_learn import RECIPES
from omnistereo_tools.commands.live_command import LiveOptions
from omnistereo_tools.parser import shrink


@pytest.mark.parametrize("tiny", ["", "1"])
def test_what_is_typed_is_capped(monkeypatch, tiny):
    monkeypatch.setenv("OMNISTEREO_TINY", tiny)
    typed = LiveOptions(
        rig=Path("r"), cameras=("0", "1"), width=1200, height=400, spheres=8, phi=(-60, 60)
    )
    assert shrink(typed) == (replace(typed, width=96, height=32) if tiny else typed)
    recipe = RECIPES["sweepnet"]["shipped"]
    assert (shrink(recipe).steps, shrink(recipe).height) == (
        (1, 24) if tiny else (recipe.steps, recipe.height)
    )
