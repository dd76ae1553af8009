"""`OMNISTEREO_TINY=1` caps panoramas, frames and steps of every command, so that tests can run what pages print."""

import os
from dataclasses import replace
from typing import Any, TypeVar

_Settings = TypeVar("_Settings")
_CAPS = {"width": 96, "spheres": 16, "num_spheres": 16, "steps": 1, "batch_frames": 1, "validation_groups": 1}


def is_tiny() -> bool:
    """Return whether the results are to be small and quick, and mean nothing."""
    return os.environ.get("OMNISTEREO_TINY") == "1"


def shrink(settings: _Settings) -> _Settings:
    """Return a dataclass with every number at most its cap, the height by as much as the width, if `is_tiny`."""
    known: dict[str, Any] = vars(settings)
    if not is_tiny() or "width" not in known:
        return settings
    capped = {name: min(known[name], most) for name, most in _CAPS.items() if name in known}
    if known["height"] is not None:
        capped["height"] = max(1, round(known["height"] * capped["width"] / known["width"]))
    return replace(settings, **capped)  # type: ignore[type-var]  # what has no fields is no settings
