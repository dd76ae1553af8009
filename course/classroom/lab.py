"""`make lab`: JupyterLab on working copies of the notebooks, which git ignores, so that the stored
ones stay clean.

Its file manager opens a notebook without marking it as unsaved. JupyterLab writes the running
kernel, down to the version of Python, into a notebook and marks it as unsaved if that is new. The
course stores its notebooks without it (`nbtools.clean`), so it is added while they are read.
"""

import itertools
import os
from typing import Any

from ipykernel.ipkernel import IPythonKernel
from ipykernel.kernelspec import get_kernel_dict
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager

from course import nbtools
from omnistereo_lib.errors import OmnistereoError
from omnistereo_lib.files import write_text

# beside notebooks, so that ../data_samples is the same folder
WORKING = nbtools.ROOT / "my_notebooks"
SETTINGS = (
    f"--ServerApp.root_dir={nbtools.ROOT}",
    f"--LabApp.app_settings_dir={nbtools.ROOT / 'course' / 'jupyterlab'}",  # no question about news
    "--ServerApp.contents_manager_class=course.classroom.lab.Notebooks",
)
# In a container there is only root, whom Jupyter refuses, lest a server that is open to others runs
# as root. This one listens on localhost and asks for its token.
AS_ROOT = ("--allow-root",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()


def start(options: list[str]) -> None:
    """Open JupyterLab on the copy of the first notebook, copying first what has no copy."""
    from jupyterlab.labapp import LabApp

    WORKING.mkdir(exist_ok=True)
    for path in nbtools.notebooks():
        if not (WORKING / path.name).exists():
            write_text(WORKING / path.name, nbtools.read_text(path))
    for old, new in nbtools.MOVED.items():
        if (WORKING / f"{old}.ipynb").exists():
            print(
                f"{old} is now {new}: yours is kept, its checks run in the course of its day only"
            )
    # as the default page it stands in the address that is printed, too, with --no-browser
    first = f"--LabApp.default_url=/lab/tree/{WORKING.name}/{nbtools.notebooks()[0].name}"
    LabApp.launch_instance([*SETTINGS, *AS_ROOT, first, *options])


def renew(name: str) -> None:
    """Copy one notebook, such as "03", again; the working copy is kept beside it."""
    found = [path for path in nbtools.notebooks() if name in (nbtools.number(path), path.stem)]
    if not found:
        numbers = ", ".join(nbtools.number(path) for path in nbtools.notebooks())
        raise OmnistereoError(
            f"there is no notebook {name!r}; expected one of {numbers}. make fresh NOTEBOOK=03"
        )
    copy = WORKING / found[0].name
    if copy.exists():
        kept = (copy.with_stem(f"{copy.stem}-{k}") for k in itertools.count(1))
        free = next(path for path in kept if not path.exists())
        print(f"your work is kept as {copy.rename(free).name}")
    WORKING.mkdir(exist_ok=True)
    write_text(copy, nbtools.read_text(found[0]))
    print(f"a fresh copy is in {WORKING.name}/{copy.name}")


class Notebooks(AsyncLargeFileManager):
    """Files of JupyterLab; injects the spec of the running kernel into notebooks of this course."""

    async def get(self, *arguments: Any, **options: Any) -> dict[str, Any]:
        """Return a file or folder; see `AsyncLargeFileManager.get`."""
        model = await super().get(*arguments, **options)
        content = model["content"] if model["type"] == "notebook" else None
        if content and "omnistereo" in content["metadata"]:
            spec = {key: get_kernel_dict()[key] for key in ("display_name", "language")}
            about = {
                "kernelspec": spec | {"name": "python3"},
                "language_info": dict(IPythonKernel.language_info),
            }
            model["content"]["metadata"].update(about)
        return model
