"""The command as a user calls it."""

from typer.testing import CliRunner, Result

from testbed.cli.main import app


def ran(*words: object, status: int = 0) -> Result:
    """What `longreach` answers to ``words``. Fails where it ends with another ``status``, or an exception."""
    done = CliRunner().invoke(app, [*map(str, words)], terminal_width=200)
    assert done.exit_code == status, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return done
