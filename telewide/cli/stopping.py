"""SIGTERM, which schedulers, `timeout` and `kill` send, acts like Ctrl-C, so that the command cleans up too.

Whatever handles Ctrl-C at that moment handles it, such as a training that finishes its step first.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130
UNREAD = 141
TERMINATED = 143
"""Exit codes: 128 and the number of the signal, as shells have them."""


@contextmanager
def terminable() -> Iterator[Callable[[], int]]:
    """Let SIGTERM interrupt the body as Ctrl-C does.

    Yields:
        What to leave with after an interruption: 143 once a SIGTERM came, else 130.
    """
    is_terminated, process = False, os.getpid()

    def interrupt(signum: int, frame: FrameType | None) -> None:
        nonlocal is_terminated
        if os.getpid() != process:  # a fork that inherited this: it ends as if this were not here
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.raise_signal(signal.SIGTERM)
        is_terminated = True
        on_ctrl_c = signal.getsignal(signal.SIGINT)
        # A shell starts what runs in the background with Ctrl-C ignored; SIGTERM ends it all the same.
        if callable(on_ctrl_c):
            on_ctrl_c(signal.SIGINT, frame)
        else:
            raise KeyboardInterrupt

    try:
        previous = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not in the main thread: signals do not come here
        yield lambda: INTERRUPTED
        return
    try:
        yield lambda: TERMINATED if is_terminated else INTERRUPTED
    finally:
        signal.signal(signal.SIGTERM, previous)
