"""`pfnn-jax play`: a page in the browser with a character to drive; every tab has its own."""

from __future__ import annotations

import contextlib
import io
import signal
import socket
import sys
import threading
import warnings
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pfnn_jax.errors import InputError
from pfnn_jax.io.compilation_cache import use_private_cache
from pfnn_jax.run_config import check_finished
from pfnn_jax.viewer.draw.palette import ACCENT, rgb
from pfnn_jax.viewer.page import background, widgets
from pfnn_jax.viewer.page.guard import guarded
from pfnn_jax.viewer.page.run_library import RunLibrary, run_names
from pfnn_jax.viewer.page.scene import CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET
from pfnn_jax.viewer.page.start_screen import StandingBody, StartProgress, Ticker, WaitingTab, standing_body
from pfnn_jax.viewer.page.start_times import StartTimes
from pfnn_jax.viewer.page.tab import Tab
from pfnn_jax.viewer.page.uploads import cancel_learning, prepare_training, prepare_walks

if TYPE_CHECKING:
    import viser

LOCAL = "127.0.0.1"
"""The default address, which only this machine can reach."""

STOP_TIMEOUT = 1.5
"""Seconds to wait for the server to stop: a tab that does not answer would delay it for longer."""

HARMLESS = ("Queued a .* on a closed connection", r"\[viser\] Dropping upload")
"""Harmless warnings of viser: a tab can close while its picture is being sent, shortly before its thread ends; and
files that are far too large are dropped on purpose."""


