"""Which exercises are slow to check: each case of `best_step` solves several least squares."""

import pytest


def pytest_collection_modifyitems(items):
    for item in items:
        if "best_step" in item.nodeid or "right_there[17]" in item.nodeid:
            item.add_marker(pytest.mark.slow)
