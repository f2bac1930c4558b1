"""Arithmetic of an untrusted file: simpleeval evaluates its expressions, within bounds of size and work."""

from __future__ import annotations

import ast
import math
import operator
from collections import ChainMap
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import simpleeval

# A number, a truth value, a text, nothing, a list of these, or a mapping to these.
Value: TypeAlias = Any

MOST_TEXT = 10_000  # characters of a text, and values and characters of a list
MOST_DATA = 20_000  # of a mapping
_MOST_BITS = 1024  # of whole numbers: the range of a float
_MOST_WORK = 1_000_000  # values and characters that one expression goes through: less than a second


class NotArithmetic(ValueError):
    """An expression asks for more than arithmetic, or for numbers beyond all use."""


class NotPython(NotArithmetic):
    """An expression that Python cannot read."""


def _take_numbers(operation: Callable[[Value, Value], Value]) -> Callable[[Value, Value], Value]:
    """An operation that does more with texts and mappings, such as ``%``, for numbers only."""

    def operate(left: Value, right: Value) -> Value:
        if not (isinstance(left, int | float) and isinstance(right, int | float)):
            raise TypeError(f"expected numbers, got {type(left).__name__} and {type(right).__name__}")
        if operation is operator.pow and type(left) is type(right) is int:
            _check_bits(right * (left.bit_length() - 1))
        return operation(left, right)

    return operate


_PARTS = {ast.Constant, ast.Name, ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Subscript, ast.List}
_PARTS |= {ast.Tuple, ast.Attribute, ast.Call, ast.keyword, ast.Expression, ast.Load, ast.And, ast.Or}
_OPERATORS: dict[type[ast.AST], Callable[..., Value]] = simpleeval.DEFAULT_OPERATORS | {ast.Pow: operator.pow}
_OPERATORS |= {kind: _take_numbers(_OPERATORS[kind]) for kind in (ast.Pow, ast.Mod, ast.BitOr, ast.BitAnd, ast.BitXor)}
_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
# The largest whole numbers that functions take whose results grow faster than any other's, and from which argument on.
_LARGEST = {"factorial": (170, 0), "perm": (170, 0), "comb": (1000, 0), "round": (400, 1)}
_CONSTANTS = {name: value for name, value in _MATH.items() if isinstance(value, float)}
_FUNCTIONS: dict[str, Callable[..., Value]] = {
    **{one.__name__: one for one in (abs, min, max, int, float, bool, len, str, round)},
    **{start + name: value for start in ("", "math.") for name, value in _MATH.items() if callable(value)},
}
# Methods that only look at a text or a mapping.
_METHODS: dict[type, tuple[str, ...]] = {
    str: ("split", "strip", "lower", "upper", "startswith", "endswith"),
    dict: ("get", "keys", "values", "items"),
}


def parse_expression(expression: str) -> ast.Expression:
    """The expression as a tree of what is allowed; NotArithmetic where there is anything else."""
    if len(expression) > MOST_TEXT:
        raise NotArithmetic(f"expected an expression of at most {MOST_TEXT} characters")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotPython("expected an expression that Python can read") from None
    for node in ast.walk(tree):
        name = getattr(node, "id", getattr(node, "attr", ""))
        hidden = name.startswith("__" if isinstance(node, ast.Name) else "_")
        if hidden or not (type(node) in _PARTS or type(node) in _OPERATORS):
            raise NotArithmetic(f"only arithmetic is allowed, no {name or type(node).__name__}")
        # Texts are for comparing and joining; nothing may be assembled that reads like another expression.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ("$" in node.value or "%" in node.value):
            raise NotArithmetic("no text with '$' or '%' is allowed")
    return tree


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
        return _Evaluation(names, functions).eval(expression, parse_expression(expression).body)
    except simpleeval.NameNotDefined as error:
        raise NameError(f"name '{error.name}' is not defined") from None
    except simpleeval.InvalidExpression as error:
        raise NotArithmetic(f"only arithmetic is allowed: {error}") from None


