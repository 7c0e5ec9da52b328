"""Commands that are loaded when they are asked for: help and completion must not wait for what they need."""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from testbed.cli.every_command import dressed


class Later(NamedTuple):
    """A command or group, ``module`` or ``module:function``, and what the list of commands says of it."""

    place: str
    told: str
    example: str | None = None

    def load(self) -> Any:
        """The command itself."""
        module, _, function = self.place.partition(":")
        loaded = importlib.import_module(module)
        if not function:
            return typer.main.get_group(loaded.app)
        app = typer.Typer(add_completion=False)
        app.command(epilog=self.example)(getattr(loaded, function))
        return typer.main.get_command(app)


class LaterGroup(TyperGroup, ABC):
    """A group of which some commands are loaded later: ``later`` has what is told of each before that."""

    later: Mapping[str, str]

    @abstractmethod
    def load(self, name: str) -> Any:
        """The command called ``name``, one of ``later``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names: those that are here, then the others."""
        return [*dict.fromkeys([*super().list_commands(ctx), *self.later])]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command called ``cmd_name``, or for the list of commands what is told of it; None: no such."""
        if cmd_name in self.commands:
            return dressed(self.commands[cmd_name])
        return TyperCommand(cmd_name, help=self.later[cmd_name]) if cmd_name in self.later else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` begin with, loaded, and the other arguments."""
        if args[0] in self.later and args[0] not in self.commands:
            self.commands[args[0]] = self.load(args[0])
            self.commands[args[0]].name = args[0]
        elif self.get_command(ctx, args[0]) is None:  # what is like it may be among those
            self.commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        return super().resolve_command(ctx, args)
