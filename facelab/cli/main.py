"""The command `facelab`: arguments read, one command called, an exit code given back."""

import argparse
import importlib
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from facelab.cli import course
from facelab.cli.batch import (
    EXPECTED,
    FAILED,
    STOPPED,
    WRONG,
    Report,
    UsageError,
    fail_all,
    needed,
    plan,
    refuse_overwriting,
    run,
    told,
)
from facelab.cli.terminal import complain, hushed, spell_out

COMMANDS = {
    "register": "takes of markers become a mesh in motion (npz), or an animated GLB",
    "train": "takes (markers, motion, or weights with --rig) become a model (npz)",
    "segment": "the face of a take cut into regions (npz or JSON), and a PLY in their colours",
    "read-units": "sketches or motion on a rig's vertices become weights of its units (CSV)",
    "translate": "takes of one rig become takes of another (CSV), with the error in millimetres",
    "pose": "poses kept in the lab (JSON) become meshes (OBJ, PLY, GLB); clips an animated GLB",
    "convert": "one kind of file becomes another: meshes, weights, markers, rigs, motion",
}
"""What makes files of files, in a line. Each has a module, imported when it is called for: some
take seconds, and help should not. It has an example, options, endings and a `maker`."""

ABOUT = """\
Faces that move linearly, from the command line. A file in, a file out; a folder in, a folder out:
what is done already is skipped, what fails is listed and does not stop the rest.
"""
EXIT_CODES = "exit codes: 0 all done, 1 some failed, 2 wrong usage, 130 stopped by Ctrl+C"


def main(argv=None):
    """Run one command: its exit code.

    Parameters
    ----------
    argv : list of str, optional
        Arguments; those of the process if left out.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    code = FAILED
    spell_out()
    with hushed():
        try:
            code = _command(argv)
        except SystemExit as end:  # argparse: help, or wrong usage
            code = end.code
        except UsageError as error:
            complain(f"facelab: {error}")
            code = WRONG
        except KeyboardInterrupt:
            complain("facelab: stopped.")
            code = STOPPED
        except (ValueError, TypeError, OSError, RuntimeError) as error:
            if isinstance(error, BrokenPipeError):
                raise
            complain(f"facelab: {error}")
        sys.stdout.flush()
    return code


def _command(argv):
    options = _parser(argv).parse_args(argv)
    if options.command in course.COMMANDS:
        return course.COMMANDS[options.command](options)
    command = _module(options.command)
    report = Report(options.command, argv)
    endings = command.reads(options) if hasattr(command, "reads") else command.READS
    jobs = plan(
        options.inputs, options.out, endings, command.WRITES, options.to, report,
        together=getattr(command, "TOGETHER", False),
        folders_are_files=hasattr(command, "single") and command.single(options),
        needs=needed(options),
    )  # fmt: skip
    written = getattr(command, "written", lambda target: [target])
    refuse_overwriting(jobs, written, options.report, options.out)
    try:
        with told(options.command):
            make = command.maker(options)
    except EXPECTED as error:
        return fail_all(jobs, error, report, options)
    if options.scheduler is None and options.workers is None:
        return run(jobs, make, report, options)
    from facelab.cli.spread import on_workers

    return run(jobs, make, report, options, on_workers(argv, options))


def maker_of(argv):
    """What does one job of a command line: a worker makes it anew from the same arguments."""
    options = _parser(argv).parse_args(argv)
    options.quiet = True
    return _module(options.command).maker(options)


def _module(command):
    return importlib.import_module(f"facelab.cli.{command.replace('-', '_')}")


def _parser(argv):
    """All commands in a line each, and the one that is called for with all its options."""
    called = next((a for a in argv if not a.startswith("-")), None)
    parser = argparse.ArgumentParser(
        prog="facelab", description=ABOUT, epilog=EXIT_CODES, allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"facelab {_version()}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        if name != called:
            commands.add_parser(name, help=text)
            continue
        command = _module(name)
        own = _add(commands, name, text, command.EXAMPLE)
        own.add_argument("inputs", nargs="+", type=_path, metavar="INPUT", help="files or folders")
        own.add_argument("-o", "--out", type=_path, required=True, help="a file or a folder")
        kinds = [ending[1:] for ending in command.WRITES]
        own.add_argument("--to", choices=kinds, help=f"kind of results in a folder ({kinds[0]})")
        own.add_argument("--again", action="store_true", help="make what is there anew")
        own.add_argument("--report", type=_path, metavar="JSON", help="what became of each file")
        own.add_argument("--quiet", action="store_true", help="only say what failed, and the sum")
        many = own.add_argument_group("many processes or machines (pip install 'facelab[scale]')")
        many.add_argument("--workers", type=int, metavar="N", help="processes on this machine")
        many.add_argument("--scheduler", metavar="ADDRESS", help="of Dask, with its own workers")
        command.add_options(own)
    course.add_commands(lambda name, text, example: _add(commands, name, text, example))
    return parser


def _path(text):
    if not text:  # a variable of the shell that is not set: it would be the folder one is in
        raise argparse.ArgumentTypeError("the name is empty")
    return Path(text)


def _add(commands, name, text, example):
    return commands.add_parser(
        name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=example + EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False,
    )  # fmt: skip


def _version():
    try:
        return version("facelab")
    except PackageNotFoundError:  # in a source tree that is not installed
        return "(not installed)"