class Page:
    """A server with a tab for every browser that connects. Use as a context manager, or `close` it.

    The server answers at once, so that its port is taken: a browser that connects before the runs are loaded sees the
    ground, a standing body and the progress, and its character moves as soon as they are.

    Args:
        library: the runs; None if they follow with `begin`.
        host, port: address to listen at; port 0 takes a free one.
        body: the body that is shown before the runs are loaded; None shows only the progress.
        progress: of loading.

    Raises:
        InputError: if viser is missing, or the address cannot be used.
    """

    def __init__(
        self,
        library: RunLibrary | None = None,
        host: str = LOCAL,
        port: int = 8080,
        *,
        body: StandingBody | None = None,
        progress: StartProgress | None = None,
    ) -> None:
        self._library, self._body, self._progress = library, body, progress or StartProgress()
        self._tabs: dict[int, Tab] = {}
        self._waiting: dict[int, WaitingTab] = {}
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
        names = ", ".join(library.runs) if library is not None else body.run if body is not None else ""
        # Of the server, not of a tab: they reach a browser with the first messages.
        self._server.gui.add_html(widgets.script(names))
        self._note = None if library is not None else self._server.gui.add_html(self._progress.html())
        self._server.scene.set_up_direction("+y")
        camera = self._server.initial_camera
        camera.fov, camera.position, camera.look_at = CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET
        self._server.on_client_connect(self._open)
        self._server.on_client_disconnect(self._close)
        self._ticker = Ticker(self._show_progress) if library is None else None

    @property
    def url(self) -> str:
        """The page's address for a browser."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{'localhost' if self.host in ('', '0.0.0.0', '::') else host}:{self.port}"

    @property
    def tabs(self) -> tuple[Tab, ...]:
        """The open tabs."""
        with self._lock:
            return tuple(self._tabs.values())

    def begin(self, library: RunLibrary) -> None:
        """Takes the loaded runs: browsers that are waiting, and all later ones, get their characters."""
        with self._lock:
            self._library = library
            waiting, self._waiting = self._waiting, {}
            tabs = {number: Tab(tab.client, library, tab.scene) for number, tab in waiting.items()}
            self._tabs |= tabs
            note, self._note = self._note, None
        if self._ticker is not None:
            self._ticker.stop()
        if note is not None:
            note.remove()
        for tab in tabs.values():
            tab.start()

    def _show_progress(self) -> None:
        with self._lock:
            if self._note is not None and not self._closed:
                self._note.content = self._progress.html()
                for tab in self._waiting.values():
                    tab.update()

    def close(self) -> None:
        """Ends all tabs and the server."""
        if self._ticker is not None:
            self._ticker.stop()
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
            ending.join(STOP_TIMEOUT)

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Coroutines, because viser awaits them in order; it would run functions in threads, and a tab could close before it
    # opens.

    async def _open(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if self._closed:
                return
            if self._library is None:
                self._waiting[client.client_id] = WaitingTab(client, self._body)
                return
            tab = self._tabs[client.client_id] = Tab(client, self._library)
        tab.start()

    async def _close(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._waiting.pop(client.client_id, None)
            tab = self._tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close(wait=0.0)


def play(
    run_paths: Sequence[str | Path],
    *,
    host: str = LOCAL,
    port: int = 8080,
    open_browser: bool = False,
    keep_compiled: bool = True,
) -> None:
    """Serves a page to drive characters of some runs, until Ctrl-C or SIGTERM.

    Either signal ends it at once, even while something is compiled or learned; an unfinished style is not saved.

    Args:
        run_paths: run directories.
        host: address to listen at; with anything but the default, other machines can reach the page.
        port: TCP port; 0 takes a free one.
        open_browser: whether to open the page in this machine's browser.
        keep_compiled: whether to keep compiled code and the seconds of this start in the user's cache folder, so that
            later starts are faster; see `pfnn_jax.io.compilation_cache`.

    Raises:
        InputError: for a folder that is not a run directory, if the address cannot be used, or if viser is missing.
    """
    code = 1
    try:
        with _ended_by_signals() as ending, contextlib.suppress(KeyboardInterrupt):
            _play(run_paths, host, port, open_browser, keep_compiled, ending)
        print("Ended.", flush=True)
        code = 0
    except InputError:
        code = 2  # the command's exit code for bad input
        raise
    finally:
        background.leave_work(code)


def _play(
    run_paths: Sequence[str | Path],
    host: str,
    port: int,
    open_browser: bool,
    keep_compiled: bool,
    ending: Callable[[], None],
) -> None:
    background.do(check_viser)
    for path in run_paths:
        check_finished(path)
    names = run_names([Path(path) for path in run_paths])
    times = StartTimes([str(Path(path).resolve()) for path in run_paths], _cache() if keep_compiled else None)
    progress = StartProgress(times.expected)
    body = background.do(partial(standing_body, run_paths[0], names[0]))
    library = None
    # The page is there before anything is loaded, so that a taken port is reported at once.
    with Page(host=host, port=port, body=body, progress=progress) as page:
        try:
            print(f"compiling; the page is open at {page.url}: about {times.expected:.0f} s", flush=True)
            if open_browser:
                webbrowser.open(page.url)
            library = background.do(partial(RunLibrary, run_paths, progress.report))
            background.do(partial(library.warm_up, partial(prepare_walks, library)))
            page.begin(library)
            threading.Thread(target=_precompile, args=(library,), name="precompile", daemon=True).start()
            if keep_compiled:
                times.note(progress.seconds)
            print(f"{', '.join(library.runs)}: {len(library.styles)} styles at {page.url}  (Ctrl-C ends)", flush=True)
            threading.Event().wait()
        finally:
            ending()
            if library is not None:
                cancel_learning(library)
                library.empty_trash()


def _cache() -> Path | None:
    """Returns the folder in which compiled code is kept; where it is refused, says so and keeps nothing."""
    try:
        return use_private_cache()
    except InputError as error:
        print(f"nothing that is compiled is kept: {error}", file=sys.stderr, flush=True)
        return None


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[Callable[[], None]]:
    """Makes SIGTERM act like Ctrl-C within the block; yields a function that ignores both while the program ends."""
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


def _precompile(library: RunLibrary) -> None:
    """Compiles the rest of what the first upload needs, once characters can walk: before, it would delay them."""
    for run in library.runs:
        prepare_training(library, run)


def check_viser() -> None:
    """Checks that viser, which serves the page, is installed.

    Raises:
        InputError: if it is not.
    """
    try:
        import viser  # noqa: F401
    except ImportError:
        rule = "needed for the page: pip install 'pfnn-jax[viewer]'"
        raise InputError("environment", "viser", "not installed", rule) from None


def check_address(host: str, port: int) -> None:
    """Checks that a server can listen at an address.

    Raises:
        InputError: if not: the port is taken, or the address is not one of this machine's.
    """
    if not 0 <= port <= 65535:
        raise InputError("page", "port", port, "must be between 0 and 65535")
    try:
        family, _, _, _, address = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (socket.gaierror, ValueError):  # ValueError for host names that are too long or have empty parts
        raise InputError("page", "host", ascii(host)[:80], "must be an address of this machine") from None
    except OSError as error:
        reason = error.strerror or "cannot be used"
        raise InputError("page", f"port at {host}", port, f"{reason.lower()}; choose another with --port") from None


def _serve(host: str, port: int) -> viser.ViserServer:
    check_viser()
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> None:
            """Does nothing: any page can request a public address, and must not get one."""

    check_address(host, port)
    for harmless in HARMLESS:
        warnings.filterwarnings("ignore", harmless, UserWarning)
    with (
        contextlib.redirect_stdout(io.StringIO()),
        guarded(host) as started,
    ):  # viser's banner; `play` prints the address
        server = Server(host=host, port=port, verbose=False)
    if not started:
        server.stop()
        raise InputError("environment", "viser", viser.__version__, "does not allow requests to be checked; try 1.1.1")
    if port not in (0, server.get_port()):  # taken since the check; viser then takes the next one
        server.stop()
        raise InputError("page", f"port at {host}", port, "is taken; choose another with --port")
    return server
