"""A dataset's folder: what was asked for, which shards stand, and one run at a time."""

from __future__ import annotations

import glob
import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from ..exceptions import EnvironmentFailure, InputError
from ..files import locked, write_bytes, write_json
from ..hands.load import load_hand
from ..tasks import parse_task
from .making import Made, versions
from .schema import FORMAT, facts_of
from .settings import DatasetSettings, Shard, hand_digest, task_label

_SHOWN = 4
"""Differences named in an error."""


def manifest(shards: Sequence[Shard], settings: DatasetSettings) -> dict[str, Any]:
    """The content of ``dataset.json``: plain JSON values.

    Args:
        shards: all of the dataset.
        settings: its.
    """
    hands = {shard.hand: load_hand(shard.hand) for shard in shards}
    tasks = {shard.task: parse_task(shard.task) for shard in shards}
    return {
        "format": FORMAT,
        "versions": versions(),
        "settings": settings.to_json(),
        "objects": {f"{s.object_name}@{s.scale:g}": s.mesh for s in shards},
        "hands": {
            hand.name: {"joints": list(hand.joints), "digest": hand_digest(text)}
            for text, hand in hands.items()
        },
        "tasks": {task_label(task): task.q.tolist() for task in tasks.values()},
        "shards": [
            {
                "name": s.name,
                "object": s.object_name,
                "scale": s.scale,
                "hand": hands[s.hand].name,
                "task": task_label(tasks[s.task]),
                "part": s.part,
                "asked": s.count,
                "seed": s.seed,
            }
            for s in shards
        ],
    }


class Folder:
    """The folder of one dataset, held by this process until it is left.

    Args:
        path: the folder; made where it is missing.
        document: of :func:`manifest`.

    Raises:
        InputError: another run is at work in it, or it holds another dataset.
        EnvironmentFailure: it cannot be read or written.
    """

    def __init__(self, path: Path, document: dict[str, Any]) -> None:
        self.path, self.shards = path, path / "shards"
        self.names = [shard["name"] for shard in document["shards"]]
        if (path / "dataset.json").exists():
            self._compare(_read(path / "dataset.json"), document)
        try:
            self.shards.mkdir(parents=True, exist_ok=True)
            self._log: IO[bytes] = (path / "log.jsonl").open("ab")
        except OSError as error:
            raise EnvironmentFailure(
                f"cannot write {path}: {error.strerror}; choose another folder"
            ) from error
        try:
            # The lock comes first: what looks like a leftover may be another run's work.
            if not locked(self._log):
                raise InputError(f"another run is writing {path}; wait for it, or choose another folder")
            self._begin(document)
        except OSError as error:
            self._log.close()
            raise EnvironmentFailure(f"cannot use {path}: {error.strerror or error}") from error
        except BaseException:
            self._log.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._log.close()

    def file(self, name: str) -> Path:
        """Where a shard stands."""
        return self.shards / f"{name}.parquet"

    def facts(self, name: str) -> dict[str, Any] | None:
        """The facts of a shard that stands and is whole; ``None`` of any other.

        Raises:
            EnvironmentFailure: the file cannot be read.
        """
        try:
            content = self.file(name).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise EnvironmentFailure(f"cannot read {self.file(name)}: {error.strerror}") from error
        facts = facts_of(content)
        return facts if facts is not None and facts["shard"] == name else None

    def keep(self, made: Made) -> None:
        """Write a shard; it is on the disk, whole, when this returns.

        Raises:
            EnvironmentFailure: it cannot be written.
        """
        write_bytes(self.file(made.name), made.content)
        line = {"shard": made.name, "rows": made.facts["rows"], "host": made.host, "process": made.process}
        line["seconds"] = {name: round(spent, 4) for name, spent in made.seconds.items()}
        try:
            self._log.write(json.dumps(line).encode() + b"\n")
            self._log.flush()
        except OSError as error:
            raise EnvironmentFailure(f"cannot write {self._log.name}: {error.strerror}") from error

    def _begin(self, document: dict[str, Any]) -> None:
        there = {p.stem for p in self.shards.glob("*.parquet") if not p.name.startswith(".")}
        strange = sorted(there - set(self.names))
        file = self.path / "dataset.json"
        if file.exists():
            self._compare(_read(file), document)
        elif strange:
            raise InputError(f"{self.shards} holds Parquet of something else; choose another folder")
        else:
            write_json(file, document)
        if strange:
            raise InputError(
                f"{self.shards}/{strange[0]}.parquet is no shard of this dataset; move it elsewhere"
            )
        for name in self.names:  # of a run that was killed while it wrote
            for leftover in self.shards.glob(f".{glob.escape(name)}-*.parquet"):
                leftover.unlink()

    def _compare(self, there: dict[str, Any], here: dict[str, Any]) -> None:
        found = differences(there, here)
        if not found:
            return
        more = f", and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
        raise InputError(
            f"{self.path} holds a dataset made otherwise: {'; '.join(found[:_SHOWN])}{more}; "
            "go on with what it was begun with, or choose another folder"
        )


def _read(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["format"] == FORMAT:
            parts = ("versions", "settings", "objects", "hands", "tasks")
            if all(isinstance(document[part], dict) for part in parts) and document["shards"]:
                return dict(document)
    except (ValueError, KeyError, TypeError):
        pass
    raise InputError(f"{file} is not the list of a dataset of this version; choose another folder")


def differences(there: dict[str, Any], here: dict[str, Any]) -> list[str]:
    """What two manifests differ in, one phrase each; empty where they are the same dataset."""
    found = []
    for part, of in (("settings", ""), ("versions", "version of ")):
        for name in {**there[part], **here[part]}:
            a, b = there[part].get(name), here[part].get(name)
            if a != b:
                found.append(f"{of}{name} was {json.dumps(a)}, now {json.dumps(b)}")
    for part, noun in (("objects", "object"), ("hands", "hand"), ("tasks", "task")):
        a, b = there[part], here[part]
        found += [f"{noun} {name} is new" for name in b if name not in a]
        found += [f"{noun} {name} is missing" for name in a if name not in b]
        found += [f"{noun} {name} is not what it was" for name in a if name in b and a[name] != b[name]]
    if not found and there["shards"] != here["shards"]:
        found.append("its shards are listed otherwise")
    return found
