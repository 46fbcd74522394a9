"""Files: written so that they appear complete or not at all, checked before, named in errors, and told apart."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mien.errors import MienError, require

REMEDY = "make room or choose another place"
_NUMBERS = re.compile(r"\[\n\s*([-+.\deE]+(?:,\n\s*[-+.\deE]+)*)\n\s*\]")
"""A list of numbers in indented JSON, whose strings hold no line break."""


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Temporary file beside `path`, renamed to `path` when the block succeeds, removed when it fails."""
    with named_errors(path):
        beside = create_temporary(path)
        try:
            yield beside
            move_into_place(beside, path)
        finally:
            beside.unlink(missing_ok=True)


def move_into_place(beside: Path, path: Path) -> None:
    """Rename a finished temporary file to `path`, or to what that links to, with the default permissions of a new
    file."""
    beside.chmod(0o666 & ~_umask())
    beside.replace(real_path(path))


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Turn an OSError raised while writing `path` (disk full, no permission) into a MienError."""
    try:
        yield
    except OSError as error:
        raise MienError(f"{path} cannot be written ({reason_of(error)}); {REMEDY}") from error


def reason_of(error: OSError) -> str:
    """Why the system refused something, as a part of a sentence."""
    return (error.strerror or str(error)).lower()


def create_temporary(path: Path) -> Path:
    """New, empty, hidden file with the suffix of `path`, in the folder of what that links to, so that a rename stays on
    one disk. The folder is created if needed."""
    folder, stem = real_path(path).parent, path.stem[:40]  # a longer name could exceed what the file system allows
    folder.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{stem}-", suffix=path.suffix, dir=folder)
    os.close(handle)
    return Path(name)


def require_writable(path: Path) -> None:
    """Create the folder of `path`; raise MienError if a file cannot be written there, or would replace what is none."""
    try:
        create_temporary(path).unlink()
        with suppress(FileNotFoundError):
            path.lstat()  # fails for a longer name than the file system allows, which that of a temporary file is not
    except OSError as error:
        what = "a shorter name" if error.errno == errno.ENAMETOOLONG else "another place"
        raise MienError(f"{path} cannot be written ({reason_of(error)}); choose {what}") from error
    require(not path.is_dir(), f"{path} is a folder; give the name of a file")
    require(path.is_file() or not exists(path), f"{path} is a pipe or a device; give the name of a file")


def require_ending(path: Path, endings: tuple[str, ...]) -> Path:
    """The path, if its suffix is one of `endings`. Raises MienError otherwise."""
    wanted = " or ".join(endings)
    require(path.suffix.lower() in endings, f"{path}: mien writes {wanted} here; choose a name with that ending")
    return path


def json_text(values: Mapping[str, Any]) -> str:
    """JSON that is easy to read and edit by hand: indented, each list of numbers on one line. Raises MienError for NaN,
    and for values that JSON does not know."""
    try:
        text = json.dumps(dict(values), indent=1, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise MienError(
            f"the values cannot be written as JSON ({error}); give text, finite numbers of Python, and lists and "
            "dictionaries of these"
        ) from error
    return _NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text) + "\n"


def user_path(path: str | Path) -> Path:
    """The path of a file that a user names, with `~` for the home folder, as in a shell. Raises MienError if it is no
    path."""
    require(isinstance(path, (str, os.PathLike)), f"{path!r} is no path of a file; give text or a pathlib.Path")
    return Path(os.path.expanduser(path))


def real_path(path: Path) -> Path:
    """The path with symbolic links resolved as far as they lead; `Path.resolve` fails where they lead in a circle."""
    return Path(os.path.realpath(path))


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; `Path.exists` fails for a longer name than the file system allows."""
    return os.path.exists(path)


def checksum(path: Path) -> str:
    """SHA-256, in hexadecimal, of a file, or of the names and contents of the files in a folder."""
    digest = hashlib.sha256()
    for file in [path] if path.is_file() else sorted(p for p in path.iterdir() if p.is_file()):
        if file != path:
            digest.update(os.fsencode(file.name))
        with file.open("rb") as f:
            while chunk := f.read(1 << 20):
                digest.update(chunk)
    return digest.hexdigest()


def size_of(path: Path) -> int | None:
    """Size of a file in bytes; None for a folder."""
    return path.stat().st_size if path.is_file() else None


def printable(text: str) -> str:
    """A text without what is not valid UTF-8, as bytes in the names of files: these are replaced by their escapes."""
    return text.encode(errors="backslashreplace").decode()


def _umask() -> int:
    """The process's umask, which `mkstemp` ignores. It can only be read by setting another, a strict one, as other
    threads may create files meanwhile."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
