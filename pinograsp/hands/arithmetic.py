"""Arithmetic of an untrusted file: simpleeval evaluates its expressions, within bounds of size and work."""

from __future__ import annotations

import ast
import functools
import math
import operator
from collections import ChainMap
from collections.abc import Callable, ItemsView, KeysView, Mapping, ValuesView
from typing import Any, TypeAlias

import simpleeval

# A number, a truth value, a text, nothing, a list of these, or a mapping to these.
Value: TypeAlias = Any
Functions: TypeAlias = Mapping[str, Callable[..., Value]]

MOST_TEXT = 10_000  # characters of a text with expressions
MOST_DATA = 20_000  # values and characters of a value
_MOST_BITS = 1024  # of whole numbers: the range of a float
_MOST_WORK = 1_000_000  # values and characters that one expression goes through: less than a second


class NotAllowed(Exception):
    """A file asks for more than arithmetic, or for numbers beyond all use."""


def _limit(function: Callable[..., Value], largest: float = math.inf, start: int = 0) -> Callable[..., Value]:
    """A function that does more with texts, or takes long for large numbers: from ``start`` on it takes small ones."""

    def call(*arguments: Value) -> Value:
        for argument in arguments[start:]:
            if not isinstance(argument, int | float):
                raise TypeError(f"expected numbers, got {type(argument).__name__}")
            if isinstance(argument, int) and abs(argument) > largest:
                raise NotAllowed(f"{function.__name__} of more than {largest} is too large")
        result = function(*arguments)
        _measure(result)
        return result

    return call


def _power(base: Value, exponent: Value) -> Value:
    if isinstance(base, int) and isinstance(exponent, int) and exponent * (base.bit_length() - 1) > _MOST_BITS:
        raise NotAllowed(f"a whole number of more than {_MOST_BITS} bits is too large")
    return base**exponent


_OPERATORS = simpleeval.DEFAULT_OPERATORS | {ast.Pow: _power}
_OPERATORS |= {kind: _limit(_OPERATORS[kind]) for kind in (ast.Mod, ast.BitOr, ast.BitAnd, ast.BitXor)}
_MATH = {name: value for name, value in vars(math).items() if name[0] != "_" and name != "sumprod"} | {
    "factorial": _limit(math.factorial, 170),
    "perm": _limit(math.perm, 170),
    "comb": _limit(math.comb, 1000),
    "prod": lambda factors: functools.reduce(_limit(operator.mul), factors, 1),
    "lcm": lambda *numbers: functools.reduce(_limit(math.lcm), numbers, 1),
}
_MATH |= {f"math.{name}": value for name, value in _MATH.items()}
_CONSTANTS = {name: value for name, value in _MATH.items() if isinstance(value, float)}
_FUNCTIONS = {name: value for name, value in _MATH.items() if callable(value)}
_FUNCTIONS |= {one.__name__: one for one in (abs, min, max, int, float, bool, len, str, dict)}
_FUNCTIONS["round"] = _limit(round, 400, start=1)
# They only look at a text or a mapping.
_METHODS = {str.split, str.strip, str.lower, str.upper, str.find, str.startswith, str.endswith}
_METHODS |= {dict.get, dict.keys, dict.values, dict.items}


def evaluate(expression: str, names: Mapping[str, Value], functions: Functions) -> Value:
    """The value of an expression that uses ``names`` and calls ``functions``, beside those of Python and ``math``.

    Raises:
        NotAllowed: it asks for more. NameError, TypeError, SyntaxError...: what Python raises for it.
    """
    if len(expression) > MOST_TEXT:
        raise NotAllowed(f"expected an expression of at most {MOST_TEXT} characters")
    try:
        return _Evaluation(names, functions).eval(expression, ast.parse(expression.strip(), mode="eval").body)
    except simpleeval.NameNotDefined as error:
        kind = NotAllowed if error.name in ("xacro", "python") else NameError  # namespaces of more than arithmetic
        raise kind(f"name '{error.name}' is not defined") from None
    except simpleeval.InvalidExpression as error:
        raise NotAllowed(f"only arithmetic is allowed: {error}") from None


class _Evaluation(simpleeval.SimpleEval):  # type: ignore[misc]  # it has no types
    """An expression with the names and functions that it may use, and how much it has gone through so far."""

    def __init__(self, names: Mapping[str, Value], functions: Functions):
        super().__init__(_OPERATORS, _FUNCTIONS | dict(functions), ChainMap(names, _CONSTANTS))  # type: ignore[arg-type]
        self.nodes |= dict.fromkeys((ast.List, ast.Tuple), lambda node: [self._eval(one) for one in node.elts])
        del self.nodes[ast.JoinedStr]  # a format can ask for a text of any length
        self.work = 0

    def _eval(self, node: ast.AST) -> Value:
        """The value of a part of the expression; what is done with values takes no longer than to go through them."""
        value = super()._eval(node)
        value = list(value) if isinstance(value, tuple | KeysView | ValuesView | ItemsView) else value
        self.work += _measure(value)
        if self.work > _MOST_WORK:
            raise NotAllowed(f"it goes through more than {_MOST_WORK} values and characters")
        return value

    def _eval_attribute(self, node: ast.Attribute) -> Value:
        if (name := ast.unparse(node)) in _CONSTANTS:
            return _CONSTANTS[name]
        mapping = self._eval(node.value)
        if not isinstance(mapping, dict) or node.attr not in mapping:
            raise NotAllowed(f"only arithmetic is allowed, no {name[:300]}")
        return mapping[node.attr]

    def _eval_call(self, node: ast.Call) -> Value:
        function = self.functions.get(name := ast.unparse(node.func))
        if function is None and isinstance(node.func, ast.Attribute):
            value = self._eval(node.func.value)
            if getattr(type(value), node.func.attr, None) in _METHODS:
                function = getattr(value, node.func.attr)
        if function is None or (node.args if function is dict else node.keywords):
            raise NotAllowed(f"only functions of arithmetic can be called, not {name[:300]}")
        return function(*map(self._eval, node.args), **dict(map(self._eval_keyword, node.keywords)))


def _measure(value: Value) -> int:
    """How much there is to go through in a value, where it is of a kind and size that expressions may have."""
    if type(value) not in (int, float, bool, str, list, dict, type(None)):
        raise NotAllowed(f"expected a number, a text, a list or a mapping, got {type(value).__name__}")
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise NotAllowed(f"a whole number of more than {_MOST_BITS} bits is too large")
    if (size := size_of(value)) > MOST_DATA:
        raise NotAllowed(f"expected at most {MOST_DATA} values and characters")
    return size


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
