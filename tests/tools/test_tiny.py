"""What tests of the pages run: the commands as they are typed, small."""

from pathlib import Path

import pytest

from omnistereo_learn import RECIPES
from omnistereo_tools.commands.live_command import LiveOptions
from omnistereo_tools.parser import shrink


@pytest.mark.parametrize("tiny", ["", "1"])
def test_what_is_typed_is_capped(monkeypatch, tiny):
    monkeypatch.setenv("OMNISTEREO_TINY", tiny)
    typed = LiveOptions(rig=Path("r"), cameras=("0", "1"), grid="1200x400x8")
    assert typed.sizes == ((96, 32, 8) if tiny else (1200, 400, 8))
    recipe = RECIPES["sweepnet"]["shipped"]
    assert (shrink(recipe).steps, shrink(recipe).height) == (
        (1, 24) if tiny else (recipe.steps, recipe.height)
    )
