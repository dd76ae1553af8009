"""Pictures for the notebooks. The only module that draws; Matplotlib is imported when it does."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 90  # sharp enough to read, small enough that a notebook stays below 500 KB


def encode(fig: Figure, kind: Literal["png", "jpeg"] = "png") -> bytes:
    """Encode a figure as a PNG (lines, text, flat colours) or a JPEG (photographs) at 90 dots per inch."""
    buffer = io.BytesIO()
    # Matplotlib writes its version into a PNG: without it the file depends on the picture alone.
    extra = {"metadata": {"Software": None}} if kind == "png" else {}
    pil = {"optimize": True} if kind == "png" else {"quality": 85, "optimize": True}
    fig.savefig(buffer, format=kind, dpi=DPI, bbox_inches="tight", pil_kwargs=pil, **extra)
    return buffer.getvalue()


def show(fig: Figure, caption: str, alt: str, kind: Literal["png", "jpeg"] = "png") -> None:
    """Show a figure in a notebook, with a caption below it, and close it.

    Parameters
    ----------
    fig
        The figure; it is closed afterwards, so that Jupyter does not show it a second time.
    caption
        What the reader should see in it, one or two sentences of Markdown. Appears as "*Figure:* ...".
    alt
        What the picture shows, for somebody who cannot see it. Stored where renderers look for it: in the
        image's metadata (nbconvert, nbviewer) and as the plain-text form of the output (MyST, terminals).
    kind
        "png" for drawings, "jpeg" for photographs and panoramas.
    """
    import matplotlib.pyplot as plt
    from IPython.display import display

    mime = f"image/{kind}"
    picture = base64.b64encode(encode(fig, kind)).decode()
    plt.close(fig)
    display({mime: picture, "text/plain": alt}, metadata={mime: {"alt": alt}}, raw=True)
    display({"text/markdown": f"*Figure:* {caption}", "text/plain": caption}, raw=True)
