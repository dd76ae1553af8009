"""The captions of the figures, which notebooks/captions.yaml holds by name."""

from functools import cache
from pathlib import Path
from typing import Any

import yaml

CAPTIONS = Path(__file__).resolve().parents[2] / "notebooks" / "captions.yaml"


@cache
def captions() -> dict[str, dict[str, Any]]:
    """Return caption, alternative text and kind of every figure, by name."""
    return yaml.safe_load(CAPTIONS.read_text(encoding="utf-8"))


def caption_output(caption: str) -> dict[str, str]:
    """Return a caption in the forms in which a notebook stores it."""
    return {"text/markdown": f"*Figure:* {caption}", "text/plain": caption}
