"""Ranges of columns around the seam, against sets of columns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from omnistereo_lib.stereo.columns import circular_span, common_columns, split_at_seam


@pytest.mark.parametrize(
    "visible, span",
    [
        ("00111000", (2, 3)),
        ("11000011", (6, 4)),
        ("11111111", (0, 8)),
        ("00000000", (0, 0)),
        ("10000001", (7, 2)),
    ],
)
def test_visible_columns_form_the_shortest_span_around_the_seam(visible, span):
    start, width = circular_span(np.array([c == "1" for c in visible]))
    assert width == span[1]
    assert start == span[0] or width == 8
    covered = [x for first, last in split_at_seam(start, width, 8) for x in range(first, last)]
    assert {x for x, c in enumerate(visible) if c == "1"} <= set(covered)


@given(
    st.integers(2, 12).flatmap(
        lambda W: st.tuples(st.just(W), *[st.integers(0, W - 1), st.integers(0, W)] * 2)
    )
)
def test_common_columns_are_the_intersection(spans):
    W, start_a, width_a, start_b, width_b = spans
    a, b = ({(s + t) % W for t in range(w)} for s, w in ((start_a, width_a), (start_b, width_b)))
    strips = common_columns((start_a, width_a), (start_b, width_b), W)
    columns = [(s + t) % W for s, width in strips for t in range(width)]
    assert sorted(columns) == sorted(a & b)
