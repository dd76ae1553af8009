"""`OMNISTEREO_TINY=1` caps panoramas, frames and steps of every command, so that tests can run what pages print."""

import argparse
import os
import sys
from dataclasses import replace
from typing import Any

_CAPS = {"width": 96, "spheres": 16, "num_spheres": 16, "steps": 1, "batch_frames": 1, "validation_groups": 1}


def is_tiny() -> bool:
    """Return whether the results are to be small and quick, and mean nothing."""
    return os.environ.get("OMNISTEREO_TINY") == "1"


def shrink(settings: Any) -> Any:
    """Return options or a dataclass of settings with every number at most its cap, the height by as much as the width.

    Does nothing unless `is_tiny`.
    """
    known = vars(settings)
    if not is_tiny() or "width" not in known:
        return settings
    capped = {name: min(known[name], most) for name, most in _CAPS.items() if name in known}
    if known["height"] is not None and known["width"] > 0:
        capped["height"] = max(1, round(known["height"] * capped["width"] / known["width"]))
    if isinstance(settings, argparse.Namespace):
        print("OMNISTEREO_TINY is set: the results are too small to mean anything", file=sys.stderr)
        return argparse.Namespace(**known | capped)
    return replace(settings, **capped)
