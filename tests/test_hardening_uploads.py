"""An upload to the browser app cannot leave its folder, whatever it is called."""

from __future__ import annotations

import random
import socket
from pathlib import Path

import pytest

from preshape.app.browser_session import Start
from preshape.app.server import ViewServer
from preshape.app.uploads import ALL_LARGEST, LARGEST, Uploads
from preshape.exceptions import EnvironmentFailure, InputError
from preshape.planning.request import PlanRequest

NAMES = (
    *("../../x.obj", "../../../../../../etc/passwd.obj", "/etc/x.obj", "//host/share/x.obj", "..\\..\\x.obj"),
    *(
        "C:\\Windows\\x.obj",
        "x.obj/../../y.obj",
        "..obj",
        "...obj",
        "/.obj",
        ".obj",
        "./.obj",
        "~/x.obj",
        "~root.obj",
    ),
    *(
        "a\0b.obj",
        "\0.obj",
        "a.obj\0",
        "\0/../x.obj",
        "-rf.obj",
        "$(touch x).obj",
        "`x`.obj",
        ";x.obj",
        "|x.obj",
    ),
    *(
        "%2e%2e%2fx.obj",
        "\u2025/x.obj",
        "\uff0e\uff0e\uff0fx.obj",
        "\u202egpj.obj",
        "\ud800.obj",
        "caf\u00e9.obj",
    ),
    *(
        "con.obj",
        "nul.obj",
        "x" * 5000 + ".obj",
        "../" * 2000 + "x.obj",
        "a\nb.obj",
        "\x1b[31m.obj",
        " .obj",
        "a b.OBJ",
    ),
)


@pytest.fixture
def uploads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "precious").write_text("untouched")
    kept = Uploads()
    yield kept
    kept.close()
    assert not list((tmp_path / "temporary").iterdir())
    assert {file.name for file in tmp_path.iterdir()} == {"temporary", "precious"}
    assert (tmp_path / "precious").read_text() == "untouched"


def keep(uploads: Uploads, name: str, content: bytes) -> Path:
    """Receive a file in one part."""
    uploads.begin(name, len(content))
    path = uploads.add(content)
    assert path is not None
    return path


def stays(uploads: Uploads, folder: Path, name: str) -> Path:
    """Keep an upload of that name; it lies in a folder of its own, under a plain name."""
    path = keep(uploads, name, name.encode("utf-8", "replace"))
    inside = path.relative_to(folder)
    assert path.resolve() == path
    assert len(inside.parts) == 3
    assert inside.parts[0].startswith("preshape-")
    assert inside.parts[1].isdecimal()
    stem, _, suffix = inside.parts[2].partition(".")
    assert suffix in {"obj", "stl", "ply", "off", "glb", "gltf"}
    assert 0 < len(stem) <= 40
    assert all(letter.isascii() and (letter.isalnum() or letter in "-_") for letter in stem)
    assert path.read_bytes() == name.encode("utf-8", "replace")
    return path


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[:30])
def test_names_that_lead_elsewhere(name: str, uploads: Uploads, tmp_path: Path) -> None:
    if name == "a.obj\0":  # a zero is dropped, what is left is a name like any other
        assert stays(uploads, tmp_path / "temporary", name).name == "a.obj"
    else:
        stays(uploads, tmp_path / "temporary", name)


def test_any_name_at_all(uploads: Uploads, tmp_path: Path) -> None:
    rng, kept, refused = random.Random(11), set(), 0
    letters = [
        "/",
        "\\",
        ".",
        "..",
        "\0",
        "a",
        "~",
        ":",
        "*",
        "\u202e",
        "\ud83d\ude00",
        "é",
        " ",
        "\n",
        "%00",
    ]
    for _ in range(300):
        name = "".join(rng.choices(letters, k=rng.randrange(1, 12))) + rng.choice(
            [".obj", ".STL", "", ".exe"]
        )
        try:
            kept.add(stays(uploads, tmp_path / "temporary", name))
        except InputError:
            refused += 1
    assert len(kept) > 100
    assert refused > 50
    assert len(kept) + refused == 300


