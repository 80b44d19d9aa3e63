"""Ctrl-C and SIGTERM on the command line: 130, one line, one JSON document, nothing left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from textwrap import indent

import pytest
from hardening import signals as study

from preshape.cli import interrupts
from preshape.cli.early import INTERRUPTED

HEAD = (
    "import os, signal, sys, time\n"
    "from preshape.cli import interrupts\n"
    "interrupts.install(True)\n"
    "def send(number=signal.SIGINT):\n    os.kill(os.getpid(), number)\n"
)
SWALLOW = "try:\n    {}\n    time.sleep(60)\nexcept BaseException:\n    pass\ntime.sleep(60)\n"


def ended(code: str, folder: Path, head: str = HEAD) -> subprocess.CompletedProcess[str]:
    """A process that has started the guard, sends itself a signal, and would go on for a minute."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "TMPDIR": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", head + code],
        check=False, capture_output=True, text=True, env=environment, timeout=50,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


STARTING = """
import os, signal, sys
class Sender:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.{number})
sys.meta_path.insert(0, Sender)
sys.argv = ["preshape", "tasks", *{options}]
from preshape.__main__ import main
main()
"""


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("name", ["preshape.cli.main", "preshape.cli.interrupts", "preshape.cli.streams"])
@pytest.mark.parametrize("options", [["--json"], []])
def test_a_signal_while_the_command_line_is_imported(
    name: str, number: str, options: list[str], tmp_path: Path
) -> None:
    done = ended(STARTING.format(name=name, number=number, options=options), tmp_path, head="")
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")
    if options:
        assert json.loads(done.stdout) == {"status": "error", "reason": INTERRUPTED}
    else:
        assert done.stdout == ""


def test_signals_that_were_ignored_before_the_start_stay_ignored(tmp_path: Path) -> None:
    code = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)" + STARTING
    done = ended(
        code.format(name="preshape.cli.main", number="SIGINT", options=["--json"]), tmp_path, head=""
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)


