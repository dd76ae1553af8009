"""Kernels are asked through a channel that looks again."""

import asyncio
from queue import Empty

import pytest

from course import kernels


def test_a_message_that_wakes_nobody_is_found_a_second_later(monkeypatch):
    looks = []

    async def look(_, timeout):
        looks.append(timeout)
        await asyncio.sleep(timeout / 100)
        if len(looks) < 3:
            raise Empty
        return "message"

    monkeypatch.setattr(kernels.AsyncZMQSocketChannel, "get_msg", look)
    channel = kernels._Channel.__new__(kernels._Channel)
    assert asyncio.run(channel.get_msg(timeout=None)) == "message"
    assert looks == [1, 1, 1]
    looks.clear()
    with pytest.raises(Empty):
        asyncio.run(channel.get_msg(timeout=0))
    assert looks == [0]


def test_kernels_are_asked_through_the_channel_that_looks_again():
    client = kernels.KernelManager(kernel_name="python3").client_factory()
    assert type(client) is kernels._Client
    assert client.shell_channel_class is client.iopub_channel_class is kernels._Channel
