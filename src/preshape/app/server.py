"""The app's server: one viser server on this machine, with one session for each browser."""

from __future__ import annotations

import asyncio
import contextlib
import io
import logging
import socket
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from ..exceptions import EnvironmentFailure, InputError
from .browser_session import Start
from .gate import HEADERS, Gate
from .left_page import PAGE, page_number
from .page_script import with_script
from .sessions import Sessions

if TYPE_CHECKING:
    import viser

SESSIONS = 8
"""Usual limit of open pages; each has a planner process of some 150 MB."""
LARGEST_MESSAGE = 2**20
"""Largest message of a page [bytes]; the parts of an upload have half of that."""
PANEL = 390
"""Width of the panel [pixels]."""
LAMP, SKY, GROUND = 2.6, 2.6, (165, 170, 185)
"""Brightness of the lamp and of the sky, and the colour of the light from below."""


class ViewServer:
    """Serves the app until it is stopped; its pages load nothing from other machines.

    Args:
        start: What a browser shows first.
        host: Address to listen on. Off this machine, a token that is part of ``address`` is needed.
        port: Port to listen on; 0 for any free one.
        sessions: Largest number of pages that are open at the same time.

    Raises:
        InputError: The port is not in 0..65535, or ``sessions`` is below 1.
        EnvironmentFailure: The address cannot be used.
    """

    def __init__(
        self, start: Start, *, host: str = "127.0.0.1", port: int = 8080, sessions: int = SESSIONS
    ) -> None:
        import viser

        if not 0 <= port <= 65535:
            raise InputError(f"a port must be 0 to 65535, got {port}")
        if sessions < 1:
            raise InputError(f"sessions must be 1 or more, got {sessions}")
        # viser warns of pages that close early and of pages that send nonsense; that is no news to the user.
        warnings.filterwarnings("ignore", module=r"viser\b", category=UserWarning)
        self.port = _checked(host, port)
        self.host = host
        self._gate = Gate(host, self.port, sessions)
        self._sessions = Sessions(start, sessions)
        with contextlib.redirect_stdout(io.StringIO()), _guarded(self._gate):
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

        self._server.on_client_connect(self._sessions.begin)
        self._server.on_client_disconnect(self._sessions.end)

    @property
    def address(self) -> str:
        """The address to open in a browser, with the token if one is needed."""
        return self._gate.address

    def stop(self) -> None:
        """Close every browser's planner, and the server."""
        self._sessions.close()
        with contextlib.redirect_stdout(io.StringIO()):
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
def _guarded(gate: Gate) -> Iterator[None]:
    """A server started in this context asks the gate, adds our script to its page and limits what pages send.

    viser offers no such settings, so the function that it starts its server with is replaced.
    """
    import viser
    from websockets.asyncio import server

    original, protocol = server.serve, f"viser-v{viser.__version__}"

    def serve(
        handler: Callable[..., Any], *args: Any, process_request: Callable[..., Any], **kwargs: Any
    ) -> Any:
        # A page that sends nonsense is no news to the user; errors of our own are shown in the page.
        asyncio.get_running_loop().set_exception_handler(lambda *_: None)
        quiet = logging.Logger(__name__, logging.CRITICAL + 1)

        def answered(connection: Any, request: Any) -> Any:
            response = gate.answer(request)
            if response is None:
                response = with_script(process_request(connection, request))
            if response is not None:
                response.headers.update(HEADERS)
            return response

        async def handled(connection: Any) -> None:
            if connection.subprotocol != protocol:
                await connection.close(1002, "This page is of another version; reload it")
            elif gate.full:
                await connection.close(1002, gate.full_words)
            else:
                with gate.place():
                    PAGE.set(page_number(connection.request.path))
                    await handler(connection)

        limits = {"max_size": LARGEST_MESSAGE, "close_timeout": 1, "logger": quiet}
        return original(handled, *args, process_request=answered, **(kwargs | limits))

    server.serve = serve
    try:
        yield
    finally:
        server.serve = original
