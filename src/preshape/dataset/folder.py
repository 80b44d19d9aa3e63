"""The folder of a dataset: the list of all shards, the finished shards, and a lock against a second run."""

from __future__ import annotations

import glob
import json
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from ..exceptions import EnvironmentFailure, InputError
from ..files import loads, locked, write_bytes, write_json
from ..hands.load import load_hand
from ..tasks import parse_task
from ..types import LENGTH_UNIT
from .making import MadeShard, versions
from .schema import FORMAT, facts_of
from .settings import DatasetSettings, Shard, hand_digest, task_label

_MAX_DIFFERENCES = 4
"""Number of differences named in an error message."""


def manifest(shards: Sequence[Shard], settings: DatasetSettings) -> dict[str, Any]:
    """The content of ``dataset.json`` as plain JSON values.

    Args:
        shards: All shards of the dataset.
        settings: Settings of the dataset.
    """
    hands = {shard.hand: load_hand(shard.hand) for shard in shards}
    tasks = {shard.task: parse_task(shard.task) for shard in shards}
    return {
        "format": FORMAT,
        "versions": versions(),
        "settings": settings.to_json(),
        "objects": {f"{s.object_name}@{s.scale:g}": s.mesh for s in shards},
        "hands": {
            hand.name: {
                "joints": list(hand.joints),
                "digest": hand_digest(text),
                "length_unit": LENGTH_UNIT * hand.u,
            }
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


class DatasetFolder:
    """The folder of one dataset, locked for this process while the context is open.

    Args:
        path: The folder; created if it is missing.
        document: The content of ``dataset.json``, from :func:`manifest`.

    Raises:
        InputError: Another run uses the folder, or the folder contains another dataset.
        EnvironmentFailure: The folder cannot be read or written.
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
            # Lock first: a temporary file may belong to a run that is still active.
            if not locked(self._log):
                raise InputError(f"another run is writing {path}; wait for it, or choose another folder")
            self._prepare(document)
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
        """Path of a shard's file."""
        return self.shards / f"{name}.parquet"

    def facts(self, name: str) -> dict[str, Any] | None:
        """The facts of a finished shard; ``None`` if its file is missing or damaged.

        Raises:
            EnvironmentFailure: The file cannot be read.
        """
        try:
            content = self.file(name).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise EnvironmentFailure(f"cannot read {self.file(name)}: {error.strerror}") from error
        facts = facts_of(content)
        return facts if facts is not None and facts["shard"] == name else None

    def store(self, made: MadeShard) -> None:
        """Write a shard; on return, its complete file is on the disk.

        Raises:
            EnvironmentFailure: The file cannot be written.
        """
        write_bytes(self.file(made.name), made.content)
        line = {"shard": made.name, "rows": made.facts["rows"], "host": made.host, "process": made.process}
        line["seconds"] = {name: round(spent, 4) for name, spent in made.seconds.items()}
        try:
            self._log.write(json.dumps(line).encode() + b"\n")
            self._log.flush()
        except OSError as error:
            raise EnvironmentFailure(f"cannot write {self._log.name}: {error.strerror}") from error

    def _prepare(self, document: dict[str, Any]) -> None:
        """Compare or write ``dataset.json``, refuse foreign files, and remove temporary files."""
        stems = {p.stem for p in self.shards.glob("*.parquet") if not p.name.startswith(".")}
        foreign = sorted(stems - set(self.names))
        file = self.path / "dataset.json"
        if file.exists():
            self._compare(_read(file), document)
        elif foreign:
            raise InputError(f"{self.shards} holds Parquet files of something else; choose another folder")
        else:
            write_json(file, document)
        if foreign:
            raise InputError(
                f"{self.shards}/{foreign[0]}.parquet is not a shard of this dataset; move it elsewhere"
            )
        for name in self.names:  # temporary files of a run that was killed while it wrote
            for leftover in self.shards.glob(f".{glob.escape(name)}-*.parquet"):
                leftover.unlink()

    def _compare(self, stored: dict[str, Any], wanted: dict[str, Any]) -> None:
        found = differences(stored, wanted)
        if not found:
            return
        more = f", and {len(found) - _MAX_DIFFERENCES} more" if len(found) > _MAX_DIFFERENCES else ""
        raise InputError(
            f"{self.path} holds a different dataset: {'; '.join(found[:_MAX_DIFFERENCES])}{more}; "
            "use the settings and versions that it was started with, or choose another folder"
        )


def _read(file: Path) -> dict[str, Any]:
    try:
        document = loads(file.read_text(encoding="utf-8"))
        if document["format"] == FORMAT:
            parts = ("versions", "settings", "objects", "hands", "tasks")
            if all(isinstance(document[part], dict) for part in parts) and document["shards"]:
                return dict(document)
    except (ValueError, KeyError, TypeError):
        pass
    raise InputError(f"{file} is not the list of a dataset in the format {FORMAT!r}; choose another folder")


def differences(stored: dict[str, Any], wanted: dict[str, Any]) -> list[str]:
    """One phrase for each difference of two manifests; empty if both describe the same dataset."""
    found = []
    for part, prefix in (("settings", ""), ("versions", "version of ")):
        for name in {**stored[part], **wanted[part]}:
            a, b = stored[part].get(name), wanted[part].get(name)
            if a != b:
                found.append(f"{prefix}{name} was {json.dumps(a)}, now {json.dumps(b)}")
    for part, noun in (("objects", "object"), ("hands", "hand"), ("tasks", "task")):
        a, b = stored[part], wanted[part]
        found += [f"{noun} {name} is new" for name in b if name not in a]
        found += [f"{noun} {name} is missing" for name in a if name not in b]
        found += [f"{noun} {name} has changed" for name in a if name in b and a[name] != b[name]]
    if not found and stored["shards"] != wanted["shards"]:
        found.append("the list of shards differs")
    return found
