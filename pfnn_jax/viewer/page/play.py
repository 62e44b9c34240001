"""`pfnn-jax play`: a page in the browser with a character to drive, a character for every tab."""

from __future__ import annotations

import contextlib
import io
import signal
import socket
import threading
import warnings
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.palette import ACCENT, rgb
from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.guard import guarded
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.scene import CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET
from pfnn_jax.viewer.page.tab import Tab
from pfnn_jax.viewer.page.uploads import give_up, prepare_learning

if TYPE_CHECKING:
    import viser

LOCAL = "127.0.0.1"
"""The address that only this machine can reach; any other must be asked for."""

SOON = "in about half a minute"
"""When a page is ready that has been begun: loading and compiling took 35 to 44 s on two cores, less on free ones."""

LONGEST_END = 1.5
"""Seconds for which the end of a server is waited for: a tab that does not answer would hold it up for longer."""

EXPECTED = ("Queued a .* on a closed connection", r"\[viser\] Dropping upload")
"""Warnings of viser that mean no harm: a tab may close while its picture is being sent, its thread ends a moment later;
and of a file that is far too large only the length is kept."""


class Page:
    """A server with a tab for every browser that connects. Use as a context manager, or `close` it.

    It answers from the beginning, so that its port is its own: a browser that comes before the runs are ready is told
    so, and gets its character once they are.

    Args:
        library: the runs; without them they are waited for, see `begin`.
        host, port: where to listen; port 0 takes a free one.

    Raises:
        InputError: if viser is missing, or nobody can listen there.
    """

    def __init__(self, library: RunLibrary | None = None, host: str = LOCAL, port: int = 8080) -> None:
        self._library = library
        self._tabs: dict[int, Tab] = {}
        self._waiting: dict[int, tuple[viser.ClientHandle, viser.GuiHtmlHandle]] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._server = _serve(host, port)
        self.host, self.port = host, self._server.get_port()
        self._server.gui.configure_theme(
            control_layout="floating",
            control_width="medium",
            show_logo=False,
            show_share_button=False,
            brand_color=rgb(ACCENT),
        )
        self._server.gui.set_panel_label("pfnn_jax")
        self._server.scene.set_up_direction("+y")
        camera = self._server.initial_camera
        camera.fov, camera.position, camera.look_at = CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET
        self._server.on_client_connect(self._open)
        self._server.on_client_disconnect(self._close)

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{'localhost' if self.host in ('', '0.0.0.0', '::') else host}:{self.port}"

    @property
    def tabs(self) -> tuple[Tab, ...]:
        """The tabs that are open now."""
        with self._lock:
            return tuple(self._tabs.values())

    def begin(self, library: RunLibrary) -> None:
        """The runs are ready: browsers that have waited for them get their characters, and those that come."""
        with self._lock:
            self._library = library
            waiting, self._waiting = self._waiting, {}
            tabs = {number: Tab(client, library) for number, (client, _) in waiting.items()}
            self._tabs |= tabs
        for number, (_, note) in waiting.items():
            note.remove()
            tabs[number].start()

    def close(self) -> None:
        """Ends all tabs and the server."""
        with self._lock:
            self._closed = True
            self._waiting = {}
            tabs, self._tabs = list(self._tabs.values()), {}
        for tab in tabs:
            tab.close(wait=0.0)
        for tab in tabs:
            tab.close(wait=1.0 / len(tabs))
        with contextlib.redirect_stdout(io.StringIO()):
            ending = threading.Thread(target=self._server.stop, daemon=True)
            ending.start()
            ending.join(LONGEST_END)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Viser awaits these one after the other; others it would run in threads, a tab's end before its beginning.

    async def _open(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if self._closed:
                return
            if self._library is None:
                note = client.gui.add_html(widgets.message("plain", f"Compiling: your character comes {SOON}."))
                self._waiting[client.client_id] = client, note
                return
            tab = self._tabs[client.client_id] = Tab(client, self._library)
        tab.start()

    async def _close(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._waiting.pop(client.client_id, None)
            tab = self._tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close(wait=0.0)


def play(run_paths: Sequence[str | Path], *, host: str = LOCAL, port: int = 8080, open_browser: bool = False) -> None:
    """Serves a page to drive characters of some runs, until Ctrl-C or SIGTERM.

    Either ends it within moments, whatever is being compiled or learned; what is not learned then is left out.

    Args:
        run_paths: folders of runs.
        host: address to listen at; anything but the default lets other machines in.
        port: of TCP; 0 takes a free one.
        open_browser: whether to open the page here.

    Raises:
        InputError: for a folder that is no run, if nobody can listen at the address, or if viser is missing.
    """
    code = 1
    try:
        with _ended_by_signals() as ending, contextlib.suppress(KeyboardInterrupt):
            _play(run_paths, host, port, open_browser, ending)
        print("Ended.", flush=True)
        code = 0
    except InputError:
        code = 2  # of the command, for bad input
        raise
    finally:
        background.leave_work(code)


def _play(
    run_paths: Sequence[str | Path], host: str, port: int, open_browser: bool, ending: Callable[[], None]
) -> None:
    background.do(check_viser)
    library = None
    with Page(host=host, port=port) as page:  # before anything is loaded: a port that is taken is no surprise later
        try:
            print(f"compiling; the page opens at {page.url} {SOON}", flush=True)
            if open_browser:
                webbrowser.open(page.url)
            library = background.do(partial(RunLibrary, run_paths))
            threading.Thread(target=_rehearse, args=(library,), name="rehearsal", daemon=True).start()
            background.do(library.warm_up)
            page.begin(library)
            print(f"{', '.join(library.runs)}: {len(library.styles)} styles at {page.url}  (Ctrl-C ends)", flush=True)
            threading.Event().wait()
        finally:
            ending()
            if library is not None:
                give_up(library)


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[Callable[[], None]]:
    """SIGTERM within the block is as Ctrl-C; yields what makes it deaf to both, for an end that is not interrupted."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ending() -> None:
        for number in before:
            signal.signal(number, signal.SIG_IGN)

    try:
        for number in before:
            signal.signal(number, signal.default_int_handler)
        yield ending
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _rehearse(library: RunLibrary) -> None:
    """Compiles what the first upload would wait for, on the core that compiling a step leaves idle."""
    for run in library.runs:
        prepare_learning(library, run)


def check_viser() -> None:
    """Makes sure that what serves the page is there.

    Raises:
        InputError: if it is not installed.
    """
    try:
        import viser  # noqa: F401
    except ImportError:
        rule = "needed for the page: pip install pfnn-jax[viewer]"
        raise InputError("environment", "viser", "not installed", rule) from None


def check_address(host: str, port: int) -> None:
    """Makes sure that one can listen at an address.

    Raises:
        InputError: if not: the port is taken, or the address is none of this machine's.
    """
    if not 0 <= port <= 65535:
        raise InputError("page", "port", port, "must be between 0 and 65535")
    try:
        family, _, _, _, address = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (socket.gaierror, ValueError):  # the latter of names that no network knows: too long, or with empty parts
        raise InputError("page", "host", ascii(host)[:80], "must be an address of this machine") from None
    except OSError as error:
        reason = error.strerror or "cannot be used"
        raise InputError("page", f"port at {host}", port, f"{reason.lower()}; choose another with --port") from None


def _serve(host: str, port: int) -> viser.ViserServer:
    check_viser()
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            """Any page can ask for a public address; none is given."""

    check_address(host, port)
    for expected in EXPECTED:
        warnings.filterwarnings("ignore", expected, UserWarning)
    with contextlib.redirect_stdout(io.StringIO()), guarded(host) as started:  # its banner; `play` prints the address
        server = Server(host=host, port=port, verbose=False)
    if not started:
        server.stop()
        raise InputError("environment", "viser", viser.__version__, "does not let requests be checked; try 1.1.1")
    if port not in (0, server.get_port()):  # taken since it was checked; viser goes on to the next
        server.stop()
        raise InputError("page", f"port at {host}", port, "is taken; choose another with --port")
    return server
