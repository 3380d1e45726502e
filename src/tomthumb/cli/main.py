"""``tomthumb``: finds the command, and says what is wrong with the input in one line."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from tomthumb import __version__
from tomthumb.errors import TomThumbError, UnknownName

# name: "module:function". Imported when used; a command whose module is not there is not listed.
COMMANDS = {
    "demo": "tomthumb.cli.demo:demo",
    "run": "tomthumb.cli.run:run",
    "plot": "tomthumb.cli.plot:plot",
    "list": "tomthumb.cli.listing:listing",
    "check": "tomthumb.cli.check:check",
    "bench": "tomthumb.cli.bench:bench",
    "report": "tomthumb.cli.report:report",
    "forest": "tomthumb.cli.forest:forest",
    "info": "tomthumb.cli.info:info",
    "fetch": "tomthumb.cli.fetch:fetch",
    "export": "tomthumb.cli.export:export",
    "explain": "tomthumb.cli.explain:explain",
    "explore": "tomthumb.cli.explore:explore",
    "live": "tomthumb.cli.live:live",
}


USAGE: type[Exception] = typer.BadParameter.__mro__[1]  # click's UsageError, under whichever roof typer keeps click


class Commands(TyperGroup):
    """The table above as a group of commands (click asks for a subclass to load commands when they are named)."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Commands whose module exists."""
        return [name for name, target in COMMANDS.items() if find_spec(target.partition(":")[0]) is not None]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command behind a name. Raises UnknownName."""
        names = self.list_commands(ctx)
        if cmd_name not in names:
            raise UnknownName("command", cmd_name, names)
        module, _, function = COMMANDS[cmd_name].partition(":")
        single = typer.Typer(add_completion=False)
        single.command(cmd_name)(getattr(import_module(module), function))
        return typer.main.get_command(single)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that is named. What its options do not take is said in one line, like all bad input."""
        try:
            return super().invoke(ctx)
        except USAGE as reason:
            text = " ".join(reason.format_message().split()).rstrip(".")  # type: ignore[attr-defined]
            raise TomThumbError(f"{text} (tomthumb {ctx.invoked_subcommand} --help)") from None


app = typer.Typer(
    cls=Commands,
    name="tomthumb",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tomthumb {__version__}")
        raise typer.Exit


@app.callback()
def tomthumb(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Landmark SLAM with data association: which observation is which landmark?

    Start with `tomthumb demo`. Bad input ends with one line and exit code 2.
    """


def main() -> None:
    """The entry point of the command line."""
    try:
        app()
    except TomThumbError as reason:
        print(f"error: {reason}", file=sys.stderr)
        raise SystemExit(2) from None
