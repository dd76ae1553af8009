import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scene import refused

import omnistereo_lib as osl

maps = arrays(
    np.float32, (3, 4), elements=st.one_of(st.floats(-5, 200, width=32), st.just(math.nan))
)


@given(maps, maps, arrays(bool, (3, 4)))
def test_errors_agree_with_the_definition_ray_by_ray(index, gt, valid):
    N = 192
    errors = []
    for y in range(3):
        for x in range(4):
            if valid[y, x] and 0 <= gt[y, x] < N:
                estimate = float(index[y, x])
                errors.append(
                    100.0 if math.isnan(estimate) else 100 / N * abs(estimate - float(gt[y, x]))
                )
    found = osl.index_error(index, gt, N, valid)
    if not errors:
        assert all(math.isnan(value) for value in found.values())
        return
    for limit in (1, 3, 5):
        assert found[f">{limit}"] == pytest.approx(
            100 * sum(e > limit for e in errors) / len(errors)
        )
    assert found["MAE"] == pytest.approx(sum(errors) / len(errors))
    assert found["RMS"] == pytest.approx(math.sqrt(sum(e * e for e in errors) / len(errors)))


def test_maps_must_agree_in_shape():
    with refused(r"\(2, 3\).*\(3, 2\)"):
        osl.index_error(np.zeros((2, 3)), np.zeros((3, 2)), 10)
    with refused(r"valid has shape \(3,\); expected that of the panorama, \(2, 3\)"):
        osl.index_error(np.zeros((2, 3)), np.zeros((2, 3)), 10, np.ones(3))
