"""Where the shared key of the reference link comes from: a file or a variable that the configuration names.

The key itself never stands in the configuration, and no error or log shows it.
"""

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from protocol.authentication import MIN_SECRET_BYTES, LinkKey
from protocol.errors import ConfigurationError

_MAX_FILE_BYTES = 4096
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class KeySource(StrictModel):
    """Names the file or the environment variable that holds the key, in hexadecimal; neither: no key.

    ``file``: a path; only its owner may have access to it.
    """

    file: Path | None = None
    environment: str | None = Field(None, pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,62}$")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.file is not None and self.environment is not None:
            raise ValueError("a file and an environment variable: name one of them")
        return self


def read_key(source: KeySource, environment: Mapping[str, str] | None = None) -> LinkKey | None:
    """The key that ``source`` names; None when it names none.

    ``environment``: the process's own by default. Raises ConfigurationError: ``configuration.key_missing``,
    ``key_unreadable``, ``key_exposed`` (others than the owner may read or write the file), ``key_not_hex``,
    ``key_too_short``.
    """
    if source.environment is not None:
        text = (os.environ if environment is None else environment).get(source.environment)
        if text is None:
            why = f"environment variable {source.environment} is not set"
            raise ConfigurationError("configuration.key_missing", f"link key: {why}")
        return key_from_text(text, source.environment)
    return None if source.file is None else key_from_file(source.file)


def key_from_file(path: Path) -> LinkKey:
    """The key in a file of hexadecimal digits. Raises as ``read_key`` does."""
    where = f"link key: {path}"
    try:
        # The mode of what was opened, not of what stood there a moment before.
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(_MAX_FILE_BYTES)
    except FileNotFoundError as error:
        raise ConfigurationError("configuration.key_missing", f"{where}: no such file") from error
    except OSError as error:
        raise ConfigurationError("configuration.key_unreadable", f"{where}: {error.strerror}") from error
    if not stat.S_ISREG(mode):
        raise ConfigurationError("configuration.key_unreadable", f"{where}: not a regular file")
    if mode & _OTHERS:
        why = f"mode {stat.S_IMODE(mode):04o} lets others in: chmod 600"
        raise ConfigurationError("configuration.key_exposed", f"{where}: {why}")
    return key_from_text(text.decode("ascii", "replace"), str(path))


def key_from_text(text: str, where: str) -> LinkKey:
    """The key of hexadecimal digits, blanks around them ignored; ``where`` names its origin in an error."""
    try:
        secret = bytes.fromhex(text.strip())
    except ValueError:
        # Not chained: the message of the error behind it may quote a part of the key.
        why = "not hexadecimal digits, two a byte"
        raise ConfigurationError("configuration.key_not_hex", f"link key: {where}: {why}") from None
    if len(secret) < MIN_SECRET_BYTES:
        why = f"{len(secret)} bytes: wanted at least {MIN_SECRET_BYTES}, as openssl rand -hex 32 gives"
        raise ConfigurationError("configuration.key_too_short", f"link key: {where}: {why}")
    return LinkKey(secret)
