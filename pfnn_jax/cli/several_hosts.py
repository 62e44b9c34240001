"""One command line on every host: the options that connect its process, and a process of its own for the training.

JAX's runtime ends a process that has lost another by an abort from C++, with a stack trace. So the command line trains
in a child process, says in one line how that ended, and keeps the child's messages from C++ to itself.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError, LostProcessError, TrainingError, check_at_least, check_field

LOST = "JAX distributed service detected fatal errors"
"""What the runtime writes before it ends a process that has lost another."""

NEVER_MET = "RegisterTask"
"""What it writes too, where it has never found process 0."""

SHOWN = 2000
"""Characters of the child's last messages that are shown where it ended for another reason."""


@dataclass(frozen=True)
class HostsConfig:
    """How this process finds those on other hosts, with which it trains.

    Attributes:
        coordinator: train with the processes of several hosts: HOST:PORT of process 0, the same on every host, with
            --process-id and --processes; or `auto` under SLURM, GKE, Cloud TPU and Open MPI, which announce them.
        process_id: number of this process, from 0; process 0 writes the run.
        processes: number of all processes.
    """

    coordinator: str | None = None
    process_id: int | None = None
    processes: int | None = None

    def __post_init__(self):
        if self.coordinator in (None, "auto"):
            for name in ("process_id", "processes"):
                check_field(self, name, "be given with the HOST:PORT of --coordinator", lambda _: False)
            return
        check_field(self, "coordinator", "be HOST:PORT or auto", _is_address)
        if self.process_id is None or self.processes is None:
            raise ValueError("HostsConfig.process_id and HostsConfig.processes must be given with a HOST:PORT.")
        check_at_least(self, "processes")
        count = self.processes or 1
        check_field(self, "process_id", f"be from 0 to {count - 1}", lambda number: 0 <= number < count)

    def connect(self) -> None:
        """Connects this process with the others.

        Raises:
            InputError: if nothing announces them, or process 0 cannot open the port.
        """
        from pfnn_jax.training.hosts import initialise

        initialise(None if self.coordinator == "auto" else self.coordinator, self.process_id, self.processes)

    def disconnect(self) -> None:
        """Waits until the others have finished too; a coordinator that ended earlier would end them with an error."""
        import jax

        jax.distributed.shutdown()

    def is_first(self) -> bool:
        """Returns whether this process writes: the only one, or process 0 of several that are connected."""
        if self.coordinator is None:
            return True
        from pfnn_jax.training.hosts import is_first

        return is_first()


def _is_address(text: str) -> bool:
    host, colon, port = text.rpartition(":")
    return bool(host and colon and port.isdecimal() and 0 < int(port) < 2**16)


def run_in_child(work: Callable[[], Any], hosts: HostsConfig) -> Any:
    """Returns what `work` returns in a child process that is connected with those of the other hosts.

    Args:
        work: a picklable function. Its errors that have one line are raised here.
        hosts: how to connect.

    Raises:
        InputError: if process 0 was not found, or the child was ended by the system.
        LostProcessError: if another process is lost.
        SystemExit: after any other error of the child, which it has shown.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="pfnn-jax-") as folder:
        log = Path(folder) / "log"
        child = context.Process(target=_work, args=(work, hosts, sender, log), daemon=True)
        child.start()
        sender.close()
        try:
            result, error = receiver.recv()
        except EOFError:
            child.join()
            raise how_it_ended(child.exitcode or 0, log.read_text(errors="replace"), hosts) from None
        child.join()
    if error is not None:
        raise error
    return result


def _work(work: Callable[[], Any], hosts: HostsConfig, sender: Connection, log: Path) -> None:
    """Runs in the child: sends (result, None) or (None, error), and exits at once after an error."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process, and says so
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _keep_messages(log)
    try:
        hosts.connect()
        result = work()
    except (InputError, TrainingError, LostProcessError, OSError) as error:
        sender.send((None, error))
        os._exit(1)
    sender.send((result, None))
    hosts.disconnect()


def _keep_messages(log: Path) -> None:
    """Sends what C++ writes to the standard streams into a file; Python's own streams stay where they are."""
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for number, name in ((1, "stdout"), (2, "stderr")):
        setattr(sys, name, open(os.dup(number), "w", buffering=1, encoding="utf-8", errors="replace"))
        os.dup2(file, number)


def _end_with_parent() -> None:
    """Ends the child as soon as its parent has ended, however it did."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def how_it_ended(code: int, messages: str, hosts: HostsConfig) -> BaseException:
    """Returns the error that says how a child has ended that sent no answer."""
    if LOST in messages and NEVER_MET in messages:
        rule = "process 0 must answer there: start it, and look at the address and at firewalls"
        return InputError("command line", "coordinator", f"no answer from {hosts.coordinator}", rule)
    if LOST in messages:
        return LostProcessError(_lost(messages))
    if code > 0:  # an error that Python has shown
        return SystemExit(code)
    sys.stderr.write(messages[-SHOWN:])
    name = signal.Signals(-code).name if code else "exit code 0"
    rule = (
        "the last complete save is kept: look for a lack of memory, and start all processes again, a pretraining with "
        "resume=True"
    )
    return InputError("training", "process", f"was ended by {name}", rule)


def _lost(messages: str) -> str:
    """Returns which process the runtime has lost, from its messages."""
    silent = re.search(r"stopped sending heartbeats\):\s*([\d,\s]*\d)", messages)
    if silent:
        return f"no sign of life from process {', '.join(silent[1].replace(',', ' ').split())}"
    return "process 0 has ended, or cannot be reached any more"
