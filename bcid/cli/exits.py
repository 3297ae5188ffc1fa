"""How a command ends: one table from what went wrong to a message, a next step and an exit code."""

from __future__ import annotations

import io
import os
import signal
import sys
from _thread import interrupt_main
from collections.abc import Callable
from contextlib import suppress
from difflib import get_close_matches
from threading import Timer
from types import FrameType

from typer.exceptions import Abort, TyperException

from bcid.cli.limits import LIMITS
from bcid.cli.options import Format
from bcid.errors import BcidError, DiskFull, OutputClosed, UsageError, is_disk_full, printable
from bcid.libraries import EXTRAS, library_missing

UNINTERRUPTIBLE = ("llvmlite", "numba.core.serialize")
"""Modules that machine code calls and that no exception may leave: a call back of LLVM's, a constant of a kernel's."""
INTERRUPTED = 128 + signal.SIGINT
"""Exit code after Ctrl-C, by the shells' convention: 128 and the signal's number."""
STOPPING = "interrupted: what was finished is kept, nothing is half-written; the same command goes on from there"
"""What is said on Ctrl-C."""
ENDED = 128 + signal.SIGTERM
"""Exit code of a run that was told to end."""


def run_and_explain(command: Callable[[], object]) -> int:
    """Run `command`; an error, or Ctrl-C, becomes one message on stderr.  Returns the exit code.

    With BCID_TRACEBACK in the environment an internal error is raised as it is.
    """
    _replace_closed_streams()
    with _Interrupts() as interrupts:
        try:
            # the help and the version end by an exit code, all else returns None
            code = command()
            sys.stdout.flush()
            exit_code = code if isinstance(code, int) else 0
            return _tell_interrupted(interrupts) if exit_code == INTERRUPTED else exit_code
        except (KeyboardInterrupt, Abort):
            return _tell_interrupted(interrupts)
        except SystemExit as ended:
            return ended.code if isinstance(ended.code, int) else 1
        except Exception as error:
            if interrupts.swallowed:
                return _tell_interrupted(interrupts)
            text, exit_code = describe_error(error)
            if exit_code == BcidError.exit_code and os.environ.get("BCID_TRACEBACK"):
                raise
            _drop_what_cannot_be_printed()
            if text:
                _tell_error(text)
            return exit_code


class _Interrupts:
    """Ctrl-C and SIGTERM while a command runs: one exception, also where Python or a compiler cannot do with one."""

    def __enter__(self) -> _Interrupts:
        """Take over the signals that end a command."""
        self.swallowed, self.acknowledged, self._hook = False, False, sys.unraisablehook
        sys.unraisablehook = self._pass_on
        self._handlers = [(n, signal.getsignal(n)) for n in (signal.SIGINT, signal.SIGTERM)]
        for number, handler in self._handlers:
            # not what whoever started this process ignores
            if handler in (signal.default_int_handler, signal.SIG_DFL):
                signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *error: object) -> None:
        """Leave the signals as they were."""
        sys.unraisablehook = self._hook
        for number, handler in self._handlers:
            signal.signal(number, handler)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt or, told to end, SystemExit: later where machine code waits that it would crash."""
        if number == signal.SIGINT:
            self._acknowledge()
        while frame is not None:
            if str(frame.f_globals.get("__name__")).startswith(UNINTERRUPTIBLE):
                again = Timer(LIMITS.interrupt_retry_s, interrupt_main, (number,))
                again.daemon = True
                again.start()
                return
            frame = frame.f_back
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(ENDED)

    def _acknowledge(self) -> None:
        """Say at once that the command stops, and that nothing is lost: what runs now may take seconds to end.

        Written straight to stderr, since a signal may come while something is being printed.
        """
        if not self.acknowledged:
            self.acknowledged = True
            with suppress(OSError):
                # a terminal has just shown ^C
                os.write(2, f"{os.linesep if os.isatty(2) else ''}{STOPPING}\n".encode())

    def _pass_on(self, ignored: sys.UnraisableHookArgs) -> None:
        """Interrupt once more after an interruption that was ignored; hand on any other ignored exception."""
        if issubclass(ignored.exc_type, KeyboardInterrupt):
            self.swallowed = True
            interrupt_main()
        else:
            self._hook(ignored)


def _tell_error(text: str) -> None:
    """Print an error on stderr."""
    from bcid.cli.sink import Sink

    Sink(Format.quiet).error(text)


def _tell_interrupted(interrupts: _Interrupts) -> int:
    """Say on stderr that the command was interrupted, unless that was said when it was; returns the exit code."""
    if not interrupts.acknowledged:
        # not before: one that was put off may come in the middle of an import
        from bcid.cli.sink import Sink

        Sink(Format.human).note(STOPPING)
    return INTERRUPTED


def describe_error(error: Exception) -> tuple[str, int]:
    """The message for people, with its next step, and the exit code, of an error that ends a command."""
    if isinstance(error, BcidError):
        return str(error), error.exit_code
    if isinstance(error, TyperException):
        return _describe_usage_error(error), UsageError.exit_code
    if isinstance(error, ModuleNotFoundError) and error.name and (name := error.name.partition(".")[0]) in EXTRAS:
        return describe_error(library_missing(name, "this command"))
    if isinstance(error, OSError):
        if is_disk_full(error):
            return str(DiskFull(_place_of(error) or "stdout")), DiskFull.exit_code
        if error.filename is not None:
            next_step = "check the path and its permissions"
            return f"{_place_of(error)}: {error.strerror}\n  next: {next_step}", DiskFull.exit_code
    text = f"internal error, {type(error).__name__}: {error}"
    return f"{text}\n  next: run again with BCID_TRACEBACK=1 and report it", BcidError.exit_code


def _place_of(error: OSError) -> str:
    """The file that an error of the operating system is about; empty where it names none."""
    return "" if error.filename is None else printable(os.fsdecode(error.filename), "")


def _describe_usage_error(error: TyperException) -> str:
    """What is wrong with the words of a command, the nearest right ones, and where all of them are listed."""
    text = error.format_message().strip()
    context = getattr(error, "ctx", None)
    if not text:
        # the bare `bcid`, whose help is printed already
        return text
    wrong, known = getattr(error, "option_name", None), [] if context is None else context.command.params
    if wrong and context is not None and not getattr(error, "possibilities", None):
        names = [name for p in known for name in p.opts if name.startswith("-")]
        near = get_close_matches(wrong, names, n=2)
        text += f" (did you mean {' or '.join(near)}?)" if near else f" (there are {', '.join(names)})"
    command = "bcid" if context is None else context.command_path
    return f"{text}\n  next: {command} --help explains what there is"


class _ClosedStream(io.TextIOBase):
    """A stdout that leads nowhere, since the process was started without one."""

    def write(self, text: str) -> int:
        """Refuse to lose what is printed."""
        raise OutputClosed


def _replace_closed_streams() -> None:
    """Where the process was started without stdout or stderr, keep their numbers from the next files to be opened."""
    if sys.stdout is None:
        _send_to_nowhere(1)
        sys.stdout = _ClosedStream()
    if sys.stderr is None:
        _send_to_nowhere(2)
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115  # for the whole process


def _drop_what_cannot_be_printed() -> None:
    """Let go what is left in the buffer of stdout and cannot be written, as it would fail once more at the end."""
    try:
        sys.stdout.flush()
    except (OSError, OutputClosed):
        _send_to_nowhere(1)


def _send_to_nowhere(number: int) -> None:
    """Let the file descriptor `number` lead to the null device."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
