"""How `make lab` reads notebooks, so that JupyterLab does not take them for changed as soon as they are open.

JupyterLab writes into a notebook on which kernel it runs, down to Python's version, and marks it as unsaved where that
is new. The course stores its notebooks without (`nbtools.clean`). So it is said here, while they are read.
"""

from typing import Any

from ipykernel.ipkernel import IPythonKernel
from ipykernel.kernelspec import get_kernel_dict
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager


class Notebooks(AsyncLargeFileManager):
    """JupyterLab's files; notebooks of this course say the kernel that is here."""

    async def get(self, *arguments: Any, **options: Any) -> dict[str, Any]:
        """Return a file or folder, as the server asks for it."""
        model = await super().get(*arguments, **options)
        if model["type"] == "notebook" and model["content"] and "omnistereo" in model["content"]["metadata"]:
            spec = {key: get_kernel_dict()[key] for key in ("display_name", "language")}
            about = {"kernelspec": spec | {"name": "python3"}, "language_info": dict(IPythonKernel.language_info)}
            model["content"]["metadata"].update(about)
        return model
