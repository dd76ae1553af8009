"""How nbval compares a notebook: words exactly, decimal numbers with a tolerance.

Text and integers (counts, shapes, indices) must be equal. A number with a decimal point or an
exponent may differ by 0.1 %; a tag of the cell asks for another tolerance: `rtol-1e-2` (relative),
`atol-0.5` (absolute). nbval has no setting for that, so its objects get the two classes below."""

import math
import re
from queue import Empty
from typing import Any

import pytest
from nbval.kernel import RunningKernel
from nbval.plugin import IPyNbCell, IPyNbFile

RTOL = 1e-3
WIDGET = "application/vnd.jupyter.widget-view+json"
TAKEN = ("stream", "display_data", "execute_result", "clear_output")  # by an Output widget
# What is neither text to read nor stored: warnings' paths and line numbers differ from machine to
# machine (the guard in tests/test_notebooks_stored.py wants none stored), HTML and scripts carry
# random ids.
NOT_COMPARED = ("stderr", "text/html", "application/javascript")

# A decimal number with the blanks around it, since its width may change with its value (9.9999 ->
# 10.0001). Not the digits of a name (float32, v1.5) or of a version (2.13.0).
_NUMBER = re.compile(
    r" *(?<![\w.])([-+]?(?:\d*\.\d+(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+))(?!\d|\.\d) *"
)


def tolerance(tags: list[str]) -> tuple[float, float]:
    """Relative and absolute tolerance that a cell's tags ask for."""
    asked = dict(tag.split("-", 1) for tag in tags if tag.startswith(("rtol-", "atol-")))
    return float(asked.get("rtol", RTOL)), float(asked.get("atol", 0.0))


class Printed(str):
    """A printed text that equals another with the same words and nearly the same decimals."""

    def __new__(cls, text: str, rtol: float = RTOL, atol: float = 0.0) -> "Printed":
        """Keep the tolerances beside the text."""
        self = super().__new__(cls, text)
        self.rtol, self.atol = rtol, atol
        return self

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, str):
            return NotImplemented
        # words, number, words, number, ..., words
        mine, theirs = _NUMBER.split(self), _NUMBER.split(other)
        return mine[::2] == theirs[::2] and all(
            math.isclose(float(a), float(b), rel_tol=self.rtol, abs_tol=self.atol)
            for a, b in zip(mine[1::2], theirs[1::2], strict=True)
        )

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = str.__hash__


class TolerantCell(IPyNbCell):
    """A code cell: run, then compared with what is stored."""

    def sanitize(self, text: Any) -> Any:
        """Clean a text by nbval's patterns and let it compare with the cell's tolerance."""
        clean = super().sanitize(text)
        if not isinstance(clean, str):  # JSON
            return clean
        return Printed(clean, *tolerance(self.cell.metadata.get("tags", [])))

    def compare_outputs(self, test: list, ref: list, skip_compare: tuple | None = None) -> bool:
        """Compare all outputs but the widgets, which are not stored."""
        shown = [output for output in test if WIDGET not in output.get("data", {})]
        return super().compare_outputs(shown, ref, skip_compare)


class WatchedKernel(RunningKernel):
    """A kernel that is not waited for when it has died: nbval waits twice a cell's time limit."""

    def await_reply(self, msg_id: str, timeout: float | None = None) -> dict:
        """Wait in pieces of a second for as long as the kernel lives."""
        for _ in range(math.ceil(timeout or 0)):
            try:
                return super().await_reply(msg_id, 1)
            except Empty:
                if not self.is_alive():
                    raise RuntimeError("the kernel has died, in this cell or before") from None
        raise Empty


class StoredNotebook(IPyNbFile):
    """A notebook whose widgets run but are not compared: they live in a browser."""

    inside_widget = False

    def setup(self) -> None:
        """Start the kernel, and watch it."""
        super().setup()
        self.kernel.__class__ = WatchedKernel

    def get_kernel_message(self, timeout: float | None = None, stream: str = "iopub") -> dict:
        """Next message of the kernel, but what an Output widget takes; errors still count."""
        while True:
            message = super().get_kernel_message(timeout, stream)
            kind, content = message["msg_type"], message["content"]
            state = content.get("data", {}).get("state", {}) if kind == "comm_msg" else {}
            # an Output widget says whose messages it takes; an empty text: no longer
            if "msg_id" in state:
                self.inside_widget = bool(state["msg_id"])
            elif not (self.inside_widget and kind in TAKEN):
                return message


def pytest_collectstart(collector: pytest.Collector) -> None:
    """Leave out of every notebook's comparison what cannot be the same twice."""
    if isinstance(collector, IPyNbFile):
        collector.__class__ = StoredNotebook
        collector.skip_compare += NOT_COMPARED


def pytest_itemcollected(item: pytest.Item) -> None:
    """Give every notebook cell the tolerant comparison."""
    if isinstance(item, IPyNbCell):
        item.__class__ = TolerantCell
