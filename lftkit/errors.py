"""The exception of invalid input."""

from __future__ import annotations

import os


class InputError(ValueError):
    """Invalid input: an argument, an option, a file or its content; the message is one line for its user.

    All packages raise it for what a caller or a user can change: any other ValueError is a fault of the program. The
    message says what was expected and what came, with file, line or key where there is one.
    """

    def __init__(self, *parts: object) -> None:  # what came may be a text of several lines
        super().__init__(*(" ".join(map(str.strip, p.splitlines())) if isinstance(p, str) else p for p in parts))

    @classmethod
    def of_file(cls, path: str | os.PathLike[str], error: Exception) -> InputError:
        """The same message with the file named, once.

        Examples
        --------
        >>> for text in ("a.mat: arrays must be numbers", "arrays must be numbers"):
        ...     print(InputError.of_file("a.mat", ValueError(text)))
        a.mat: arrays must be numbers
        a.mat: arrays must be numbers
        >>> print(InputError.of_file("array", ValueError("arrays must be numbers")))
        array: arrays must be numbers
        """
        name, text = os.fspath(path), str(error)
        named = text.startswith((f"{name}:", f"{name},", f"{name} "))
        return cls(text if named else f"{name}: {text}")
