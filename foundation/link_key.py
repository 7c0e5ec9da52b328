"""The shared key of the reference link, from where the configuration says it is."""

from collections.abc import Mapping
from pathlib import Path

from foundation.secret_source import SecretSource, read_secret, secret_from_file
from protocol.authentication import LinkKey

_WHAT = "link key"


def read_key(source: SecretSource, environment: Mapping[str, str] | None = None) -> LinkKey | None:
    """The key that ``source`` names; None when it names none. Raises as ``read_secret`` does."""
    secret = read_secret(source, _WHAT, environment)
    return None if secret is None else LinkKey(secret)


def key_from_file(path: Path) -> LinkKey:
    """The key in a file of hexadecimal digits. Raises ConfigurationError as ``read_secret`` does."""
    return LinkKey(secret_from_file(path, _WHAT))
