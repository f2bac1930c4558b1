"""How one call of the command line prints, and functions as Typer takes them."""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from typing import Annotated, Any, get_type_hints

import typer

from pinograsp.cli.completion import Completer, make_completer

REQUIRED: Any = MISSING  # of an option's default
_TYPED = "typed"  # in a field's metadata: how it is typed
OUTPUT = "Output"  # the panel of help that has these options


@dataclass(slots=True)
class Session:
    """How one call prints, by the common options.

    Attributes:
        as_json: one JSON object and nothing else.
        quiet: only errors.
        verbose: everything.
        printed: whether the object of ``as_json`` was printed.
        typed: the command's typed parameters, by name, as on the command line.
    """

    as_json: bool = False
    quiet: bool = False
    verbose: bool = False
    printed: bool = False
    typed: dict[str, str] = field(default_factory=dict)

    @property
    def progress(self) -> bool | None:
        """Whether to show progress bars; None: on terminals."""
        return False if self.as_json or self.quiet else None

    @property
    def more(self) -> str:
        """Where to find the rest of the output; "" if everything is shown."""
        return "" if self.verbose else "more: in the report, or with -v"

    def print_json(self, document: dict[str, Any]) -> None:
        """Print the one object of ``--json``."""
        import json

        self.printed = True
        typer.echo(json.dumps(document, allow_nan=False))


def _set_json(context: typer.Context, as_json: bool) -> None:
    context.ensure_object(Session).as_json |= as_json


def _set_quiet(context: typer.Context, quiet: bool) -> None:
    session = context.ensure_object(Session)
    if quiet and not session.quiet:
        session.quiet = True
        context.with_resource(contextlib.redirect_stdout(context.with_resource(open(os.devnull, "w"))))  # noqa: SIM115


def _set_verbose(context: typer.Context, verbose: bool) -> None:
    context.ensure_object(Session).verbose |= verbose


_flag = functools.partial(typer.Option, expose_value=False, rich_help_panel=OUTPUT)
Json = Annotated[
    bool, _flag("--json", callback=_set_json, help="Print one JSON object and nothing else, errors included.")
]
Quiet = Annotated[
    bool, _flag("--quiet", "-q", callback=_set_quiet, help="Print only errors; the exit code gives the result.")
]
Verbose = Annotated[
    bool, _flag("--verbose", "-v", callback=_set_verbose, help="Print everything, including the traceback of an error.")
]
_COMMON = {"as_json": Json, "quiet": Quiet, "verbose": Verbose}


def option(
    panel: str | None,
    help: str,
    *names: str,
    default: Any = None,
    metavar: str | None = None,
    choices: Sequence[str] = (),
    complete: Completer | None = None,
) -> Any:
    """A field of a group of options, as :func:`as_command` takes them.

    Args:
        panel: of the help.
        help: what it is.
        names: as it is typed; none: by the field's name, with ``--no-`` for a truth value.
        default: ``REQUIRED``: it has to be given.
        metavar: of its value; None: its type.
        choices: its values, which shells complete.
        complete: what shells offer as its value instead.
    """
    completer = make_completer(choices) if choices else complete
    typed = typer.Option(*names, help=help, metavar=metavar, rich_help_panel=panel, autocompletion=completer)
    return field(default=default, metadata={_TYPED: typed})


def as_command(function: Callable[..., None]) -> Callable[..., None]:
    """A function as Typer takes it.

    A parameter whose type is a dataclass stands for a group of options, each a field of :func:`option`. One of type
    :class:`Session` stands for the options that all commands have.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind) and kind is not Session}
    parameters = [_parameter("context", typer.Context)]
    for name, parameter in inspect.signature(function).parameters.items():
        if name in groups:
            parameters += _list_options(groups[name])
        elif hints[name] is Session:
            parameters += [_parameter(option, kind, False) for option, kind in _COMMON.items()]
        else:
            parameters.append(_parameter(name, hints[name], parameter.default))

    def command(context: typer.Context, **values: Any) -> None:
        session = context.ensure_object(Session)
        for parameter in context.command.params:
            source = context.get_parameter_source(parameter.name or "")
            if source is not None and source.name == "COMMANDLINE":
                session.typed[parameter.name or ""] = max(parameter.opts, key=len)
        given: dict[str, Any] = {
            name: kind(**{field.name: values.pop(field.name) for field in fields(kind)})
            for name, kind in groups.items()
        }
        given |= {name: session for name, kind in hints.items() if kind is Session}
        function(**{name: value for name, value in values.items() if name not in _COMMON}, **given)

    command.__name__, command.__doc__ = function.__name__, function.__doc__
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def argument(help: str, complete: Completer) -> Any:
    """A field that is typed without a name, and may be left out."""
    return field(default=None, metadata={_TYPED: typer.Argument(help=help, autocompletion=complete)})


@functools.cache
def _list_options(group: type) -> list[inspect.Parameter]:
    """The fields of a group of options as parameters."""
    hints = get_type_hints(group)
    return [
        _parameter(
            field.name,
            Annotated[hints[field.name], field.metadata[_TYPED]],
            inspect.Parameter.empty if field.default is REQUIRED else field.default,
        )
        for field in fields(group)
    ]


def _parameter(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
