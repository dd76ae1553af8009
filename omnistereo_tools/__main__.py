"""`omnistereo COMMAND` and `python -m omnistereo_tools COMMAND`."""

import atexit
import gc
import os
import signal


def start() -> int:
    """Run the command line; return its exit status."""
    # The first that is registered is the last that is called: the process ends without taking a
    # thousand modules apart, a tenth of a second.
    ended: list[int] = []
    atexit.register(lambda: [os._exit(status) for status in ended])
    # Modules make hundreds of thousands of objects that stay: looking through them for garbage took
    # 0.3 s while they load (`depth`, 7.0 s; two cores, warm).
    gc.set_threshold(500_000, 20, 20)
    # Threads of torch that wait for work give their core away sooner than libgomp's default has
    # them: `depth` on two cores took 6.3 s, not 6.9, and beside much other work 56 s, not 132.
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")
    # A second thread of NumPy's OpenBLAS spins beside matrices of a thousand rows: all matches of
    # two frames (`world`) take .17 s of the processor's time without it, not .32, the same bits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from omnistereo_tools.cli import main
    from omnistereo_tools.memory import keep_memory

    # A command without it takes 1.3 s more of the system's time (`depth`, 6.4 s).
    keep_memory()
    status = main()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # nothing is left to say
    ended.append(status)
    return status


if __name__ == "__main__":
    raise SystemExit(start())
