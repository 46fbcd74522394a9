"""A folder that one run at a time writes into.

Every run has a claim of its own in the folder, a hidden file that names its process; it then looks for those of others.
So runs that begin at the same time see each other, and the claim of a process that has ended keeps nobody out.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from uuid import uuid4

from mien.errors import MienError
from mien.files import whole_file

_PREFIX, _SUFFIX = ".mien-batch-", ".lock"


@dataclass(frozen=True)
class _Holder:
    """The process of a claim, its number and machine; identity: see `_identity`."""

    process: int
    machine: str
    identity: str


@contextmanager
def sole_use(folder: Path) -> Iterator[None]:
    """Claim a folder, which is created if needed, for this block.

    Raises MienError naming the folder and the process if another run has claimed it.
    """
    own = folder / f"{_PREFIX}{uuid4().hex}{_SUFFIX}"
    holder = _Holder(os.getpid(), platform.node(), _identity(os.getpid()) or "")
    with whole_file(own) as file:
        file.write_text(json.dumps(asdict(holder)), encoding="utf-8")
    try:
        with own.open():  # on Windows nobody can delete it meanwhile
            _require_unclaimed(folder, own)
            yield
    finally:
        own.unlink(missing_ok=True)


def _require_unclaimed(folder: Path, own: Path) -> None:
    """Raise MienError if a process that still runs has claimed the folder; claims of others are removed."""
    for claim in folder.glob(f"{_PREFIX}*{_SUFFIX}"):
        holder = None if claim == own else _holder(claim)
        if holder is None:
            continue
        if _has_ended(claim, holder):
            with suppress(OSError):  # of another user
                claim.unlink(missing_ok=True)
            continue
        raise MienError(
            f"{folder} is in use by another mien batch, process {holder.process} on {holder.machine}; wait until that "
            f"has ended, or choose another folder with -o (if there is no such process any more, delete {claim})"
        )


def _holder(claim: Path) -> _Holder | None:
    """Who has made a claim; None if it is gone, or damaged."""
    with suppress(FileNotFoundError, ValueError, TypeError):
        return _Holder(**json.loads(claim.read_text(encoding="utf-8")))
    return None


def _has_ended(claim: Path, holder: _Holder) -> bool:
    """Whether the process of a claim has ended, as far as can be told: not for another machine, unless it is Windows,
    where what is open cannot be deleted."""
    if os.name == "nt":
        try:
            claim.unlink(missing_ok=True)
        except PermissionError:
            return False
        return True
    if holder.machine != platform.node():
        return False
    identity = _identity(holder.process)
    return identity is None or (bool(identity and holder.identity) and identity != holder.identity)


def _identity(process: int) -> str | None:
    """What tells a process from a later one of the same number: when it began, and since which start of the system; ""
    where the system does not say, None if there is no such process."""
    if os.name == "nt":  # where the signal 0 is not a question, but Ctrl-C
        return ""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return None
    except PermissionError:  # it is of another user
        pass
    try:
        state, *fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        system = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
    return None if state == "Z" else f"{system} {fields[18]}"
