"""Files that are there whole or not at all, and folders that can be written to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from omnistereo_lib.errors import OmnistereoError


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside a file and rename it on success; on failure nothing is left."""
    temporary = path.with_name(f".{os.getpid()}.{path.name}")  # the same ending: writers look at it
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise OmnistereoError(f"{path} cannot be written: {error.strerror}. Choose a writable folder") from None
    finally:
        with suppress(OSError):
            temporary.unlink()


def make_folder(path: Path) -> Path:
    """Create a folder and its parents, check that it can be written to, and return its path."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            return path
    except OSError as error:
        raise OmnistereoError(f"folder {path} cannot be written to: {error.strerror}. Choose another") from None
