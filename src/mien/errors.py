"""The one error, and the one warning, that a user of mien is meant to see."""

import warnings


class MienError(ValueError):
    """Bad input: the message names the file or value and the remedy."""


class MienWarning(UserWarning):
    """Something was put right or left out: the message names the file or value and what was done."""


def warn(message: str) -> None:
    """Issue a `MienWarning`; the command line prints it as one sentence."""
    warnings.warn(message, MienWarning, stacklevel=3)


def interruption(error: BaseException) -> BaseException:
    """The KeyboardInterrupt that an error comes from, as the SystemErrors of a compiled function that was stopped
    within do; else the error."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    return error if cause is None else cause


def require(condition: bool, message: str) -> None:
    """Raise `MienError(message)` unless the condition holds."""
    if not condition:
        raise MienError(message)
