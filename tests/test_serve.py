from __future__ import annotations

import http.client
import inspect
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import preshape
from preshape.exceptions import InputError
from preshape.planning import keywords
from preshape.planning.document import plan_to_json
from preshape.planning.request import PlanRequest
from preshape.planning.session import Session
from preshape.serve import handler, shelf
from preshape.serve.admission import Admission
from preshape.serve.openapi import document, page
from preshape.serve.pool import PlannerPool, PoolBusy
from preshape.serve.server import PlanServer
from preshape.serve.shelf import Shelf
from preshape.serve.worker import WarmPlanner

ROOT = Path(__file__).parent.parent
CUBE = {"object": "cube", "task": "1 1 .1 .05 .8 .05", "hand": "utah_mit"}
# A planner process that imports nothing: it echoes, sleeps as many seconds as the seed says, or ends.
PLANNER = """
import json, os, sys, time
for line in sys.stdin:
    message = json.loads(line)
    asked = message["request"]
    time.sleep(asked.get("seed", 0))
    if asked["task"] == "end":
        os._exit(1)
    text = json.dumps({"status": "answer", "object": asked["object"], "process": os.getpid()})
    print(json.dumps({"id": message["id"], "text": text, "done": True}), flush=True)
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("planner")
    (folder / "plain_planner.py").write_text(PLANNER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(folder))
        yield ("plain_planner",)


@pytest.fixture
def served(program: Any) -> Any:
    """A server in this process with two plain planners."""
    server = PlanServer(program, port=0, workers=2, seconds=20)
    yield server
    server.stop()


def ask(
    server: Any, method: str = "POST", path: str = "/plan", body: Any = None, **headers: str
) -> tuple[int, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    content = json.dumps(body) if isinstance(body, dict) else body
    connection.request(
        method, path, content, {name.replace("_", "-"): text for name, text in headers.items()}
    )
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    found = json.loads(text) if answer.getheader("Content-Type") == "application/json" else text
    return answer.status, found


def settled(true: Any, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.02)
    return bool(true())


# What a request may say.


def test_the_keywords_are_those_of_plan_and_of_the_schema():
    own = set(inspect.signature(preshape.plan).parameters) - {"thing", "memory", "settings", "closure"}
    more = {"object", "estimation_threshold", "recognition_threshold", "search", "gravity"}
    assert set(keywords.KEYWORDS) == own | more
    schema = json.loads((ROOT / "src/preshape/schema/request.schema.json").read_text())
    assert set(schema["properties"]) == set(keywords.KEYWORDS)
    jsonschema.Draft202012Validator.check_schema(schema)
    defaults = {name: entry["default"] for name, entry in schema["properties"].items() if "default" in entry}
    stated, bare = (
        keywords.request_from_keywords({**more, "object": "mug", "task": "lift"}) for more in (defaults, {})
    )
    assert stated.to_json() == bare.to_json()


def test_both_forms_of_a_request_give_the_same_request():
    short = keywords.request_from_keywords(
        {"object": "mug", "task": "pour", "hand": "shadow", "table": "auto", "count": 3, "keep_off": "rim"}
    )
    same = PlanRequest(source="mug", task="pour", hand="shadow", table="auto", count=3, keep_off="rim")
    assert short.to_json() == same.to_json()
    assert keywords.request_from_keywords(short.to_json()).to_json() == short.to_json()
    numbers = keywords.request_from_keywords({"object": "cube", "task": [1, 1, 0.1, 0.05, 0.8, 0.05]})
    assert numbers.asked.q.tolist() == [1, 1, 0.1, 0.05, 0.8, 0.05]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (7, "a JSON object"),
        ({"task": "lift"}, "needs the key object"),
        ({"object": "mug"}, "needs the key task"),
        ({"object": "mug", "task": "lift", "hnad": "leap"}, "did you mean hand"),
        ({"object": "mug", "task": "lift", "memory": "x"}, "no key 'memory'"),
        ({"object": ["mug"], "task": "lift"}, "object must be"),
        ({"object": "mug", "task": "lift", "search": {"speed": 1}}, "search must be"),
        ({"object": "mug", "task": "lift", "seed": -1}, "seed"),
        ({"object": "mug", "task": {"name": "x"}}, "stored task"),
        ({"object": {"source": "mug"}, "task": "lift"}, "no request of preshape"),
    ],
)
def test_a_request_that_is_none_is_refused(data, words):
    with pytest.raises(InputError, match=words):
        keywords.request_from_keywords(data)


def test_only_files_of_the_folder_may_be_named(tmp_path):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "part.stl").touch()
    (tmp_path / "secret.stl").touch()
    (tmp_path / "own" / "link.stl").symlink_to(tmp_path / "secret.stl")
    door = Admission(Shelf(), tmp_path / "own")
    part = str((tmp_path / "own" / "part.stl").resolve())
    data, names = door.admit(
        {"object": "part.stl#2", "obstacle": "part.stl@0,0,1,1,0,0,0", "hand": "leap:left"}
    )
    assert data == {"object": f"{part}#2", "obstacle": [f"{part}@0,0,1,1,0,0,0"], "hand": "leap:left"}
    assert not names
    assert door.admit({"object": {"source": "mug"}})[0] == {"object": {"source": "mug"}}
    for bad in ("../secret.stl", str(tmp_path / "secret.stl"), "link.stl", "\0", ".", "upload:../../secret"):
        for request in ({"object": bad}, {"object": {"source": bad}}, {"obstacle": [bad]}):
            with pytest.raises(InputError):
                door.admit(request)
    for bad in ("../secret.urdf", str(tmp_path / "secret.urdf"), "link.stl", "\0", "."):
        with pytest.raises(InputError):
            door.admit({"arm": bad})
    for hand in ("../secret.xml", "menagerie:shadow_hand", "shadow:up", "x.toml#motors=/etc/passwd"):
        with pytest.raises(InputError):
            Admission(Shelf(), None).admit({"hand": hand})


def test_meshes_are_kept_once_and_the_oldest_go(monkeypatch):
    monkeypatch.setattr(shelf, "MOST", 2)
    kept = Shelf()
    numbers = [kept.put("a.stl", 4, [b"so", text]) for text in (b"me", b"me", b"ft")]
    assert numbers[0] == numbers[1] != numbers[2]
    first = kept.get(numbers[0])
    assert first.path.read_bytes() == b"some"
    data, names = Admission(kept, None).admit({"object": numbers[0]})
    assert data == {"object": str(first.path)}
    assert names == {str(first.path): "a.stl"}
    kept.put("c.stl", 4, [b"blue"])
    assert first.path.exists()  # it was asked for last
    with pytest.raises(InputError, match="no longer kept"):
        kept.get(numbers[2])
    for name, size, parts in (
        ("a.exe", 1, [b"x"]),
        ("a.stl", 0, []),
        ("a.stl", 3, [b"x"]),
        ("a.stl", 1, [b"xx"]),
    ):
        with pytest.raises(InputError):
            kept.put(name, size, parts)
    kept.close()
    assert not first.path.exists()


# What the server lets in.


def test_the_document_and_the_page(served):
    status, found = ask(served, "GET", "/openapi.json")
    assert (status, found) == (200, document())
    jsonschema.Draft202012Validator.check_schema(found["components"]["schemas"]["Plan"])
    status, shown = ask(served, "GET", "/")
    assert (status, shown.decode()) == (200, page())
    assert all(f"<td>{name}</td>" in page() for name in keywords.KEYWORDS)
    assert ask(served, "GET", "/health")[1]["workers"] == 2


def test_strangers_are_refused(served):
    own = f"localhost:{served.port}"
    assert ask(served, body=CUBE, Host=own, Origin=f"http://{own}")[0] == 200
    assert ask(served, body=CUBE, Host="elsewhere.example")[0] == 403
    assert ask(served, body=CUBE, Host=own, Origin="http://elsewhere.example")[0] == 403
    assert ask(served, "POST", "/command", CUBE)[0] == 404


def test_off_this_machine_a_token_is_needed(program):
    server = PlanServer(program, host="0.0.0.0", port=0, workers=1)
    try:
        token = server.address.partition("token=")[2]
        assert len(token) >= 32
        assert ask(server, body=CUBE)[0] == 401
        assert ask(server, body=CUBE, Authorization=f"Bearer {token[:-1]}")[0] == 401
        assert ask(server, body=CUBE, Authorization=f"Bearer {token}")[0] == 200
        assert ask(server, "GET", f"/?token={token}")[0] == 200
    finally:
        server.stop()


@pytest.mark.parametrize(
    ("method", "path", "body", "status"),
    [
        ("POST", "/plan", "{", 400),
        ("POST", "/plan", "[" * 100_000, 400),
        ("POST", "/plan", "[1]", 400),
        ("POST", "/plan", '{"object": "/etc/passwd", "task": "lift"}', 400),
        ("POST", "/objects", "x", 400),
        ("POST", "/objects?name=a.exe", "x", 400),
        ("GET", "/plan", None, 405),
        ("POST", "/health", "{}", 405),
        ("GET", "/nothing", None, 404),
        ("DELETE", "/plan", None, 405),
    ],
)
def test_errors_are_the_object_that_the_command_line_prints(served, method, path, body, status):
    got, found = ask(served, method, path, body)
    assert got == status
    jsonschema.validate(
        found, {"$ref": "#/$defs/error", "$defs": document()["components"]["schemas"]["Plan"]["$defs"]}
    )


def raw(server: Any, text: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as connection:
        connection.sendall(text)
        parts = []
        while part := connection.recv(2**16):
            parts.append(part)
    return b"".join(parts)


def test_bodies_are_measured_before_they_are_read(served, monkeypatch):
    monkeypatch.setattr(handler.Handler, "_body", lambda self: pytest.fail("the body was read"))
    head = f"Host: localhost:{served.port}\r\n".encode()
    for path, size in (("/plan", handler.LARGEST_REQUEST + 1), ("/objects?name=a.stl", handler.LARGEST + 1)):
        sent = f"POST {path} HTTP/1.1\r\nContent-Length: {size}\r\nExpect: 100-continue\r\n".encode()
        assert raw(served, sent + head + b"\r\n").startswith(b"HTTP/1.1 413 ")
    for lines in (b"", b"Transfer-Encoding: chunked\r\n", b"Content-Length: 2\r\nContent-Length: 3\r\n"):
        assert raw(served, b"POST /plan HTTP/1.1\r\n" + lines + head + b"\r\n").startswith(b"HTTP/1.1 411 ")
    for number in (b"-1", b"2_0", b"x"):
        sent = b"POST /plan HTTP/1.1\r\nContent-Length: " + number + b"\r\n"
        assert raw(served, sent + head + b"\r\n").startswith(b"HTTP/1.1 400 ")


def test_what_is_left_of_a_refused_body_is_no_request(served):
    inner = f"GET /health HTTP/1.1\r\nHost: localhost:{served.port}\r\n\r\n".encode()
    head = f"GET / HTTP/1.1\r\nHost: localhost:{served.port}\r\nContent-Length: {len(inner)}\r\n\r\n".encode()
    assert raw(served, head + inner).count(b"HTTP/1.1 ") == 1
    assert raw(served, b"nonsense\r\n\r\n").startswith(b"HTTP/1.1 400 ")


def test_a_slow_client_loses_its_connection(served, monkeypatch):
    monkeypatch.setattr(handler, "PATIENCE", 0.3)
    head = f"POST /plan HTTP/1.1\r\nHost: localhost:{served.port}\r\nContent-Length: 9\r\n\r\n".encode()
    assert raw(served, head[:20]) == b""
    assert raw(served, head + b"{").startswith(b"HTTP/1.1 408 ")


# Who waits, and for how long.


def test_many_clients_get_their_own_answers(served):
    def client(number: int) -> list[tuple[int, str]]:
        connection, got = http.client.HTTPConnection("127.0.0.1", served.port, timeout=60), []
        for k in range(25):
            path = "/plan" if k % 5 else f"/objects?name=a{number}.stl"
            thing = ("cube", "mug", "box")[(number + k) % 3]
            connection.request("POST", path, json.dumps({**CUBE, "object": thing}))
            answer = connection.getresponse()
            found = json.loads(answer.read())
            got.append((answer.status, found["object"] == thing if k % 5 else found["object"][:7]))
        connection.close()
        return got

    with ThreadPoolExecutor(8) as clients:
        rows = [row for rows in clients.map(client, range(8)) for row in rows]
    assert sorted(set(rows)) == [(200, True), (201, "upload:")]
    assert settled(lambda: ask(served, "GET", "/health")[1]["busy"] == 0)


def test_a_client_that_leaves_cancels_its_work(served):
    connection = http.client.HTTPConnection("127.0.0.1", served.port)
    connection.request("POST", "/plan", json.dumps({**CUBE, "seed": 60}))
    assert settled(lambda: ask(served, "GET", "/health")[1]["busy"] == 1)
    connection.close()
    assert settled(lambda: ask(served, "GET", "/health")[1]["busy"] == 0)
    assert ask(served, body=CUBE)[0] == 200


def test_limits_of_time_and_of_the_queue(program):
    pool = PlannerPool(program, 1, 1)

    def plan(seed: float, seconds: float, task: str = "lift") -> Any:
        message = {"do": "plan", "request": {"object": "mug", "task": task, "seed": seed}}
        return list(pool.replies(message, key="", seconds=seconds, gone=lambda: False))[-1]

    try:
        first = json.loads(plan(0, 20)["text"])["process"]
        with pytest.raises(preshape.EnvironmentFailure, match="no answer within"):
            plan(60, 0.3)
        assert json.loads(plan(0, 20)["text"])["process"] != first
        assert "the planner stopped" in plan(0, 20, "end")["error"]
        assert "text" in plan(0, 20)
        with ThreadPoolExecutor(2) as others:
            works = others.submit(plan, 1.0, 20)
            assert settled(lambda: pool.state["busy"] == 1)
            waits = others.submit(plan, 0, 20)
            assert settled(lambda: pool.state["waiting"] == 1)
            with pytest.raises(PoolBusy, match="the limit"):
                plan(0, 20)
            assert works.result()["done"]
            assert waits.result()["done"]
    finally:
        pool.close()


def test_a_process_that_has_prepared_an_object_is_preferred(program):
    pool = PlannerPool(program, 2, 4)

    def process(thing: str) -> int:
        message = {"do": "plan", "request": {"object": thing, "task": "lift"}}
        *_, last = pool.replies(message, key=thing, seconds=20, gone=lambda: False)
        return int(json.loads(last["text"])["process"])

    try:
        found = {thing: process(thing) for thing in ("mug", "box")}
        assert len(set(found.values())) == 2
        for _ in range(3):
            assert {thing: process(thing) for thing in ("box", "mug")} == found
    finally:
        pool.close()


# With the planner itself.


def test_the_same_request_again_needs_no_search_until_the_memory_changes(tmp_path, monkeypatch):
    runs = []
    run = Session.run
    monkeypatch.setattr(Session, "run", lambda *given: runs.append(1) or run(*given))
    planner = WarmPlanner(str(tmp_path / "memory.sqlite"))
    first = json.loads(planner.plan(CUBE, {}))
    again = json.loads(planner.plan(CUBE, {}))
    assert (first["mode"], again["mode"]) == (0, 0)
    count = len(runs)
    assert json.loads(planner.plan(CUBE, {})) == again
    assert len(runs) == count
    with preshape.Memory.open(tmp_path / "memory.sqlite") as memory:
        assert memory.reset()
    planner.plan(CUBE, {})
    assert len(runs) == count + 1
    with pytest.raises(InputError, match="at most 100 over HTTP"):
        planner.plan({**CUBE, "count": 101}, {})
    planner.close()


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """``preshape serve`` with one planner and a memory of its own."""
    folder = tmp_path_factory.mktemp("serve")
    command = [
        sys.executable,
        "-m",
        "preshape",
        "serve",
        "--port",
        "0",
        "--workers",
        "1",
        "--hand",
        "utah_mit",
    ]
    environment = {**os.environ, "TMPDIR": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    running = subprocess.Popen(
        [*command, "--memory", str(folder / "memory.sqlite")],
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert running.stderr is not None
    line = running.stderr.readline()
    running.port = int(line.partition("localhost:")[2].split()[0])  # type: ignore[attr-defined]
    running.folder = folder  # type: ignore[attr-defined]
    yield running
    running.kill()
    running.wait()
    running.stderr.close()


def without_times(plan: Any) -> Any:
    if isinstance(plan, dict):
        return {key: without_times(value) for key, value in plan.items() if key not in ("seconds", "memory")}
    return [without_times(item) for item in plan] if isinstance(plan, list) else plan


def test_the_answers_are_those_of_the_command_line(process, tmp_path):
    status, got = ask(process, body=CUBE)
    assert status == 200
    jsonschema.validate(got, document()["components"]["schemas"]["Plan"])
    shutil.copy(process.folder / "memory.sqlite", tmp_path)
    with Session(tmp_path / "memory.sqlite") as session:
        own = plan_to_json(session.run(PlanRequest(source="cube", task=CUBE["task"], hand="utah_mit")))
    assert without_times(got) == without_times(own)
    status, again = ask(process, body=got["request"])
    assert without_times(again) == without_times(got)
    status, error = ask(process, body={**CUBE, "task": "fly"})
    assert (status, error["status"]) == (400, "error")
    assert "no task 'fly'" in error["reason"]


def test_a_mesh_that_was_sent_keeps_its_name(process):
    content = "".join(f"v {x} {y} {z}\n" for x in (0, 0.04) for y in (0, 0.05) for z in (0, 0.06))
    content += "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    status, kept = ask(process, path="/objects?name=my%20part.obj", body=content)
    assert status == 201
    status, got = ask(process, body={**CUBE, "object": kept["object"]})
    assert status == 200, got
    assert got["object"]["source"] == got["request"]["object"]["source"] == "my_part.obj"
    assert "/preshape-" not in json.dumps(got)


def test_the_examples_ask_the_server(process, tmp_path):
    address = f"http://127.0.0.1:{process.port}"
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / "serve" / "client.py", address, json.dumps(CUBE)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "cube answer" in done.stdout
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("there is no compiler of C++")
    source = ROOT / "examples" / "serve" / "client.cpp"
    subprocess.run(
        [compiler, "-std=c++17", "-Wall", "-Werror", source, "-o", tmp_path / "client"], check=True
    )
    done = subprocess.run(
        [tmp_path / "client", "127.0.0.1", str(process.port), json.dumps(CUBE)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["object"]["name"] == "cube"


def command(process: Any, *words: str, **environment: str) -> tuple[int, str, str]:
    """The command line in the server's environment, and what it has imported besides."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "preshape", *words],
        capture_output=True,
        text=True,
        cwd=process.folder,
        env={
            **os.environ,
            "TMPDIR": str(process.folder),
            "XDG_RUNTIME_DIR": str(process.folder),
            **environment,
        },
    )
    imported = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    said = "".join(f"{line}\n" for line in done.stderr.splitlines() if line not in imported)
    process.alone = any(line.endswith(" numpy") for line in imported)
    return done.returncode, done.stdout, said


