"""`downbeat`: one entry point; every subcommand imports its own needs when it runs.

Exit codes: 0 good, 1 the thing asked failed (a fall, a missed section), 2 wrong input.
"""

from __future__ import annotations

import sys
from typing import Annotated

import tyro

from downbeat.runtime.errors import DownbeatError
from downbeat.tools.commands import (
    catalog,
    evaluate,
    models,
    operate,
    policy,
    processes,
    robot,
    show,
    sweep,
)

sub = tyro.conf.subcommand

Command = (
    Annotated[show.Demo, sub("demo")]
    | Annotated[show.Rehearse, sub("rehearse")]
    | Annotated[evaluate.Eval, sub("eval")]
    | Annotated[catalog.CatalogCommand, sub("catalog")]
    | Annotated[policy.Policy, sub("policy")]
    | Annotated[models.Models, sub("models")]
    | Annotated[sweep.Sweep, sub("sweep")]
    | Annotated[sweep.Atlas, sub("atlas")]
    | Annotated[processes.Sim, sub("sim")]
    | Annotated[processes.Listen, sub("listen")]
    | Annotated[processes.Source, sub("source")]
    | Annotated[processes.Conduct, sub("conduct")]
    | Annotated[processes.Speak, sub("speech")]
    | Annotated[processes.Check, sub("check")]
    | Annotated[processes.Control, sub("control")]
    | Annotated[processes.Record, sub("record")]
    | Annotated[robot.Bridge, sub("bridge")]
    | Annotated[operate.Ask, sub("ask")]
    | Annotated[operate.Stop, sub("stop")]
    | Annotated[operate.Replay, sub("replay")]
    | Annotated[operate.Traffic, sub("traffic")]
    | Annotated[operate.Report, sub("report")]
    | Annotated[operate.Spy, sub("spy")]
    | Annotated[operate.Doctor, sub("doctor")]
    | Annotated[operate.Bench, sub("bench")]
    | Annotated[operate.Budget, sub("budget")]
    | Annotated[operate.Export, sub("export")]
)


def main(argv: list[str] | None = None) -> int:
    """Parse, run, and turn wrong input into one sentence and exit code 2."""
    try:
        command = tyro.cli(
            Command,  # type: ignore[arg-type]
            prog="downbeat",
            description="Downbeat makes a Unitree G1 hear, decide and dance.",
            args=argv,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
        return int(command.run())
    except DownbeatError as error:
        print(f"downbeat: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("downbeat: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