class _Evaluation(simpleeval.SimpleEval):  # type: ignore[misc]  # it has no types
    """An expression with the names and functions that it may use, and how much it has gone through so far."""

    def __init__(self, names: Mapping[str, Value], functions: Mapping[str, Callable[..., Value]]):
        super().__init__(_OPERATORS, functions={}, names=ChainMap(names, _CONSTANTS))  # type: ignore[arg-type]
        self.callables = ChainMap(functions, _FUNCTIONS)  # type: ignore[arg-type]  # neither is written to
        self.work = 0
        self.nodes |= dict.fromkeys((ast.List, ast.Tuple), lambda node: [self._eval(one) for one in node.elts])

    def _eval(self, node: ast.AST) -> Value:
        """The value of a part of the expression; what is done with values takes no longer than to go through them."""
        value = super()._eval(node)
        value = list(value) if isinstance(value, tuple) else value
        self.work += _measure(value)
        if self.work > _MOST_WORK:
            raise NotArithmetic(f"it goes through more than {_MOST_WORK} values and characters")
        return value

    def _eval_attribute(self, node: ast.Attribute) -> Value:
        if (name := ast.unparse(node)) in (f"math.{one}" for one in _CONSTANTS):
            return _CONSTANTS[node.attr]
        mapping = self._eval(node.value)
        if type(mapping) is not dict or node.attr not in mapping:
            raise NotArithmetic(f"only arithmetic is allowed, no {name[:300]}")
        return mapping[node.attr]

    def _eval_call(self, node: ast.Call) -> Value:
        name, arguments = ast.unparse(node.func), [self._eval(one) for one in node.args]
        if name == "dict" and not arguments and all(one.arg for one in node.keywords):
            return {str(one.arg): self._eval(one.value) for one in node.keywords}
        if name in self.callables and not node.keywords:
            _check_call(name.removeprefix("math."), arguments)
            return self.callables[name](*arguments)
        if isinstance(node.func, ast.Attribute) and not node.keywords:
            value = self._eval(node.func.value)
            if node.func.attr in _METHODS.get(type(value), ()):
                found = getattr(value, node.func.attr)(*arguments)
                return list(found) if node.func.attr in ("keys", "values", "items") else found
        raise NotArithmetic(f"only functions of arithmetic can be called, not {name[:300]}")


def _check_bits(count: int) -> None:
    if count > _MOST_BITS:
        raise NotArithmetic(f"a whole number of more than {_MOST_BITS} bits is too large")


def _check_call(name: str, arguments: list[Value]) -> None:
    """Refuse calls that would take minutes."""
    largest, start = _LARGEST.get(name, (0, len(arguments)))
    if any(isinstance(one, int) and abs(one) > largest for one in arguments[start:]):
        raise NotArithmetic(f"{name} of more than {largest} is too large")
    if name in ("prod", "lcm"):
        factors = arguments[0] if name == "prod" and arguments and isinstance(arguments[0], list) else arguments
        if not all(isinstance(one, int | float) for one in factors):
            raise TypeError(f"{name}: expected numbers")
        _check_bits(sum(one.bit_length() for one in factors if isinstance(one, int)))


def _measure(value: Value) -> int:
    """How much there is to go through in a value, where it is of a kind and size that expressions may have."""
    if isinstance(value, int | float):
        _check_bits(value.bit_length() if isinstance(value, int) else 0)
        return 1
    if value is not None and not isinstance(value, str | list) and type(value) is not dict:
        raise NotArithmetic(f"expected a number, a text, a list or a mapping, got {type(value).__name__}")
    if (size := size_of(value)) > (MOST_DATA if isinstance(value, dict) else MOST_TEXT + 1):
        raise NotArithmetic(f"expected a text or list of at most {MOST_TEXT} values, a mapping of {MOST_DATA}")
    return 1 + size


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
