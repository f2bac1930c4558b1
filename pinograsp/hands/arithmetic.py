"""Arithmetic of an untrusted file: simpleeval evaluates its expressions, within bounds of size and work."""

from __future__ import annotations

import ast
import functools
import math
from collections import ChainMap
from collections.abc import Callable, Container, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import simpleeval

# A number, a truth value, a text, nothing, a list of these, or a mapping to these.
Value: TypeAlias = Any

MOST_TEXT = 10_000  # characters of a text, and values and characters of a list
MOST_DATA = 20_000  # of a mapping
_MOST_BITS = 1024  # of whole numbers: the range of a float
_TOO_LARGE = f"a whole number of more than {_MOST_BITS} bits is too large"
_MOST_WORK = 1_000_000  # values and characters that one expression goes through: less than a second
# Parts that an expression may have: those that simpleeval evaluates, beside its operators, and others.
_PARTS = {ast.Constant, ast.Name, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Subscript}
_OTHERS = (ast.List, ast.Tuple, ast.Attribute, ast.Call, ast.keyword, ast.Expression, ast.Load, ast.And, ast.Or)


class NotArithmetic(ValueError):
    """An expression asks for more than arithmetic, or for numbers beyond all use."""


class NotPython(NotArithmetic):
    """An expression that Python cannot read."""


def _of_numbers(operation: Callable[[Value, Value], Value]) -> Callable[[Value, Value], Value]:
    """An operation that does more with texts and mappings, such as ``%``, for numbers only."""

    def checked(left: Value, right: Value) -> Value:
        if not (isinstance(left, int | float) and isinstance(right, int | float)):
            raise TypeError(f"expected numbers, got {type(left).__name__} and {type(right).__name__}")
        return operation(left, right)

    return checked


def _power(base: Value, exponent: Value) -> Value:
    if isinstance(base, int) and isinstance(exponent, int) and exponent * (base.bit_length() - 1) > _MOST_BITS:
        raise NotArithmetic(_TOO_LARGE)
    return base**exponent


_OPERATORS: dict[type[ast.AST], Callable[..., Value]] = simpleeval.DEFAULT_OPERATORS | {ast.Pow: _of_numbers(_power)}
for _kind in (ast.Mod, ast.BitOr, ast.BitAnd, ast.BitXor):
    _OPERATORS[_kind] = _of_numbers(_OPERATORS[_kind])


_ALLOWED = {*_PARTS, *_OTHERS, *_OPERATORS}


def _limit(function: Callable[..., Value], most: int, skip: int = 0) -> Callable[..., Value]:
    """A function whose result grows faster than any other's, with the largest whole number it may have."""

    def checked(*arguments: Value) -> Value:
        if any(isinstance(one, int) and abs(one) > most for one in arguments[skip:]):
            raise NotArithmetic(f"{function.__name__} of more than {most} is too large")
        return function(*arguments)

    return checked


# Python's own take minutes for a list of large whole numbers: these stop where the result is too large.
def _product(factors: Iterable[Value]) -> Value:
    return functools.reduce(lambda left, right: _check_bounds(left * right), factors, 1)


def _multiple(*numbers: Value) -> Value:
    return functools.reduce(lambda left, right: _check_bounds(math.lcm(left, right)), numbers, 1)


_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
_MATH |= {"prod": _product, "lcm": _multiple, "comb": _limit(math.comb, 1000)}
_MATH |= {"factorial": _limit(math.factorial, 170), "perm": _limit(math.perm, 170)}
CONSTANTS = {name: value for name, value in _MATH.items() if isinstance(value, float)}
FUNCTIONS: dict[str, Callable[..., Value]] = {
    **{one.__name__: one for one in (abs, min, max, int, float, bool, len, str)},
    "round": _limit(round, 400, skip=1),
    **{start + name: value for start in ("", "math.") for name, value in _MATH.items() if callable(value)},
}
# Methods that only look at a text or a mapping.
_METHODS: dict[type, dict[str, Callable[..., Value]]] = {
    str: {name: getattr(str, name) for name in ("split", "strip", "lower", "upper", "startswith", "endswith")},
    dict: {
        "get": dict.get,
        "keys": lambda mapping: list(mapping.keys()),
        "values": lambda mapping: list(mapping.values()),
        "items": lambda mapping: [list(pair) for pair in mapping.items()],
    },
}


def parsed(expression: str) -> ast.Expression:
    """The expression as a tree of what is allowed; NotArithmetic where there is anything else."""
    if len(expression) > MOST_TEXT:
        raise NotArithmetic(f"expected an expression of at most {MOST_TEXT} characters")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotPython("expected an expression that Python can read") from None
    for node in ast.walk(tree):
        if type(node) not in _ALLOWED:
            raise NotArithmetic(f"only arithmetic is allowed, no {type(node).__name__}")
        name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
        if name.startswith("__" if isinstance(node, ast.Name) else "_"):
            raise NotArithmetic(f"the name {name} is not allowed")
        if isinstance(node, ast.Call) and node.keywords and not _is_mapping(node):
            raise NotArithmetic("only arithmetic is allowed, no named arguments")
        # Texts are for comparing and joining; nothing may be assembled that reads like another expression.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ("$" in node.value or "%" in node.value):
            raise NotArithmetic("no text with '$' or '%' is allowed")
    return tree


