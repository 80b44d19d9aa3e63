"""The browser app's server under attack: the gate by requests, the rest as `python -m hardening.server`."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from hardening.server import (
    MB,
    App,
    crowded,
    ended,
    main,
    noise,
    opened_and_closed,
    served,
    settled,
    strangers,
    uploaded,
)
from websockets.datastructures import Headers

from preshape.app.gate import HEADERS, Gate
from preshape.app.server import ViewServer
from preshape.exceptions import InputError

WEBSOCKET = {"Upgrade": "websocket"}


def asked(gate: Gate, path: str = "/", **headers: str):
    return gate.answer(SimpleNamespace(path=path, headers=Headers(headers)))


@pytest.fixture(scope="module")
def app() -> Iterator[App]:
    with served("--sessions", "3") as one:
        yield one


# -- the gate ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("more", [{}, WEBSOCKET])
@pytest.mark.parametrize(
    ("host", "headers", "let_in"),
    [
        ("127.0.0.1", {"Host": "localhost:8080"}, True),
        ("127.0.0.1", {"Host": "127.0.0.1:8080"}, True),
        ("127.0.0.1", {"Host": "[::1]:8080"}, True),
        ("127.0.0.1", {"Host": "LOCALHOST:8080", "Origin": "http://localhost:8080"}, True),
        ("127.0.0.1", {"Host": "localhost:9000", "Origin": "http://localhost:9000"}, True),  # a tunnel
        ("127.0.0.1", {"Host": "localhost:8080", "Origin": "http://localhost:3000"}, False),
        ("127.0.0.1", {"Host": "localhost:8080", "Origin": "http://127.0.0.1:8080"}, False),
        ("127.0.0.1", {"Host": "localhost:8080", "Origin": "http://elsewhere.example"}, False),
        ("127.0.0.1", {"Host": "localhost:8080", "Origin": "null"}, False),
        ("127.0.0.1", {"Host": "localhost:8080", "Origin": "http://["}, False),
        ("127.0.0.1", {"Host": "elsewhere.example:8080", "Origin": "http://elsewhere.example:8080"}, False),
        ("127.0.0.1", {"Host": "localhost.elsewhere.example"}, False),
        ("127.0.0.1", {}, False),
        ("127.0.0.2", {"Host": "127.0.0.2:8080", "Origin": "http://127.0.0.2:8080"}, True),
        ("127.0.0.2", {"Host": "127.0.0.2:8080", "Origin": "http://elsewhere.example"}, False),
        ("::1", {"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, True),
    ],
)
def test_on_this_machine_only_the_own_page_is_let_in(host, headers, let_in, more) -> None:
    answer = asked(Gate(host, 8080, 2), **headers, **more)
    assert (answer is None) == let_in
    assert answer is None or answer.status_code == 403


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.0.2.7", "robot.example"])
def test_off_this_machine_a_token_is_needed(host: str) -> None:
    gate = Gate(host, 8080, 2)
    own = {"Host": "robot.example:8080"}
    assert gate.token is not None
    assert len(gate.token) >= 32
    assert gate.token != Gate(host, 8080, 2).token
    for wrong in ("", "?token=", f"?token={gate.token[:-1]}", f"?token={gate.token}x", "?token=%ff"):
        for more in ({}, WEBSOCKET, {"Cookie": "preshape-8080="}, {"Cookie": f"preshape-1={gate.token}"}):
            assert asked(gate, f"/{wrong}", **own, **more).status_code == 403
    first = asked(gate, f"/?token={gate.token}", **own)
    assert (first.status_code, first.headers["Location"]) == (302, "/")
    kept, *terms = first.headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Lax", "Path=/"} == set(terms)
    for cookie in (kept, f"other=1; {kept}", f"{kept};x=y"):
        assert asked(gate, **own, Cookie=cookie) is None
        assert asked(gate, **own, Cookie=cookie, **WEBSOCKET) is None
        foreign = {"Cookie": cookie, "Origin": "http://elsewhere.example"}
        assert asked(gate, **own, **foreign).status_code == 403
        assert asked(gate, **own, **foreign, **WEBSOCKET).status_code == 403
    assert asked(gate, f"/?token={gate.token}", **own, **WEBSOCKET) is None


def test_a_link_cannot_name_another_server_or_place() -> None:
    gate = Gate("127.0.0.1", 8080, 2)
    for path in ("/?websocket=ws://elsewhere.example", "/?playbackPath=x", "//elsewhere.example/?x", "/a?b"):
        answer = asked(gate, path, Host="localhost:8080")
        assert (answer.status_code, answer.headers["Location"]) == (302, "/")
        assert "Set-Cookie" not in answer.headers


def test_a_page_too_many_is_told_so_and_waits_for_room() -> None:
    gate = Gate("127.0.0.1", 8080, 1)
    with gate.place():
        answer = asked(gate, Host="localhost:8080")
        assert answer.status_code == 503
        assert b"Too many pages" in answer.body
        assert b"1 pages are open" in answer.body
        assert b'http-equiv="refresh"' in answer.body
        assert len(gate.full_words) <= 120
        assert asked(gate, Host="localhost:8080", **WEBSOCKET) is None  # it is told in the page
    assert asked(gate, Host="localhost:8080") is None


def test_less_than_one_page_is_refused() -> None:
    with pytest.raises(InputError, match="sessions must be 1 or more, got 0"):
        ViewServer(None, port=0, sessions=0)  # type: ignore[arg-type]


# -- the server ----------------------------------------------------------------------------------------


def test_pages_that_close_at_once_leave_no_planner(app: App) -> None:
    found = opened_and_closed(app, 9)
    assert found["faults"] == []
    assert found["planners_left"] == 0


def test_uploads_are_limited_before_they_are_held(app: App) -> None:
    too_large, too_long = uploaded(app, 201 * MB), uploaded(app, 40 * MB, declared=MB)
    assert too_large["faults"] == too_long["faults"] == []
    assert too_large["stored_mb"] == 0
    assert too_long["stored_mb"] <= 1
    assert uploaded(app, 3 * MB)["stored_mb"] == 3


def test_noise_is_no_news_and_there_is_room_for_as_many_pages_as_allowed(app: App) -> None:
    assert noise(app, 16, seed=3)["faults"] == []
    found = crowded(app, 5, 3)
    assert found["faults"] == []
    assert found["most_planners"] == 3


def test_strangers_are_refused_and_every_answer_has_the_headers(app: App) -> None:
    assert strangers(app)["faults"] == []
    answer = app.get()
    assert answer.status == 200
    assert {name: answer.headers[name] for name in HEADERS} == HEADERS


def test_sigterm_ends_planners_at_once_and_removes_uploads(app: App) -> None:
    found = ended(app, signal.SIGTERM, 2)
    assert found["faults"] == []
    assert app.process.returncode == 0
    assert app.said == []


def test_with_a_token_the_app_is_reached_from_everywhere_by_its_own_page_only() -> None:
    with served("--host", "0.0.0.0") as app:
        assert app.token
        assert strangers(app)["faults"] == []
        first = app.get(f"/?token={app.token}")
        assert first.status == 302
        assert first.headers["Set-Cookie"].startswith(app.known["Cookie"])
        assert app.get(**app.known).status == 200
        app.session().close()
        found = ended(app, signal.SIGKILL, 1)  # a planner ends with its server, however that ends
        assert found["faults"] == []


def test_the_target_reports_and_counts_faults(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setattr("hardening.server.study", lambda long: {"one": {"pages": 1, "faults": ["it stays"]}})
    assert main(["--out", str(tmp_path)]) == 1
    assert "one: pages 1\n  fault: it stays" in capsys.readouterr().out
    assert (tmp_path / "server.json").exists()
    assert not settled(lambda: False, 0.1)
