"""Where a server's socket file is, and whom it answers: found by the command line within milliseconds.

A server answers commands of its own user, of the same installation, with the same memory and with the same
settings in the environment. The name of the file is made from these, and the whole text is compared again.
"""

from __future__ import annotations

import os
import stat
import sys
import zlib

from .._version import __version__

SWITCH = "PRESHAPE_SERVE"
"""Environment variable that keeps the command line from asking a server, by ``off``."""
_SETTINGS = ("HOME", "WARP_CACHE_PATH", "CUDA_VISIBLE_DEVICES", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME")
_APART = (SWITCH, "PRESHAPE_MEMORY")


def server_key(memory: str) -> str:
    """What command line and server must have in common.

    Args:
        memory: Path of the memory's file.
    """
    names = [name for name in os.environ if name.startswith("PRESHAPE_") and name not in _APART]
    settings = [f"{name}={os.environ.get(name, '')}" for name in sorted([*_SETTINGS, *names])]
    memory = os.path.realpath(os.path.expanduser(memory))
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    return "\n".join([__version__, sys.version, package, memory, *settings])


def socket_path(key: str, *, make: bool = False) -> str | None:
    """Path of the socket file of a key; ``None`` where no folder belongs to this user alone.

    Args:
        key: See :func:`server_key`.
        make: Whether to make the folder if it is missing.
    """
    if not hasattr(os, "getuid"):
        return None
    user, base = os.getuid(), os.environ.get("XDG_RUNTIME_DIR", "")
    if base and os.path.isdir(base):
        folder = os.path.join(base, "preshape")
    else:
        folder = os.path.join(os.environ.get("TMPDIR") or "/tmp", f"preshape-run-{user}")
    try:
        if make:
            os.makedirs(folder, mode=0o700, exist_ok=True)
        found = os.lstat(folder)
    except OSError:
        return None
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & 0o077:
        return None
    return os.path.join(folder, f"serve-{zlib.crc32(key.encode('utf-8', 'surrogateescape')):08x}.sock")


def own_socket(path: str) -> bool:
    """Whether a socket is there that only this user can open."""
    try:
        found = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISSOCK(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
