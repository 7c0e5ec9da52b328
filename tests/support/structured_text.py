"""Runs IEC 61131-3 structured text: the part of the language that docs/protocol/*.st keeps to, and no more.

Stricter than a PLC's compiler: types are never converted by themselves, conversions must fit, arrays are
bounded, signed numbers do not overflow, and arithmetic on bit strings is refused. Unsigned numbers wrap.
"""

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

from tests.support.structured_text_parser import ArrayType, FunctionText, Parser
from tests.support.structured_text_values import ELEMENTARY, Runtime


class Reference(NamedTuple):
    """Where an elementary VAR_IN_OUT or VAR_OUTPUT is kept by the caller."""

    place: Any
    key: Any

    def get(self) -> Any:
        """Its value."""
        return self.place[self.key] if isinstance(self.place, list) else getattr(self.place, self.key)

    def set(self, value: Any) -> None:
        """Give it a value."""
        if isinstance(self.place, list):
            self.place[self.key] = value
        else:
            setattr(self.place, self.key, value)


class Programs:
    """Types and functions of one or more texts, ready to be used from Python."""

    def __init__(self, *texts: str) -> None:
        self.types: dict[str, Any] = {}
        self.functions: dict[str, FunctionText] = {}
        self._runs: dict[str, Callable[..., Any]] = {}
        for text in texts:
            Parser(text, self.types, self.functions).declarations()
        for name, function in self.functions.items():
            scope = {"_": Runtime, "F": self._runs, "Reference": Reference}
            exec(f"def run(v):\n{function.body}", scope)
            self._runs[name] = self._runner(name, scope["run"])

    def _runner(self, name: str, run: Any) -> Callable[..., Any]:
        function = self.functions[name]

        def called(**given: Any) -> Any:
            scope = SimpleNamespace(**{name: self.default(function.result)})
            for section, variables in function.variables.items():
                for variable, kind in variables.items():
                    from_caller = section in ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT")
                    setattr(scope, variable, given.pop(variable) if from_caller else self.default(kind))
            assert not given, f"{name} has no {list(given)}"
            run(scope)
            return getattr(scope, name)

        return called

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return self._runs[name]

    def default(self, kind: Any) -> Any:
        """A value of ``kind`` as a PLC begins with it."""
        if isinstance(kind, ArrayType):
            return [self.default(kind.of) for _ in range(kind.length)]
        if kind in ELEMENTARY:
            return {"BOOL": False, "LREAL": 0.0}.get(kind, 0)
        declared = self.types[kind]
        if isinstance(declared, ArrayType):
            return self.default(declared)
        return SimpleNamespace(**{name: self.default(of) for name, of in declared.items()})


def output(value: Mapping[str, Any]) -> tuple[SimpleNamespace, dict[str, Reference]]:
    """Places for the elementary VAR_OUTPUTs and VAR_IN_OUTs of a call, and the references to hand over."""
    places = SimpleNamespace(**value)
    return places, {name: Reference(places, name) for name in value}
