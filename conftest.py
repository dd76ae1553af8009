"""How the tests run: which cores, in which order. How notebooks compare: `notebook_comparison`."""

import os
import signal

import pytest

pytest_plugins = ["notebook_comparison"]

# A run in the background of a shell ignores Ctrl-C, and so would all that it starts; tests send it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Every test process gets its share of the cores. Numba keeps two threads at least, so that a race
# in a parallel loop has a chance to show. Set in xdist's workers alone: they inherit what the
# process that starts them has, and could not tell it from what somebody asked for.
_workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0"))
if _workers:
    _cores = max(1, (os.cpu_count() or 1) // _workers)
    os.environ.setdefault("OMP_NUM_THREADS", str(_cores))
    os.environ.setdefault("NUMBA_NUM_THREADS", str(max(2, _cores)))
    # threads that wait leave the core to the other workers
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what drives a browser; put first what takes long, so that no core idles at the end."""
    for item in items:
        if {"chromium", "open_page"} & {*getattr(item, "fixturenames", ())}:
            item.add_marker("browser")
    items.sort(key=lambda item: not item.nodeid.startswith(("notebooks/", "tests/learn/")))
