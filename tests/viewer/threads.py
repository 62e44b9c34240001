"""Waits for threads whose work outlasts what they show."""

from __future__ import annotations

import threading


def join_threads(name: str, seconds: float = 60.0) -> None:
    """Waits until the threads of a name have ended.

    A thread that shows an error and raises it again must end in the test that it belongs to: pytest would charge the
    exception to the next one.
    """
    for thread in threading.enumerate():
        if thread.name == name:
            thread.join(seconds)
            assert not thread.is_alive(), name
