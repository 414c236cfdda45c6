"""`downbeat`: one entry point; every subcommand imports its own needs when it runs.

Exit codes: 0 good, 1 the thing asked failed (a fall, a missed section, output that no disk takes),
2 wrong input; 130 by Ctrl-C, 141 where nobody reads the output any more (`downbeat ... | head -1`),
as of any Unix tool.
"""

from __future__ import annotations

import errno
import os
import select
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
    | Annotated[operate.Arm, sub("arm")]
    | Annotated[operate.Replay, sub("replay")]
    | Annotated[operate.Traffic, sub("traffic")]
    | Annotated[operate.Report, sub("report")]
    | Annotated[operate.Spy, sub("spy")]
    | Annotated[operate.Doctor, sub("doctor")]
    | Annotated[operate.Bench, sub("bench")]
    | Annotated[operate.Budget, sub("budget")]
    | Annotated[operate.Export, sub("export")]
)


REFUSED = 1
INTERRUPTED, NO_READER = 130, 141
"""128 and the number of the signal, as a shell counts."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def main(argv: list[str] | None = None) -> int:
    """Parse, run, and turn wrong input into one sentence and exit code 2."""
    try:
        try:
            return _run(argv)
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()  # what nobody can read must show here, not after the end
    # A signal instead of an exception would end a process that moves a robot, for any socket.
    except BrokenPipeError:
        if not _drop_unread_output():
            raise
        return NO_READER
    except OSError as error:
        if not (refused := _drop_refused_output(error)):
            raise
        print(f"downbeat: {'; '.join(refused)}.", file=sys.stderr)
        return REFUSED
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # rich has dropped it already
            return NO_READER
        raise


def _run(argv: list[str] | None) -> int:
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
        return INTERRUPTED


def _drop_unread_output() -> bool:
    """Send output that nobody reads nowhere; returns whether there was such output."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    is_unread = False
    for stream in (sys.stdout, sys.stderr):
        number = stream.fileno()
        poll = select.poll()
        poll.register(number, select.POLLOUT)
        if any(event & select.POLLERR for _, event in poll.poll(0)):
            os.dup2(nowhere, number)
            is_unread = True
    os.close(nowhere)
    return is_unread


def _drop_refused_output(failed: OSError) -> list[str]:
    """Send output that no disk takes nowhere; returns what could not be written, and why."""
    refused = []
    for name, stream in (("standard error", sys.stderr), ("standard output", sys.stdout)):
        if stream is None:
            continue
        try:
            stream.flush()
            is_doubtful = failed.errno in NO_ROOM and failed.filename is None and not refused
            if is_doubtful and stream is sys.stdout:
                stream.write("\n")  # a long text is not kept for `flush`: ask once more
                stream.flush()
        except OSError as error:
            refused.append(f"{name} cannot be written: {error.strerror or error}")
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
    return refused


if __name__ == "__main__":
    sys.exit(main())
