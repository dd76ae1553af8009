"""Threads that are kept: the results of `map`, in order, and none lost to a fork."""

import os
import signal
from threading import get_ident

import pytest
import torch

from omnistereo_lib.stereo.threads import map_threads


def test_results_come_in_order_from_as_many_threads_as_torch_has():
    assert list(map_threads(lambda a, b: a - b, range(100), range(50, 150))) == [-50] * 100
    assert len(set(map_threads(lambda _: get_ident(), range(100)))) <= torch.get_num_threads()


def test_an_error_comes_out_and_the_threads_go_on():
    with pytest.raises(ZeroDivisionError):
        list(map_threads(lambda x: 1 / x, range(100)))
    assert list(map_threads(abs, [-1])) == [1]


def test_a_thread_that_waits_for_others_does_their_work():
    rows = map_threads(lambda y: list(map_threads(lambda x: 10 * y + x, range(3))), range(9))
    assert list(rows) == [[10 * y, 10 * y + 1, 10 * y + 2] for y in range(9)]


def test_threads_write_to_what_is_made_in_inference_mode():
    with torch.inference_mode():
        x = torch.zeros(9)
        list(map_threads(lambda k: x[k : k + 1].fill_(k), range(9)))
    assert x.tolist() == [*range(9)]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows does not fork")
def test_a_forked_process_starts_its_own():
    list(map_threads(abs, range(4)))
    if (child := os.fork()) == 0:
        signal.alarm(60)  # ends the child if it waits for threads that it does not have
        os._exit(list(map_threads(abs, [-1])) != [1])
    assert os.waitpid(child, 0)[1] == 0
