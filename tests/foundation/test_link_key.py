"""The shared key: read from where the configuration says, refused with a cause, shown nowhere."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from controller.config import ReferenceLinkConfig
from foundation.configuration import validated
from foundation.secret_source import SecretSource, read_key
from protocol.authentication import LinkKey
from protocol.errors import ConfigurationError

HEX = "00112233445566778899aabbccddeeff" * 2


def key_file(path: Path, text: str = HEX + "\n", mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def cause_of(source: SecretSource, **environment: str) -> tuple[str, str]:
    with pytest.raises(ConfigurationError) as caught:
        read_key(source, environment)
    return caught.value.cause, str(caught.value)


def test_no_source_is_no_key() -> None:
    assert read_key(SecretSource()) is None


def test_file_and_environment_give_the_same_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from_file = read_key(SecretSource(file=key_file(tmp_path / "key")))
    monkeypatch.setenv("LINK_KEY", f" {HEX.upper()}\n")
    from_environment = read_key(SecretSource(environment="LINK_KEY"))
    assert from_file is not None
    assert from_environment is not None
    assert from_file.key_id == from_environment.key_id != LinkKey(b"\xff" * 32).key_id
    tags = [key.of_client(1, 2, 3).sends.tag(bytes(64)) for key in (from_file, from_environment)]
    assert tags[0] == tags[1]


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o602, 0o610])
def test_a_file_that_others_may_touch_is_refused(tmp_path: Path, mode: int) -> None:
    cause, why = cause_of(SecretSource(file=key_file(tmp_path / "key", mode=mode)))
    assert cause == "configuration.key_exposed"
    assert f"{mode:04o}" in why
    assert "key" in why


def test_what_is_no_key_is_refused_and_not_shown(tmp_path: Path) -> None:
    almost = HEX[:-1] + "x"
    cause, why = cause_of(SecretSource(file=key_file(tmp_path / "key", almost)))
    assert cause == "configuration.key_not_hex"
    assert HEX[:8] not in why
    cause, why = cause_of(SecretSource(environment="K"), K=HEX[:62])
    assert cause == "configuration.key_too_short"
    assert "31 bytes" in why
    assert HEX[:8] not in why
    assert cause_of(SecretSource(file=tmp_path / "none"))[0] == "configuration.key_missing"
    assert cause_of(SecretSource(environment="K"))[0] == "configuration.key_missing"
    assert cause_of(SecretSource(file=tmp_path))[0] == "configuration.key_unreadable"


@pytest.fixture
def _not_root() -> Iterator[None]:
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)  # nobody: root reads everything
    yield
    os.seteuid(user)


def test_an_unreadable_file_is_refused(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    tmp_path.parent.parent.chmod(0o711)  # the way to the file stays open
    tmp_path.parent.chmod(0o711)
    tmp_path.chmod(0o711)
    source = SecretSource(file=key_file(tmp_path / "key", mode=0o000))
    request.getfixturevalue("_not_root")
    assert cause_of(source)[0] == "configuration.key_unreadable"


def test_the_key_itself_in_the_configuration_is_refused_without_repeating_it() -> None:
    base = {"host": "127.0.0.1", "port": 0, "link_timeout_ms": 250}
    for wrong in (HEX, {"environment": HEX}, {"secret": HEX}, {"file": [HEX]}):
        with pytest.raises(ConfigurationError) as caught:
            validated(ReferenceLinkConfig, base | {"link_key": wrong}, "controller.yaml")
        assert "link_key" in str(caught.value)
        assert HEX[:8] not in str(caught.value)
    with pytest.raises(ConfigurationError, match="name one of them"):
        validated(
            ReferenceLinkConfig, base | {"link_key": {"file": "a", "environment": "B"}}, "controller.yaml"
        )


def test_the_key_is_in_no_representation() -> None:
    key = LinkKey(bytes.fromhex(HEX))
    session = key.of_client(1, 2, 3)
    secret = bytes.fromhex(HEX)
    for shown in (repr(key), str(key), repr(key.of_hello()), repr(session), f"{key!r}"):
        assert HEX[:8] not in shown
        assert repr(secret[:8])[2:-1] not in shown
