"""One file or many: what is done is skipped, what fails is told, the rest goes on."""

import contextlib
import json
import math
import time
import traceback
import warnings
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from facelab.cli.terminal import complain, plain, say, watched
from facelab.storage import atomic_path, check_writable

NAMED = ("rig", "template", "landmarks", "rest", "model", "source", "into")
"""Options that name a file to be read, beside the inputs."""

DONE, FAILED, WRONG, STOPPED = 0, 1, 2, 130
"""Exit codes: all done, some failed, wrong usage, stopped by Ctrl+C."""

EXPECTED = (ValueError, TypeError, OSError, RuntimeError, MemoryError)
"""What files and arguments may cause; all else is a fault of ours."""


class UsageError(Exception):
    """What was asked for makes no sense; the message says why."""


@dataclass(frozen=True)
class Job:
    """One result: the files (or folders) that it is made from, and where it goes.

    `needs` are files that options name: a rig, a template.
    """

    sources: tuple
    target: Path
    needs: tuple = ()

    @property
    def done(self):
        """Whether the result is there, and not older than what it is made from."""
        try:
            made = self.target.stat().st_mtime
            read = (*self.sources, *self.needs)
            parts = [p for s in read for p in (s, *(s.glob("*") if s.is_dir() else ()))]
            return self.target.is_file() and all(p.stat().st_mtime <= made for p in parts)
        except OSError:  # not there, or not to be looked at: to be done, or to be told why not
            return False

    @property
    def label(self):
        """What it is made from, in words."""
        more = f" and {len(self.sources) - 1} more" * (len(self.sources) > 1)
        return f"{self.sources[0]}{more}"


