"""The app's server: one viser server on this machine, with one session for each browser."""

from __future__ import annotations

import contextlib
import io
import re
import socket
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from ..exceptions import EnvironmentFailure, InputError
from .browser_session import BrowserSession, Start
from .page_script import with_script

if TYPE_CHECKING:
    import viser

LOCAL = ("127.0.0.1", "localhost", "::1")
"""Host addresses that can be reached only from this machine."""
PANEL = 390
"""Width of the panel [pixels]."""
LAMP, SKY, GROUND = 2.6, 2.6, (165, 170, 185)
"""Brightness of the lamp and of the sky, and the colour of the light from below."""


class ViewServer:
    """Serves the app until it is stopped; its pages load nothing from other machines.

    Args:
        start: What a browser shows first.
        host: Address to listen on; anyone who can reach this address can use the app.
        port: Port to listen on; 0 for any free one.

    Raises:
        InputError: The port is not in 0..65535.
        EnvironmentFailure: The address cannot be used.
    """

    def __init__(self, start: Start, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        import viser

        if not 0 <= port <= 65535:
            raise InputError(f"a port must be 0 to 65535, got {port}")
        self.port = _checked(host, port)
        self.host = host
        self._sessions: dict[int, BrowserSession] = {}
        self._lock = threading.Lock()
        with contextlib.redirect_stdout(io.StringIO()), _own_pages(host):
            self._server = viser.ViserServer(host=host, port=self.port, label="preshape", verbose=False)
        self.port = int(self._server.get_port())
        # viser lets a browser open a tunnel to the internet; this disables it.
        self._server.request_share_url = lambda *_, **__: None
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(0, 114, 178)
        )
        self._server.gui.main_panel.dock_right()
        self._server.gui.main_panel.set_width(PANEL)
        self._server.scene.set_up_direction("+z")
        _light(self._server.scene)

        def connected(client: viser.ClientHandle) -> None:
            session = BrowserSession(client, start)
            with self._lock:
                self._sessions[client.client_id] = session

        def gone(client: viser.ClientHandle) -> None:
            with self._lock:
                session = self._sessions.pop(client.client_id, None)
            if session is not None:
                session.close()

        self._server.on_client_connect(connected)
        self._server.on_client_disconnect(gone)

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        name = "localhost" if self.host in ("0.0.0.0", "::", *LOCAL) else self.host
        return f"http://{name}:{self.port}"

    def stop(self) -> None:
        """Close every browser's planner, and the server."""
        with self._lock:
            sessions, self._sessions = list(self._sessions.values()), {}
        for session in sessions:
            session.close()
        self._server.stop()


def _checked(host: str, port: int) -> int:
    """Check that the port can be used, and return it; for 0, return a free port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except OSError as error:
        raise EnvironmentFailure(
            f"cannot listen on {host} port {port} ({error.strerror or error}); choose another with --port"
        ) from error


def _light(scene: viser.SceneApi) -> None:
    """Use one lamp and a bright sky, at a third of the rendering cost of viser's lamps and sky photo."""
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_directional("/light/lamp", intensity=LAMP, position=(-0.35, -0.45, 1.0))
    scene.add_light_hemisphere("/light/sky", intensity=SKY, ground_color=GROUND)


@contextlib.contextmanager
def _own_pages(host: str) -> Iterator[None]:
    """A server started in this context adds our script to its page and refuses foreign origins.

    Without this check of origins, any web page that a user visits could use the server on the user's machine.
    """
    from websockets.asyncio import server

    original = server.serve

    def serve(*args: Any, process_request: Callable[..., Any], **kwargs: Any) -> Any:
        if host in LOCAL:
            names = "|".join(re.escape(name) for name in ("127.0.0.1", "localhost", "[::1]"))
            kwargs["origins"] = [re.compile(rf"https?://({names})(:\d+)?"), None]

        def answered(*asked: Any) -> Any:
            return with_script(process_request(*asked))

        return original(*args, process_request=answered, **kwargs)

    server.serve = serve
    try:
        yield
    finally:
        server.serve = original
