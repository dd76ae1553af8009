"""The file manager of `make lab`: an opened notebook is not marked as unsaved.

JupyterLab writes the running kernel, down to the version of Python, into a notebook and marks it as unsaved if that is
new. The course stores its notebooks without it (`nbtools.clean`), so it is added while they are read.
"""

from typing import Any

from ipykernel.ipkernel import IPythonKernel
from ipykernel.kernelspec import get_kernel_dict
from jupyter_server.services.contents.largefilemanager import AsyncLargeFileManager


class Notebooks(AsyncLargeFileManager):
    """Files of JupyterLab; injects the spec of the running kernel into notebooks of this course."""

    async def get(self, *arguments: Any, **options: Any) -> dict[str, Any]:
        """Return a file or folder; see `AsyncLargeFileManager.get`."""
        model = await super().get(*arguments, **options)
        if model["type"] == "notebook" and model["content"] and "omnistereo" in model["content"]["metadata"]:
            spec = {key: get_kernel_dict()[key] for key in ("display_name", "language")}
            about = {"kernelspec": spec | {"name": "python3"}, "language_info": dict(IPythonKernel.language_info)}
            model["content"]["metadata"].update(about)
        return model
