"""The one error and the one warning that mien raises for its users."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_noted: ContextVar[dict[str, None] | None] = ContextVar("_noted", default=None)
"""What was warned of since `warnings_noted`, in this thread; None where nobody asks."""


class MienError(ValueError):
    """Bad input: the message names the file or value and the remedy."""


class MienWarning(UserWarning):
    """Something was corrected or skipped: the message names the file or value and what was done."""


def warn(message: str) -> None:
    """Issue a `MienWarning`, which names the line that has called mien; the command line prints it as one sentence."""
    noted = _noted.get()
    if noted is not None:
        noted[message] = None
    warnings.warn(message, MienWarning, stacklevel=_depth_of_mien() + 1)


def _depth_of_mien() -> int:
    """How many calls lie within mien, and within the `contextlib` that decorates some of its functions, from the caller
    of this on."""
    depth, frame = 0, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in ("mien", "contextlib"):
        depth, frame = depth + 1, frame.f_back
    return depth


@contextmanager
def warnings_noted() -> Iterator[None]:
    """Note what is warned of in the block, or in a function that is decorated with this, for `noted_warnings`."""
    before = _noted.set({})
    try:
        yield
    finally:
        _noted.reset(before)


def noted_warnings() -> list[str]:
    """What was warned of so far, each sentence once; see `warnings_noted`."""
    return list(_noted.get() or ())


def interruption(error: BaseException) -> BaseException:
    """The KeyboardInterrupt in the `__cause__` chain of an error, else the error itself.

    A compiled function that is interrupted raises a SystemError caused by the KeyboardInterrupt, and up to Python 3.11
    an import a RuntimeError.
    """
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    return error if cause is None else cause


def require(condition: bool, message: str) -> None:
    """Raise `MienError(message)` unless the condition holds."""
    if not condition:
        raise MienError(message)