@dataclass
class Report:
    """What became of all jobs; `as_dict` for JSON."""

    command: str
    arguments: list
    done: list = field(default_factory=list)
    skipped: list = field(default_factory=list)
    failed: list = field(default_factory=list)
    not_reached: list = field(default_factory=list)
    passed_over: list = field(default_factory=list)
    stopped: bool = False

    @property
    def exit_code(self):
        """0 all done, 1 some failed or were not reached, 130 stopped."""
        return STOPPED if self.stopped else FAILED if self.failed or self.not_reached else DONE

    @property
    def words(self):
        """One line that says how it went."""
        parts = [f"{len(self.done)} done"]
        for what, name in (
            (self.skipped, "skipped (done before; --again makes them anew)"),
            (self.failed, "failed"),
            (self.not_reached, "not reached"),
            (self.passed_over, "passed over (other kinds of file)"),
        ):
            parts += [f"{len(what)} {name}"] * bool(what)
        return ("stopped: " if self.stopped else "") + ", ".join(parts)

    def as_dict(self):
        """All of it, ready for JSON: numbers that are none are null."""
        about = {"format": "facelab-report", "version": 1}
        return about | _ready({f.name: getattr(self, f.name) for f in fields(self)})

    def write(self, path):
        """Write it as JSON, whole or not at all."""
        with atomic_path(path) as part:
            part.write_text(json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n")


def _ready(value):
    """A value that JSON can hold."""
    if isinstance(value, dict):
        return {str(k): _ready(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_ready(v) for v in value]
    if isinstance(value, np.generic):
        return _ready(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, (int, str, bool, type(None))) else str(value)


# --- from arguments to jobs -----------------------------------------------------------------------


def plan(
    inputs, out, endings, results, to, report, together=False, folders_are_files=False, needs=()
):  # fmt: skip
    """The jobs that arguments ask for.

    Parameters
    ----------
    inputs : list of Path
        Files, or folders, of which all files with one of the endings are taken.
    out : Path
        A file for one file; else a folder, made if it is not there.
    endings : tuple of str
        Of files that the command reads.
    results : tuple of str
        Endings that it writes.
    to : str or None
        That of the results in a folder; the first of `results` if None.
    report : Report
        Gets the names of files that were passed over.
    together : bool, default=False
        All inputs make one result where `out` is a file.
    folders_are_files : bool, default=False
        A folder is one input, such as a rig as OBJ files.
    needs : tuple of Path, default=()
        Files that all results are made from too.

    Raises
    ------
    UsageError
        For what is not there, no files, or an output that does not go with the inputs.
    """
    files, many = [], len(inputs) > 1
    for path in inputs:
        if not path.exists():
            raise UsageError(f"{path} is not there.")
        if folders_are_files or not path.is_dir():
            files.append(path)
        else:
            files += _files_of(path, endings, report)
            many = True
    is_file = out.suffix.lower() in results and not out.is_dir()
    if is_file and (together or not many):
        if to is not None and out.suffix.lower() != f".{to}":
            raise UsageError(f"--to {to} does not go with -o {out}; leave one of them out.")
        jobs = [Job(tuple(files), out, needs)]
    elif is_file:
        raise UsageError(f"-o {out} is one file, but there are several inputs: name a folder.")
    elif out.suffix and not out.is_dir() and not many:
        kinds = ", ".join(results)
        raise UsageError(f"-o {out}: a result ends in {kinds}; the name of a folder in none.")
    else:
        ending = results[0] if to is None else f".{to}"
        jobs = [Job((f,), out / f"{f.stem}{ending}", needs) for f in files]
    return jobs


def refuse_overwriting(jobs, written, report, out):
    """Refuse results that would take the place of what is read, and a report in that of either.

    Parameters
    ----------
    jobs : list of Job
    written : callable
        Takes the target of a job: all files that it writes.
    report : Path or None
    out : Path
        As it was given, for the message.

    Raises
    ------
    UsageError
    """
    paths = {p for job in jobs for p in (*job.sources, *job.needs)}
    folders = [p for p in paths if p.is_dir()]
    shapes = [f for p in folders for f in p.iterdir() if f.suffix.lower() == ".obj"]
    read = {_identity(p) for p in (*paths, *shapes)}
    results = [p for job in jobs for p in written(job.target)]
    same = [p for p in results if _identity(p) in read]
    if same:
        raise UsageError(f"-o {out} would overwrite {same[0]}, which is read; choose another.")
    among = {_identity(p) for p in folders}
    more = [p for p in results if p.suffix.lower() == ".obj" and _identity(p.parent) in among]
    if more:
        raise UsageError(
            f"-o {out} would put {more[0].name} among the shapes of a rig; choose another folder."
        )
    if report is not None and _identity(report) in read | {_identity(p) for p in results}:
        raise UsageError(
            f"--report {report} would overwrite a file that is read, or a result; choose another."
        )


def needed(options):
    """The files that options name, to be read beside the inputs: tuple of Path."""
    named = [getattr(options, name, None) for name in NAMED]
    return tuple(Path(path) for path in named if isinstance(path, str))


def _identity(path):
    """What all names of a file have in common."""
    try:
        found = path.stat()
        return found.st_dev, found.st_ino
    except OSError:  # not there yet
        return str(path.resolve()).casefold()


def _files_of(folder, endings, report):
    """The files of a folder that have one of the endings, hidden ones left alone."""
    found = sorted(f for f in folder.iterdir() if not f.is_dir() and f.name[0] != ".")
    good = [f for f in found if f.suffix.lower() in endings]
    report.passed_over += [str(f) for f in found if f not in good]
    if not good:
        raise UsageError(f"{folder} holds no file of the kinds {', '.join(endings)}.")
    return good


# --- running them ---------------------------------------------------------------------------------


def run(jobs, make, report, options, doing=None):
    """Do the jobs: the exit code.

    Parameters
    ----------
    jobs : list of Job
    make : callable
        Takes a job, writes its result and returns a dict of numbers.
    report : Report
    options : argparse.Namespace
        `again`, `quiet` and `report`.
    doing : callable, optional
        Takes the jobs that are left to do and yields them, as they are done, with an `Outcome`, or
        None where one was not reached; one after the other, here, if left out.
    """
    if options.report is not None:
        _for_writing(options.report)
    for folder in {job.target.parent for job in jobs}:
        make_folder(folder)
    left = _left(jobs, report, options)
    doing = doing or (lambda jobs: ((job, attempt(job, make)) for job in jobs))
    done = len(jobs) - len(left)
    bar = tqdm(total=len(jobs), initial=done, unit="file", disable=not watched(options))
    try:
        for job, outcome in doing(list(left)):
            if outcome is None:
                continue
            left.remove(job)
            _told(job, outcome, report, options)
            bar.update()
    except KeyboardInterrupt:
        report.stopped = True
    finally:
        bar.close()
    report.not_reached += [job.label for job in left]
    say(f"facelab {report.command}: {report.words}")
    if options.report is not None:
        report.write(options.report)
    return report.exit_code


def fail_all(jobs, error, report, options):
    """Say why no job can be begun (a rig that cannot be read), in the report too: the exit code."""
    if options.report is not None:
        _for_writing(options.report)
    complain(f"facelab: {_reason(error)}")
    for job in jobs:
        entry = {"input": job.label, "output": str(job.target)}
        report.failed.append(entry | {"reason": plain(_reason(error)), "warnings": []})
    if options.report is not None:
        report.write(options.report)
    return report.exit_code


def _left(jobs, report, options):
    """The jobs that are to be done; those done before and those that clash are reported."""
    taken, left = {}, []
    for job in jobs:
        # file systems may not tell cases apart
        first = taken.setdefault(str(job.target).casefold(), job)
        if first is not job:
            why = f"{first.label} makes {job.target} already; give one of them another name."
            _failed(report, job, why, [])
        elif job.done and not options.again:
            report.skipped.append({"input": job.label, "output": str(job.target)})
        else:
            left.append(job)
    return left


def make_folder(folder):
    """Make a folder if it is not there; refused as wrong usage where that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = error.strerror or type(error).__name__
        raise UsageError(f"the folder {folder} cannot be made: {why}.") from None


def _for_writing(path):
    try:
        check_writable(path)
    except (OSError, ValueError) as error:
        raise UsageError(f"--report: {error}") from None


@dataclass
class Outcome:
    """What became of one job: numbers, or why there are none; what was warned of; seconds."""

    numbers: dict
    why: str
    warnings: list
    seconds: float
    trace: list = field(default_factory=list)


def attempt(job, make):
    """One job done, or why not: Outcome. It goes as it is from a worker to where it was asked."""
    start = time.perf_counter()
    numbers, why, trace = {}, None, []
    with heard() as said:
        try:
            numbers = _ready(make(job))
        except EXPECTED as error:
            why = _reason(error)
        except Exception as error:  # a fault of facelab's: the rest goes on all the same
            why = f"a fault of facelab itself, please report it: {type(error).__name__}: {error}"
            trace = traceback.format_exc().splitlines()
    return Outcome(numbers, why, said, round(time.perf_counter() - start, 3), trace)


def _told(job, outcome, report, options):
    """The outcome of a job, in the terminal and in the report."""
    for text in outcome.warnings:
        complain(f"warning: {job.label}: {text}")
    for line in outcome.trace:
        complain(line)
    if outcome.why is not None:
        _failed(report, job, outcome.why, outcome.warnings)
        return
    entry = {
        "input": job.label, "output": str(job.target),
        "seconds": outcome.seconds, "warnings": outcome.warnings,
    }  # fmt: skip
    report.done.append(entry | outcome.numbers)
    if not options.quiet:
        say(f"{job.label} -> {job.target}: {_shown(outcome.numbers)}")


@contextlib.contextmanager
def heard():
    """What is warned of inside: the list that is given holds it at the end, each text once."""
    said = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield said
        finally:
            said += dict.fromkeys(plain(w.message) for w in caught)


@contextlib.contextmanager
def told(label):
    """What is warned of inside becomes lines on stderr."""
    said = []
    try:
        with heard() as said:
            yield
    finally:
        for text in said:
            complain(f"warning: {label}: {text}")


def _reason(error):
    if isinstance(error, MemoryError):
        return "not enough memory; give fewer frames or vertices at a time."
    return str(error) or type(error).__name__


def _failed(report, job, why, said):
    report.failed.append(
        {"input": job.label, "output": str(job.target), "reason": plain(why), "warnings": said}
    )
    place = "" if str(why).startswith(str(job.sources[0])) else f"{job.label}: "
    complain(f"failed: {place}{why}")


def _shown(numbers):
    """The numbers of a result that fit on a line."""
    some = [(k.replace("_", " "), v) for k, v in numbers.items() if np.isscalar(v)]
    short = [(k, v) for k, v in some if not isinstance(v, str) and v == v]  # NaN is no news
    return ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in short)
