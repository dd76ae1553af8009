"""Runs commands in processes of their own without importing the library for each: `python
command_server.py`.

It imports the library once, with what commands load later, and then forks. Each line on its
standard input is JSON, [command line, log file, folder to run in]. It answers "NUMBER started", the
number of the process, and "NUMBER STATUS" when that one has ended. So a test that runs a hundred
commands does not import torch a hundred times."""

import json
import operator
import os
import signal
import sys
import threading
import traceback
from pathlib import Path

import cv2
import matplotlib.backends.backend_agg
import matplotlib.figure
import matplotlib.layout_engine
import numba
import scipy.ndimage  # noqa: F401
import torch
import torch._dynamo  # by torch's optimizers
from render_stand_in import replace_blender

from omnistereo_learn import train
from omnistereo_learn.recipes import MCCNNRecipe
from omnistereo_lib.stereo import correlation
from omnistereo_tools import cli
from omnistereo_tools.output import frame, pictures, webp
from omnistereo_tools.parser import is_tiny
from workshop import render


def run(command):
    """Run the command line, Python, the stand-in renderer, or a training that saves each step."""
    if command[0] == "python":
        exec(compile(command[1], "page", "exec"), {"__name__": "__main__"})
        return 0
    if command[0] == "render":
        replace_blender(operator.setitem, setattr)
        return render.main(command[1:])
    if command[0] != "recipe":
        return cli.main(command)
    train(MCCNNRecipe(**json.loads(command[2])), command[3], command[1], checkpoint_s=0)
    return 0


def child(command, log, folder):
    """Run a command in a folder, with the output in a log file; return its exit status."""
    os.chdir(folder)
    os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), 1)
    os.dup2(1, 2)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            status = run(command)
        finally:  # Ctrl-C has no meaning when the command has ended
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:
        status = 130
    except SystemExit as stop:
        status = stop.code or 0
    except BaseException:
        traceback.print_exc()
        status = 99
    sys.stdout.flush()
    sys.stderr.flush()
    return status


def wait(number):
    """Say when a process has ended."""
    status = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    os.write(1, f"{number} {status}\n".encode())


def make_small(setattr):
    """Shrink what no width of a panorama makes smaller: VolumeNet's volume, the pictures of a page,
    films.

    Figures are not laid out, which takes as long as drawing them.
    """
    # Not 8 spheres: a U-net whose last level has one reads noise in bfloat16 (torch 2.13.0).
    setattr(correlation, "COARSE", (32, 16))
    setattr(frame, "WIDEST", 192)
    setattr(webp, "_IMAGE_WIDTH", 100)
    setattr(pictures, "_SHARP", 192)
    setattr(matplotlib.layout_engine.ConstrainedLayoutEngine, "execute", lambda *_: None)


def main():
    numba.njit(lambda: None)()  # loads its compiler
    if is_tiny():
        make_small(setattr)
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal in which the tests are interrupted
    for line in sys.stdin:
        command, log, folder = json.loads(line)
        number = os.fork()
        if number == 0:
            os._exit(child(command, Path(log).resolve(), folder))
        os.write(1, f"{number} started\n".encode())
        threading.Thread(target=wait, args=(number,), daemon=True).start()


if __name__ == "__main__":
    main()