@pytest.mark.parametrize(
    "name", ["x", "x.exe", "x.obj.", "x.obj.sh", "x.obj/", "..", "", "x.xml", "x.html", "x.py"]
)
def test_other_kinds_are_refused_before_anything_is_written(
    name: str, uploads: Uploads, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="a mesh file ends in"):
        keep(uploads, name, b"x")
    assert not list((tmp_path / "temporary").iterdir())


def test_a_large_file_is_refused_before_anything_is_written(uploads: Uploads, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="over 200 MB"):
        uploads.begin("x.obj", LARGEST + 1)
    with pytest.raises(InputError, match="the file is empty"):
        uploads.begin("x.obj", 0)
    assert not list((tmp_path / "temporary").iterdir())


def test_a_file_that_is_larger_than_announced_ends_where_it_was_to_end(uploads: Uploads) -> None:
    uploads.begin("x.obj", 5)
    assert uploads.add(b"abc") is None
    with pytest.raises(InputError, match="more than it had said"):
        uploads.add(b"def")
    path = uploads.add(b"de")
    assert path is not None
    assert path.read_bytes() == b"abcde"


def test_all_uploads_of_a_page_have_a_limit_and_end_with_it(uploads: Uploads, tmp_path: Path) -> None:
    for _ in range(ALL_LARGEST // LARGEST):
        uploads.begin("x.obj", LARGEST)
    with pytest.raises(InputError, match="all uploads have over 1000 MB"):
        uploads.begin("x.obj", 1)
    uploads.close()
    other = Uploads()
    other.close()
    with pytest.raises(EnvironmentFailure, match="the page was closed"):
        other.begin("x.obj", 1)
    assert not list((tmp_path / "temporary").iterdir())


def test_two_of_one_name_do_not_meet(uploads: Uploads, tmp_path: Path) -> None:
    first, second = (stays(uploads, tmp_path / "temporary", "x.obj") for _ in range(2))
    assert first != second
    assert first.name == second.name == "x.obj"


def test_a_link_put_in_the_way_is_not_followed(uploads: Uploads, tmp_path: Path) -> None:
    first = keep(uploads, "x.obj", b"one")
    (first.parent.parent / "2").symlink_to(tmp_path)
    with pytest.raises(EnvironmentFailure, match="cannot be written"):
        keep(uploads, "precious.obj", b"two")
    assert not (tmp_path / "precious.obj").exists()
    (first.parent.parent / "2").unlink()


def test_two_browsers_do_not_share_a_folder_and_others_cannot_look(tmp_path: Path, uploads: Uploads) -> None:
    other = Uploads()
    mine, theirs = keep(uploads, "x.obj", b"x"), keep(other, "x.obj", b"y")
    assert mine.parents[1] != theirs.parents[1]
    assert mine.parents[1].stat().st_mode & 0o077 == 0
    other.close()
    assert mine.exists()
    assert not theirs.exists()


@pytest.mark.parametrize(
    "target",
    [
        "/../../../../../../etc/passwd",
        "/..%2f..%2f..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/./../server.py",
        "/assets/../../../../../../../etc/passwd",
    ],
)
def test_no_address_of_the_app_leads_out_of_it(target: str, server: ViewServer) -> None:
    answer = asked(server, target)
    assert b"root:" not in answer
    assert b"import" not in answer
    assert answer.startswith(b"HTTP/1.1 4") or b"<!doctype html" in answer[:3000].lower(), answer[:200]


def test_the_app_answers_at_its_own_address(server: ViewServer) -> None:
    assert asked(server, "/").startswith(b"HTTP/1.1 200")


@pytest.fixture(scope="module")
def server():
    served = ViewServer(Start(request=PlanRequest(source="cube", task="lift", hand="utah_mit")), port=0)
    yield served
    served.stop()


def asked(server: ViewServer, target: str) -> bytes:
    """What the server answers to a request that no browser would send so."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=20) as line:
        request = f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nConnection: close\r\n\r\n"
        line.sendall(request.encode())
        answer = b""
        while len(answer) < 5000 and (part := line.recv(4096)):
            answer += part
    return answer
