"""The tree of a text. The checker fills ``type`` and what stands behind names; the back end reads both.

What the checker fills is None before, and a FUNCTION without a result has no ``type`` behind.
"""

from dataclasses import dataclass, field
from typing import Any, Union

from structured_text.types import Elementary, Enumeration, Structure, Type


@dataclass
class Expression:
    """``line``: where it stands; ``type``: set by the checker; ``height``: of the tree that it is."""

    line: int
    height: int = field(default=1, init=False)
    type: Type = field(default=None, init=False)  # type: ignore[assignment]


@dataclass
class Literal(Expression):
    """A number or BOOL; ``named``: the type that stands before its #, None for none."""

    value: Any
    named: Elementary | Enumeration | None = None


@dataclass
class Variable:
    """A variable. ``section``: VAR, VAR_INPUT, VAR_OUTPUT, VAR_IN_OUT, VAR_GLOBAL, RESULT.

    ``constant``: its value, None for what is not one; ``offset``: in its instance or in the whole memory;
    None: it lives on the stack. ``running``: it counts an enclosing FOR.
    """

    name: str
    type: Type
    section: str
    line: int
    initial: Any = None
    constant: Any = None
    offset: int | None = None
    running: bool = False


@dataclass
class Name(Expression):
    """A variable by its name."""

    name: str
    variable: Variable = field(default=None, init=False)  # type: ignore[assignment]


@dataclass
class Member(Expression):
    """``of.name``."""

    of: Expression
    name: str
    offset: int = field(default=0, init=False)
    section: str = field(default="VAR", init=False)


@dataclass
class Index(Expression):
    """``of[indices]``."""

    of: Expression
    indices: list[Expression]


@dataclass
class Unary(Expression):
    """``-`` or NOT."""

    sign: str
    operand: Expression


@dataclass
class Binary(Expression):
    """An operator between two."""

    sign: str
    left: Expression
    right: Expression


Argument = tuple[str | None, Expression, bool]
"""``name := value``, or ``name => value`` for an output, which is True; the name None: by place."""


@dataclass
class Call(Expression):
    """A call. The checker sets ``unit``, or ``library`` (a standard function), and ``given`` by name."""

    of: Expression
    arguments: list[Argument]
    unit: "Unit" = field(default=None, init=False)  # type: ignore[assignment]
    library: str = field(default="", init=False)
    given: dict[str, Expression] = field(default_factory=dict, init=False)


@dataclass
class Statement:
    """``line``: where it begins."""

    line: int


Body = list[Statement]


@dataclass
class Assignment(Statement):
    """``target := value;``, or a call whose result nobody takes: without a target."""

    target: Expression | None
    value: Expression


@dataclass
class If(Statement):
    """Conditions with their bodies, and what is done otherwise."""

    branches: list[tuple[Expression, Body]]
    otherwise: Body


@dataclass
class Case(Statement):
    """Each branch: label ranges as expressions, low and high, and its body. The checker leaves ``ranges``."""

    selector: Expression
    branches: list[tuple[list[tuple[Expression, Expression]], Body]]
    otherwise: Body
    ranges: list[list[tuple[int, int]]] = field(default_factory=list, init=False)


@dataclass
class For(Statement):
    """``step`` None: 1. The checker leaves it in ``by``."""

    variable: Name
    first: Expression
    last: Expression
    step: Expression | None
    body: Body
    by: int = field(default=1, init=False)


@dataclass
class While(Statement):
    """WHILE, or REPEAT with ``test_after``, whose condition ends it."""

    condition: Expression
    body: Body
    test_after: bool


@dataclass
class Jump(Statement):
    """EXIT, CONTINUE or RETURN."""

    word: str


@dataclass
class TypeText:
    """How a type is written: a name, or array bounds with what is inside."""

    line: int
    name: str
    bounds: list[tuple[Expression, Expression]] = field(default_factory=list)
    of: Union["TypeText", None] = None


@dataclass
class Initializer:
    """An expression, a list for an array, or a dict for a structure."""

    line: int
    value: Any


@dataclass
class VariableDeclaration:
    """Variables of one type in a declaration."""

    line: int
    name: str
    section: str
    type: TypeText
    initial: Initializer | None
    constant: bool = False


@dataclass
class TypeDeclaration:
    """TYPE: ``members`` of a STRUCT, ``values`` of an enumeration, or ``alias``."""

    file: str
    line: int
    name: str
    alias: TypeText | None = None
    members: list[VariableDeclaration] | None = None
    values: list[tuple[str, Expression | None, int]] | None = None
    base: str = "INT"


@dataclass
class Unit:
    """A FUNCTION, FUNCTION_BLOCK or PROGRAM. The checker sets ``result``, ``variables`` and ``instance``."""

    file: str
    line: int
    kind: str
    name: str
    result_text: TypeText | None
    declared: list[VariableDeclaration]
    body: Body
    result: Type = field(default=None, init=False)  # type: ignore[assignment]
    variables: dict[str, Variable] = field(default_factory=dict, init=False)
    instance: Structure | None = field(default=None, init=False)
    calls: list[str] = field(default_factory=list, init=False)

    def parameters(self) -> list[Variable]:
        """What is handed over in a call, in order; of an instance VAR_IN_OUT alone."""
        passed = ("VAR_INPUT", "VAR_IN_OUT", "VAR_OUTPUT") if self.instance is None else ("VAR_IN_OUT",)
        return [each for each in self.variables.values() if each.section in passed]


@dataclass
class Globals:
    """A VAR_GLOBAL block."""

    file: str
    declared: list[VariableDeclaration]
