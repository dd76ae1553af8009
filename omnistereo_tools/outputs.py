"""What a command writes: nothing that it reads, and nothing that another run is writing.

Each passes what it will write to `check_outputs`, before any work, and holds its folder from when
it begins to write.
"""

import os
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING

from omnistereo_lib.errors import OmnistereoError
from omnistereo_tools.parser import Options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# options that name files, or folders of files, pictures and data sets
_SETS = ("rig", "sets", "data")
READ = (
    *("images", "from_images", "source", "folder", "board", "weights", "init_weights"),
    *("recording", "beside", *_SETS),
)
# of such a folder
_CONTENT = ("*", "cam[0-9]*/*", "*depth_*/*", "confidence_*/*")
_BELOW = {"folder": ("*/*",)} | dict.fromkeys(_SETS, ("*/cam[0-9]*/*", "*/*depth_*/*"))
_TEXTS = (".yaml", ".yml", ".json", ".txt", ".xml")

_held: list[int] = []  # descriptors of folders


def check_outputs(
    options: Options,
    files: Iterable[Path | None],
    folders: Iterable[Path] = (),
    unread: Collection[str] = (),
) -> None:
    """Raise an `OmnistereoError` if a command would write over a file that its options name, by
    whatever path, or one of its outputs over another.

    Args:
        files: Files that will be written; None: not asked for.
        folders: Folders that will be filled: none of what is read may be in them.
        unread: Options whose files this command will not read.
    """
    targets = [*filter(None, files), *folders]
    _check_apart(targets)
    if not any(target.exists() for target in targets):
        return
    read = [path for path in _files_read(options, unread) if path.is_file()]
    known = {_identity(path): path for path in read}
    known |= {
        _identity(folder): path for path in read for folder in (path.parent, path.resolve().parent)
    }
    for target in targets:
        if target.exists() and _identity(target) in known:
            found = known[_identity(target)]
            raise OmnistereoError(
                f"{found} is read, and writing {target} would write over it. Choose another name."
            )


def _check_apart(targets: Sequence[Path]) -> None:
    """Raise an `OmnistereoError` if one output lies where, or in what, another one is written."""
    places = [Path(os.path.realpath(target)) for target in targets]
    for (one, place), (other, inner) in permutations(zip(targets, places, strict=True), 2):
        if inner == place or place in inner.parents:
            raise OmnistereoError(
                f"{other} and {one} would both be written by this command, one over or into the "
                "other. Choose another name."
            )


def hold(folder: Path) -> Path:
    """Make a folder, let no other run write into it until `let_go`, and return it.

    The system lets go of it when the process ends, however it does. Raises an `OmnistereoError` if
    another run holds it. Windows and some network file systems have no such locks: there nothing is
    held.
    """
    from omnistereo_lib.files import make_folder

    make_folder(folder)
    if os.name == "posix":
        import fcntl

        _held.append(os.open(folder, os.O_RDONLY))
        try:
            fcntl.flock(_held[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OmnistereoError(
                f"another run is writing into {folder}. Wait for it, or choose another."
            ) from None
        except OSError:  # the file system has no locks
            pass
    return folder


def let_go() -> None:
    """Let other runs write into the folders that are held."""
    while _held:
        os.close(_held.pop())


def _identity(path: Path) -> tuple[int, int]:
    """Return what is the same for all names of a file or folder."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _files_read(options: Options, unread: Collection[str]) -> Iterator[Path]:
    """Yield the files that the options name, or that lie in folders that they name."""
    for name in READ:
        value = None if name in unread else getattr(options, name, None)
        for path in map(Path, value if isinstance(value, tuple) else filter(None, [value])):
            patterns = (*_CONTENT, *_BELOW.get(name, ()))
            found = [path, *(file for pattern in patterns for file in path.glob(pattern))]
            yield from found
            if name in _SETS:
                yield from _files_named(found)


def _files_named(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the files that stand in texts, such as the masks of a rig."""
    from omnistereo_lib.files import read_text

    for text in (path for path in paths if path.suffix.lower() in _TEXTS):
        with suppress(OmnistereoError, OSError):
            words = set(re.findall(r"[^\s\"',:\[\]{}]+", read_text(text)))
            yield from (text.parent / word for word in words if os.path.isfile(text.parent / word))


def save_figure(path: Path, figure: "Figure", dpi: int = 100) -> None:
    """Write a figure of Matplotlib so that its bytes depend only on what it shows."""
    from omnistereo_lib.files import atomic_write

    kind = path.suffix.lower()[1:]
    # Matplotlib would write its version into a PNG, and the time into the others.
    unsaid = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}
    metadata = {unsaid[kind]: None} if kind in unsaid else None
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format=kind, dpi=dpi, metadata=metadata)


def photo_and_colors(path: Path) -> tuple[Path, Path]:
    """Return the paths of the pictures beside the depth of the whole sphere."""
    return path.with_name(f"{path.stem}_photo.jpg"), path.with_name(f"{path.stem}_colors.jpg")
