"""Common parts of command-line programs: printing of errors, exit statuses, numbers as options, trainings' folders."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
from collections.abc import Callable, Mapping
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec

from litsim_sim.core.errors import (
    EXIT_FAILED,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    InputError,
    not_installed,
    print_error,
    refused,
    without_ros,
)
from litsim_sim.io.files import make_folder
from litsim_sim.launch.signals import SIGNALS

P = ParamSpec("P")

RUN_STATUS_HELP = "Exit status: 0, the run is valid; 1, it is not, and stderr says why; 2, bad input."
"""Help of programs that end with :func:`run_status`."""

NOT_OF_RUNS = ("lightning", "onnx", "torch")
"""Libraries for training, which `make setup` does not install."""
OF_ROS = re.compile("ament_index_python|domain_coordinator|rclpy|.*_(interfaces|msgs|srvs)")
"""Names of modules of ROS and of messages, which an installation by pip does not have; see :mod:`.verbs`."""


def program(main: Callable[P, int | None]) -> Callable[P, None]:
    """Decorator that makes `main` the entry point of a program, which returns on success and else exits.

    Args:
        main: returns the exit status, or None for 0. An :class:`InputError` that it raises, or a missing library for
            training or of ROS, is one line on stderr and status 2, and so is a path that the system refuses; Ctrl-C is
            status 130 without a traceback; a closed output pipe, as with `head`, is status 1 without a message.
    """

    @wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        for name in ("stdout", "stderr"):  # None if whoever has started this process has closed it
            if getattr(sys, name) is None:
                setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115 - as long as the process lives
        try:
            status = main(*args, **kwargs)
            sys.stdout.flush()
        except InputError as error:
            print_error(error)
            status = EXIT_INPUT
        except ModuleNotFoundError as error:
            missing = (error.name or "").split(".")[0]
            of_ros = OF_ROS.fullmatch(missing)
            if not of_ros and missing not in NOT_OF_RUNS:
                raise
            print_error(without_ros(missing) if of_ros else not_installed(missing))
            status = EXIT_INPUT
        except KeyboardInterrupt:
            status = EXIT_INTERRUPTED
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else flushing at exit would fail again
            status = EXIT_FAILED
        except OSError as error:
            if (why := refused(error)) is None:
                raise
            print_error(why)
            status = EXIT_INPUT
        if status:
            sys.exit(status)

    return run


def run_status(metrics: Mapping[str, Any], what: object) -> int:
    """Returns the exit status of a program that has measured a run: EXIT_FAILED if its `metrics` say it is not valid.

    An error on stderr then says why, of the run called `what`.
    """
    if metrics["valid"]:
        return 0
    print_error(f"{what}: the run is not valid: {metrics['why']}")
    return EXIT_FAILED


def interrupt_on_signals() -> None:
    """Let SIGTERM, and SIGHUP unless nohup ignores it, act like Ctrl-C: end all started processes in order.

    SIGINT is set too, since background jobs of scripts ignore it.
    """
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def training_folder(out: Path, checkpoint: str, *, resume: bool) -> None:
    """Make the output folder of a training, in which `checkpoint` is the name of the file to resume from.

    Raises:
        InputError: the folder cannot be made, or holds a training that would be lost.
    """
    if (out / checkpoint).exists() and not resume:
        raise InputError(f"{out}: holds a training already; --resume continues it")
    make_folder(out)


def print_how_to_resume() -> None:
    """Tell on stderr how an interrupted training is continued."""
    print("\ninterrupted; to continue: the same command with --resume", file=sys.stderr)


def at_least_one(text: str) -> int:
    """Returns a number of processes from the text of an option; raises ArgumentTypeError if it is none."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number of at least 1")
    return int(text)
