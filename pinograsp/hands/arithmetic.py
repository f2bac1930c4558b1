"""Arithmetic of an untrusted file: expressions evaluated here, node by node, never by Python itself."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

# A number, a truth value, a text, a list of these, or a function of arithmetic.
Value: TypeAlias = Any

MOST_TEXT = 10_000  # characters of a text, and numbers in a list
_MOST_BITS = 1024  # of whole numbers: the range of a float
_BINARY: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
_UNARY: dict[type[ast.unaryop], Callable[[Value], Value]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.invert,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Value, Value], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_NODES = (
    ast.Expression,
    ast.Constant,
    ast.Name,
    ast.Load,
    ast.UnaryOp,
    ast.BinOp,
    ast.BoolOp,
    ast.And,
    ast.Or,
    ast.Compare,
    ast.IfExp,
    ast.Call,
    ast.Subscript,
    ast.List,
    ast.Tuple,
    ast.Attribute,
    *_BINARY,
    *_UNARY,
    *_COMPARE,
)
_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
FUNCTIONS: dict[str, Value] = {
    **_MATH,
    "abs": abs,
    "min": min,
    "max": max,
    "round": round,
    "int": int,
    "float": float,
    "bool": bool,
    "len": len,
    "str": str,
    "True": True,
    "False": False,
}
# Functions whose results grow faster than any other's, and the largest argument they may have.
_GROWING: dict[Callable[..., int], int] = {math.factorial: 170, math.comb: 1000, math.perm: 170, round: 400}


class NotArithmetic(ValueError):
    """An expression asks for more than arithmetic, or for numbers beyond all use."""


def parsed(expression: str) -> ast.Expression:
    """The expression as a tree of what is allowed; NotArithmetic where there is anything else."""
    if len(expression) > MOST_TEXT:
        raise NotArithmetic(f"expected an expression of at most {MOST_TEXT} characters")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotArithmetic("expected an expression that Python can read") from None
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            raise NotArithmetic(f"only arithmetic is allowed, no {type(node).__name__}")
        if isinstance(node, ast.Name) and node.id.startswith("__"):
            raise NotArithmetic(f"the name {node.id} is not allowed")
        if isinstance(node, ast.Attribute) and not (
            isinstance(node.value, ast.Name) and node.value.id == "math" and node.attr in _MATH
        ):
            raise NotArithmetic("only arithmetic is allowed, no attributes but those of math")
        if isinstance(node, ast.Call) and node.keywords:
            raise NotArithmetic("only arithmetic is allowed, no named arguments")
        if isinstance(node, ast.Constant) and not isinstance(node.value, bool | int | float | str):
            raise NotArithmetic(f"only numbers and texts are allowed, not {node.value!r}")
        # Texts are for comparing and joining; nothing may be assembled that reads like another expression.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ("$" in node.value or "%" in node.value):
            raise NotArithmetic("no text with '$' or '%' is allowed")
    return tree


def names(tree: ast.AST) -> set[str]:
    """Names that an expression uses."""
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


def evaluate(expression: str, names: Mapping[str, Value]) -> Value:
    """The value of an expression: a number, a truth value, a text, or a list of these.

    Args:
        names: values of the names that it may use, beside Python's and ``math``'s functions.

    Raises:
        NotArithmetic: it asks for more. NameError, TypeError, ZeroDivisionError...: what Python raises for it.
    """
    return _value(parsed(expression).body, names)


def _value(node: ast.expr, names: Mapping[str, Value]) -> Value:
    if isinstance(node, ast.Constant):
        return _bounded(node.value)
    if isinstance(node, ast.Name):
        return _named(node.id, names)
    if isinstance(node, ast.Attribute):
        return _MATH[node.attr]
    if isinstance(node, ast.UnaryOp):
        return _bounded(_UNARY[type(node.op)](_value(node.operand, names)))
    if isinstance(node, ast.BinOp):
        return _binary(type(node.op), _value(node.left, names), _value(node.right, names))
    if isinstance(node, ast.BoolOp):
        for one in node.values:
            value = _value(one, names)
            if bool(value) != isinstance(node.op, ast.And):
                break
        return value
    if isinstance(node, ast.Compare):
        left = _value(node.left, names)
        for kind, other in zip(node.ops, node.comparators):
            right = _value(other, names)
            if not _COMPARE[type(kind)](left, right):
                return False
            left = right
        return True
    if isinstance(node, ast.IfExp):
        return _value(node.body if _value(node.test, names) else node.orelse, names)
    if isinstance(node, ast.Subscript):
        return _value(node.value, names)[_value(node.slice, names)]
    if isinstance(node, ast.List | ast.Tuple):
        return _bounded([_value(one, names) for one in node.elts])
    if isinstance(node, ast.Call):
        return _called(_value(node.func, names), [_value(one, names) for one in node.args])
    raise NotArithmetic(f"only arithmetic is allowed, no {type(node).__name__}")


def _named(name: str, names: Mapping[str, Value]) -> Value:
    if name in names:
        return _bounded(names[name])
    if name in FUNCTIONS:
        return FUNCTIONS[name]
    raise NameError(f"name '{name}' is not defined")


def _binary(kind: type[ast.operator], left: Value, right: Value) -> Value:
    numbers = isinstance(left, int | float) and isinstance(right, int | float)
    if not numbers and kind is not ast.Add:
        if kind is not ast.Mult or not isinstance(right if isinstance(left, str | list) else left, int):
            raise TypeError(f"expected numbers, got {type(left).__name__} and {type(right).__name__}")
        count, repeated = (right, left) if isinstance(left, str | list) else (left, right)
        if count * _size(repeated) > MOST_TEXT:
            raise NotArithmetic(f"a text or list of more than {MOST_TEXT} is too long")
    if isinstance(left, int) and isinstance(right, int):
        bits = right * (left.bit_length() - 1) if kind is ast.Pow else right if kind is ast.LShift else 0
        if bits > _MOST_BITS and left:
            raise _too_large()
    result = _BINARY[kind](left, right)
    if isinstance(result, complex):
        raise ValueError("a root of a negative number")
    return _bounded(result)


def _called(function: Value, arguments: list[Value]) -> Value:
    if not any(function is one for one in FUNCTIONS.values()) or not callable(function):
        raise NotArithmetic("only functions of arithmetic can be called")
    most = _GROWING.get(function)
    if most is not None:
        limited = arguments[1:] if function is round else arguments
        if any(isinstance(one, int) and abs(one) > most for one in limited):
            raise NotArithmetic(f"{function.__name__} of more than {most} is too large")
    return _bounded(function(*arguments))


def _bounded(value: Value) -> Value:
    """The value, where it is of a kind and size that expressions may have."""
    if isinstance(value, tuple):
        value = list(value)
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > _MOST_BITS:
        raise _too_large()
    if isinstance(value, str | list) and _size(value) > MOST_TEXT:
        raise NotArithmetic(f"a text or list of more than {MOST_TEXT} is too long")
    if not isinstance(value, int | float | str | list) and not any(value is one for one in FUNCTIONS.values()):
        raise NotArithmetic(f"expected a number, a text or a list, got {type(value).__name__}")
    return value


def _too_large() -> NotArithmetic:
    return NotArithmetic(f"a whole number of more than {_MOST_BITS} bits is too large")


def _size(value: Value) -> int:
    """Characters of a text, or elements of a list and of those in it, counted no further than to beyond the limit."""
    if isinstance(value, str):
        return len(value)
    waiting, size = [value], 0
    while waiting and size <= MOST_TEXT:
        one = waiting.pop()
        if isinstance(one, list):
            size += 1 + len(one)
            waiting += one[: MOST_TEXT + 1]
        elif isinstance(one, str):
            size += len(one)
    return size