def test_nothing_is_imported_before_the_first_guard() -> None:
    code = (
        "import sys; before = set(sys.modules); import preshape.__main__; print(*set(sys.modules) - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    own = {"preshape", "preshape.__main__", "preshape._version", "preshape.cli", "preshape.cli.early"}
    assert set(done.stdout.split()) <= own | {"__future__"}
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["project"]["scripts"] == {"preshape": "preshape.__main__:main"}


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_code_that_swallows_every_exception(number: str, tmp_path: Path) -> None:
    done = ended(SWALLOW.format(f"send(signal.{number})"), tmp_path)
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")
    assert json.loads(done.stdout) == {"status": "error", "reason": INTERRUPTED}


def test_a_signal_ends_an_import_and_removes_temporary_files(tmp_path: Path) -> None:
    (tmp_path / "swallowing.py").write_text(
        "from __main__ import send, time\n"
        "from preshape.files import temporary_folder\n"
        "with temporary_folder('test') as folder:\n"
        "    (folder / 'file').touch()\n"
        "    send()\n    time.sleep(60)\n"
    )
    done = ended(SWALLOW.format("import swallowing"), tmp_path)
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")
    assert not list(tmp_path.glob("preshape-*"))


def test_the_line_is_shown_while_messages_of_libraries_are_discarded(tmp_path: Path) -> None:
    done = ended("os.dup2(os.open(os.devnull, os.O_WRONLY), 2); send(); time.sleep(60)", tmp_path)
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")


def test_a_document_that_is_being_written_is_completed_and_stays_the_only_one(tmp_path: Path) -> None:
    code = (
        "with interrupts.output:\n"
        "    sys.stdout.write('{\"status\": '); sys.stdout.flush(); send(); time.sleep(0.3)\n"
        "    sys.stdout.write('\"answer\"}'); sys.stdout.flush(); interrupts.answered()\n"
        "time.sleep(60)"
    )
    done = ended(code, tmp_path)
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")
    assert json.loads(done.stdout) == {"status": "answer"}


def test_patient_code_ends_its_work_and_a_second_signal_ends_it_at_once(tmp_path: Path) -> None:
    code = (
        "with interrupts.patient():\n"
        "    try:\n        send(signal.SIGTERM); time.sleep(60)\n"
        "    except KeyboardInterrupt:\n"
        "        print('finishing', interrupts.swallowed(), file=sys.stderr)\n"
        "        time.sleep(1.1 * interrupts.PATIENCE); send(); time.sleep(60)\n"
    )
    done = ended(code, tmp_path)
    assert (done.returncode, done.stderr) == (130, f"finishing True\n{INTERRUPTED}\n")


@pytest.mark.parametrize(
    "waits", ["time.sleep(60)", "threading.Event().wait(60)", "os.read(os.pipe()[0], 1)"]
)
def test_patient_code_is_told_of_a_signal_that_another_thread_takes(waits: str, tmp_path: Path) -> None:
    """The system gives a signal to any thread; here it is one that is not the main thread."""
    code = (
        "import threading\n"
        "def take():\n"
        "    time.sleep(0.3)\n"
        "    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)\n"
        "    time.sleep(60)\n"
        "threading.Thread(target=take, daemon=True).start()\n"
        "try:\n"
        "    with interrupts.patient():\n"
        f"        {waits}\n"
        "except KeyboardInterrupt:\n"
        "    time.sleep(1.2)\n"  # the signal that was passed on is no second one
        "    print('ended')\n"
    )
    done = ended(code, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "ended\n", "")


def test_patient_code_does_not_raise_within_an_import(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text("from __main__ import send, time\nsend()\ntime.sleep(60)\n")
    done = ended("with interrupts.patient():\n" + indent(SWALLOW.format("import slow"), "    "), tmp_path)
    assert (done.returncode, done.stderr) == (130, INTERRUPTED + "\n")


def test_after_the_answer_a_signal_changes_nothing(tmp_path: Path) -> None:
    done = ended("interrupts.finished(); send(); send(signal.SIGTERM); print('{}')", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "{}\n", "")


@pytest.fixture
def interruptible() -> Iterator[None]:
    """SIGINT has Python's own handler; the background jobs of a shell are started with it ignored."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


@pytest.mark.usefixtures("interruptible")
def test_patient_code_gives_the_handlers_back() -> None:
    before = [signal.getsignal(number) for number in interrupts.SIGNALS]
    with pytest.raises(KeyboardInterrupt), interrupts.patient():
        signal.raise_signal(signal.SIGINT)
    assert interrupts.swallowed()
    assert [signal.getsignal(number) for number in interrupts.SIGNALS] == before
    with interrupts.patient():
        assert not interrupts.swallowed()


GOOD = study.Ended(code=0, out='{"status": "answer"}', err="", seconds=1.0)
ERROR = json.dumps({"status": "error", "reason": INTERRUPTED})


@pytest.mark.parametrize(
    ("code", "out", "err", "result"),
    [
        (130, ERROR, INTERRUPTED + "\n", "interrupted"),
        (130, GOOD.out, "compiling ...\n" + INTERRUPTED + "\n", "interrupted"),
        (0, GOOD.out, "", "finished"),
        (-signal.SIGINT, "", "", "start"),
        (1, "", 'File "site.py"\nTraceback\nKeyboardInterrupt\n', "start"),
        (130, ERROR, "", "not one line"),
        (130, ERROR, 2 * (INTERRUPTED + "\n"), "not one line"),
        (130, "", INTERRUPTED + "\n", "no JSON document"),
        (130, GOOD.out + ERROR, INTERRUPTED + "\n", "not one JSON document"),
        (0, ERROR, "", "exit code 0"),
        (-signal.SIGABRT, "", "", "exit code -6"),
        (130, ERROR, f"Exception ignored in f\n{INTERRUPTED}\n", "traceback"),
    ],
)
def test_the_study_of_signals_judges_strictly(code: int, out: str, err: str, result: str) -> None:
    said = study.judge(study.Ended(code=code, out=out, err=err, seconds=1.0), GOOD)
    assert said.startswith(result) or (result.startswith("not one JSON") and result in said)


@pytest.mark.slow
def test_a_short_command_is_interrupted_at_random_moments() -> None:
    report = study.study(4, 1, names=("list",), processes=1)
    assert report["moments"] == report["good"] + report["python_start"] == 4
    assert not report["faults"]
