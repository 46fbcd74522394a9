"""The one error a user of mien is meant to see."""


class MienError(ValueError):
    """Bad input: the message names the file or value and the remedy."""


def require(condition: bool, message: str) -> None:
    """Raise `MienError(message)` unless the condition holds."""
    if not condition:
        raise MienError(message)
