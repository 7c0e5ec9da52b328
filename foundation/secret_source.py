"""What settings name outside their file: secrets of files or the environment, and addresses to listen at."""

import errno
import os
import secrets
import socket
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from foundation.configuration import StrictModel
from protocol.authentication import MIN_SECRET_BYTES, LinkKey
from protocol.errors import ConfigurationError


def bound_tcp(host: str, port: int, key: str) -> socket.socket:
    """A TCP socket bound to an address, not yet listening; ``key`` names the setting.

    Raises ConfigurationError when the port is busy, or the address is not ours.
    """
    return _bind_socket(socket.SOCK_STREAM, host, port, key)


def bound_udp(host: str, port: int, key: str) -> socket.socket:
    """A UDP socket that does not block, bound to an address. Raises ConfigurationError as ``bound_tcp``."""
    sock = _bind_socket(socket.SOCK_DGRAM, host, port, key)
    sock.setblocking(False)
    return sock


def _bind_socket(kind: socket.SocketKind, host: str, port: int, key: str) -> socket.socket:
    sock = socket.socket(socket.AF_INET, kind)
    try:
        if kind is socket.SOCK_STREAM:  # what is left of closed connections holds a port for a minute
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        cause = "configuration.port_busy" if error.errno == errno.EADDRINUSE else "configuration.bad_address"
        v6 = isinstance(error, socket.gaierror) and ":" in host
        why = "an address of IPv4, or a name that has one, is wanted" if v6 else error.strerror
        raise ConfigurationError(cause, f"{key} = {host}:{port}: {why}") from error
    return sock


def known_host(host: str) -> str:
    """``host``, which has an address. Raises ConfigurationError when it has none."""
    try:
        socket.getaddrinfo(host, None)
    except OSError as error:
        raise ConfigurationError("configuration.unknown_host", f"host '{host}': {error.strerror}") from error
    return host


_MAX_FILE_BYTES = 4096
_LINK_KEY = "link key"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class SecretSource(StrictModel):
    """Names the file or the environment variable that holds a secret, in hexadecimal; neither: none.

    ``file``: a path; only its owner may have access to it.
    """

    file: Path | None = None
    environment: str | None = Field(None, pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,62}$")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if self.file is not None and self.environment is not None:
            raise ValueError("a file and an environment variable: name one of them")
        return self

    @property
    def named(self) -> bool:
        """Whether there is to be a secret."""
        return self.file is not None or self.environment is not None


def read_secret(
    source: SecretSource, what: str, environment: Mapping[str, str] | None = None
) -> bytes | None:
    """The secret that ``source`` names, at least 32 bytes; None when it names none.

    ``what``: such as "link key"; its last word stands in the causes. ``environment``: the process's own by
    default. Raises ConfigurationError: ``configuration.key_missing``, ``key_unreadable``, ``key_exposed``
    (others than the owner may read or write the file), ``key_not_hex``, ``key_too_short``.
    """
    if source.environment is not None:
        text = (os.environ if environment is None else environment).get(source.environment)
        if text is None:
            raise _error(what, "missing", f"environment variable {source.environment} is not set")
        return secret_from_text(text, source.environment, what)
    return None if source.file is None else secret_from_file(source.file, what)


def secret_from_file(path: Path, what: str) -> bytes:
    """The secret in a file of hexadecimal digits. Raises as ``read_secret`` does."""
    try:
        # The mode of what was opened, not of what stood there a moment before.
        with path.open("rb") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(_MAX_FILE_BYTES)
    except FileNotFoundError as error:
        raise _error(what, "missing", f"{path}: no such file") from error
    except OSError as error:
        raise _error(what, "unreadable", f"{path}: {error.strerror}") from error
    if not stat.S_ISREG(mode):
        raise _error(what, "unreadable", f"{path}: not a regular file")
    if mode & _OTHERS:
        why = (
            f"mode {stat.S_IMODE(mode):04o} lets others in: chmod 600; where a container mounts it: mode "
            "0400 and uid of the secret (Compose), defaultMode 0400 (Kubernetes), or an environment variable"
        )
        raise _error(what, "exposed", f"{path}: {why}")
    return secret_from_text(text.decode("ascii", "replace"), str(path), what)


def secret_from_text(text: str, where: str, what: str) -> bytes:
    """The secret of hexadecimal digits, blanks around them ignored; ``where`` names its origin."""
    try:
        secret = bytes.fromhex(text.strip())
    except ValueError:
        # Not chained: the message of the error behind it may quote a part of the secret.
        raise _error(what, "not_hex", f"{where}: not hexadecimal digits, two a byte") from None
    if len(secret) < MIN_SECRET_BYTES:
        why = f"{len(secret)} bytes: wanted at least {MIN_SECRET_BYTES}, as openssl rand -hex 32 gives"
        raise _error(what, "too_short", f"{where}: {why}")
    return secret


def write_new_secret(path: Path) -> None:
    """Make a file of 32 random bytes in hexadecimal that only its owner may read.

    Raises ConfigurationError when there is a file already (``configuration.secret_exists``), or it cannot be
    written.
    """
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise ConfigurationError("configuration.secret_exists", f"{path}: is there already") from error
    except OSError as error:
        why = f"{path}: {error.strerror}"
        raise ConfigurationError("configuration.secret_unwritable", why) from error
    with os.fdopen(handle, "w", encoding="ascii") as file:
        file.write(secrets.token_hex(MIN_SECRET_BYTES) + "\n")


def _error(what: str, fault: str, why: str) -> ConfigurationError:
    return ConfigurationError(f"configuration.{what.rpartition(' ')[2]}_{fault}", f"{what}: {why}")


def read_key(source: SecretSource, environment: Mapping[str, str] | None = None) -> LinkKey | None:
    """The reference link's shared key that ``source`` names; None when it names none.

    Raises as ``read_secret`` does.
    """
    secret = read_secret(source, _LINK_KEY, environment)
    return None if secret is None else LinkKey(secret)


def key_from_file(path: Path) -> LinkKey:
    """The key in a file of hexadecimal digits. Raises ConfigurationError as ``read_secret`` does."""
    return LinkKey(secret_from_file(path, _LINK_KEY))