def names(tree: ast.AST, known: Container[str] = ()) -> set[str]:
    """Names that an expression uses, but for calls of the functions ``known``, as ``load`` or ``yaml.load``."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    called = [node.func for node in calls if _join_dotted(node.func) in known or _is_mapping(node)]
    fine = {id(one.value if isinstance(one, ast.Attribute) else one) for one in called}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in fine}


def evaluate(
    expression: str, names: Mapping[str, Value], functions: Mapping[str, Callable[..., Value]] = MappingProxyType({})
) -> Value:
    """The value of an expression: a number, a truth value, a text, or a list of or a mapping to these.

    Args:
        names: values of the names that it may use, beside Python's and ``math``'s functions.
        functions: others that it may call, by name, as ``load`` or ``yaml.load``.

    Raises:
        NotArithmetic: it asks for more. NameError, TypeError, ZeroDivisionError...: what Python raises for it.
    """
    try:
        return _Evaluation(names, functions).eval(expression, parsed(expression).body)
    except simpleeval.NameNotDefined as error:
        raise NameError(f"name '{error.name}' is not defined") from None
    except simpleeval.InvalidExpression as error:
        raise NotArithmetic(f"only arithmetic is allowed: {error}") from None


class _Evaluation(simpleeval.SimpleEval):  # type: ignore[misc]  # it has no types
    """An expression with the names and functions that it may use, and how much it has gone through so far."""

    nodes: dict[type[ast.AST], Callable[..., Value]]

    def __init__(self, names: Mapping[str, Value], functions: Mapping[str, Callable[..., Value]]):
        super().__init__(_OPERATORS, functions={}, names=ChainMap(names, CONSTANTS))  # type: ignore[arg-type]
        self.callables = ChainMap(functions, FUNCTIONS)  # type: ignore[arg-type]  # neither is written to
        self.work = 0
        parts = {kind: self.nodes[kind] for kind in _PARTS} | dict.fromkeys((ast.List, ast.Tuple), self._list)
        parts |= {ast.Attribute: self._attribute, ast.Call: self._call}
        self.nodes = {kind: functools.partial(self._part, handle) for kind, handle in parts.items()}

    def _part(self, handle: Callable[[ast.AST], Value], node: ast.AST) -> Value:
        """The value of a part of the expression, of a kind and size that it may have; NotArithmetic for too much work.

        What is done with values takes no longer than to go through them, so that their sizes bound the time.
        """
        value = _check_bounds(handle(node))
        self.work += 1 + (0 if isinstance(value, int | float) else size_of(value))
        if self.work > _MOST_WORK:
            raise NotArithmetic(f"it goes through more than {_MOST_WORK} values and characters")
        return value

    def _list(self, node: ast.List | ast.Tuple) -> list[Value]:
        return [self.eval(self.expr, one) for one in node.elts]

    def _attribute(self, node: ast.Attribute) -> Value:
        if _join_dotted(node) == f"math.{node.attr}":
            if node.attr not in CONSTANTS:
                raise NotArithmetic(f"math has no number {node.attr}")
            return CONSTANTS[node.attr]
        mapping = self.eval(self.expr, node.value)
        if type(mapping) is not dict:
            raise NotArithmetic(f"only arithmetic is allowed, no '{node.attr}' of a {type(mapping).__name__}")
        if node.attr not in mapping:
            raise KeyError(f"no '{node.attr}' among {', '.join(map(str, mapping))}"[:300])
        return mapping[node.attr]

    def _call(self, node: ast.Call) -> Value:
        if _is_mapping(node):
            return {str(one.arg): self.eval(self.expr, one.value) for one in node.keywords}
        arguments = [self.eval(self.expr, one) for one in node.args]
        if (name := _join_dotted(node.func)) in self.callables:
            return self.callables[name](*arguments)
        if isinstance(node.func, ast.Attribute):
            value = self.eval(self.expr, node.func.value)
            if (method := _METHODS.get(type(value), {}).get(node.func.attr)) is not None:
                return method(value, *arguments)
        if isinstance(node.func, ast.Name) and name not in self.names:
            raise NameError(f"name '{name}' is not defined")
        raise NotArithmetic(f"only functions of arithmetic can be called, not {ast.unparse(node.func)}")


def _is_mapping(node: ast.Call) -> bool:
    """Whether a call is ``dict(name=value, ...)``."""
    return _join_dotted(node.func) == "dict" and not node.args and all(one.arg for one in node.keywords)


def _join_dotted(node: ast.expr) -> str:
    """A name, or a name in a namespace; "" for anything else."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def _check_bounds(value: Value) -> Value:
    """The value, where it is of a kind and size that expressions may have."""
    if type(value) is float or type(value) is bool:
        return value
    value = list(value) if isinstance(value, tuple) else value
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise NotArithmetic(_TOO_LARGE)
    if isinstance(value, str | list | dict) and size_of(value) > (
        MOST_DATA if isinstance(value, dict) else MOST_TEXT + 1
    ):
        raise NotArithmetic(f"expected a text or list of at most {MOST_TEXT}, a mapping of at most {MOST_DATA} values")
    if value is not None and not isinstance(value, int | float | str | list) and type(value) is not dict:
        raise NotArithmetic(f"expected a number, a text, a list or a mapping, got {type(value).__name__}")
    return value


def size_of(value: Value) -> int:
    """Values in a list or mapping, in those in it, and characters, counted no further than to beyond the limits."""
    waiting, size = [value], 0
    while waiting and size <= MOST_DATA:
        one = waiting.pop()
        size += 1 + (len(one) if isinstance(one, str) else 0)
        if isinstance(one, list | tuple | set):  # of YAML's, as !!omap and !!set
            waiting += [*one][: MOST_DATA + 1]
        elif type(one) is dict:
            waiting += [*one.keys(), *one.values()]
    return size