@pytest.mark.parametrize(
    "words",
    [
        ("plan", "cube", "--task", CUBE["task"], "--hand", "utah_mit", "--json"),
        ("plan", "cube", "--task", CUBE["task"], "--hand", "utah_mit", "--explain"),
        ("plan", "cueb", "--task", "lift", "--json"),
        ("plan", "cube", "--task", "lift", "--hnad", "x"),
    ],
    ids=["json", "text", "wrong", "usage"],
)
def test_the_command_line_asks_the_server_and_prints_the_same(process, words):
    words = (*words, "--memory", "memory.sqlite")
    code, out, err = command(process, *words)
    assert not process.alone
    own = command(process, *words, PRESHAPE_SERVE="off")
    assert process.alone or code == 2
    if code == 0 and "--json" in words:
        assert without_times(json.loads(out)) == without_times(json.loads(own[1]))
        own = (own[0], out, own[2])
    assert (code, out, err) == own


def test_a_server_of_another_memory_or_environment_is_not_asked(process, tmp_path):
    words = ("plan", "cube", "--task", CUBE["task"], "--hand", "utah_mit", "--json", "--memory")
    for memory, environment in (
        ("other.sqlite", {}),
        (":memory:", {}),
        ("memory.sqlite", {"PRESHAPE_CACHE": str(tmp_path)}),
        ("memory.sqlite", {"XDG_RUNTIME_DIR": str(tmp_path)}),
    ):
        code, out, _ = command(process, *words, memory, **environment)
        assert (code, json.loads(out)["status"], process.alone) == (0, "answer", True)
    folder = process.folder / "preshape"
    folder.chmod(0o755)  # somebody else could have put a socket there
    assert command(process, *words, "memory.sqlite")[0] == 0
    assert process.alone
    folder.chmod(0o700)


def test_sigterm_ends_the_server_and_its_planners_at_once(process):
    """The last test with this process."""
    planners = subprocess.run(
        ["pgrep", "-P", str(process.pid)], capture_output=True, text=True
    ).stdout.split()
    assert len(planners) == 1
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=20) == 130
    assert (
        process.stderr.read().strip().splitlines()[-1]
        == "interrupted; everything that was acknowledged is kept"
    )
    assert settled(lambda: not any(Path(f"/proc/{number}").exists() for number in planners))
    assert not [*process.folder.rglob("my_part.obj"), *process.folder.rglob("*.sock")]
