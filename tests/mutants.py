"""Broken files by the hundred, and what a reader says to them.

    for kind, data in mutants(good_bytes, 300, rng): ...
    found = tally(read, good_bytes, "take.csv", tmp_path, 300, rng, contradicts)
    assert not found.wrong and not found.python, found

`contradicts(result, data, said)` gets what the reader made of a mutant, its bytes, and the
warnings, and returns "" or what in the result the file itself denies.
"""

import os
import re
import struct
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import facelab

COUNT = int(os.environ.get("FACELAB_MUTANTS", 100))
"""How many of each file `make test` makes; `make test-all` asks for 300, `make soak` for 2,000."""

PACKAGE = str(Path(facelab.__file__).parent)
PYTHON_WORDS = re.compile(
    r"could not convert|invalid literal|codec can't|Expecting |Extra data|Unterminated string|"
    r"index out of range|is not subscriptable|not iterable|to unpack|buffer of|cannot reshape|"
    r"could not be broadcast|not supported between|has no attribute|string conversion|"
    r"field larger than|end of data|argument must be|unsupported operand|Unable to allocate|"
    r"allow_pickle|zip file|maximum recursion|too large to convert|KeyError|NoneType"
)
STRANGE = (
    *(b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"1e308", b"-1e308", b"1e400", b"1e-400"),
    *(b"1_0", b"0_1.5", "١٢".encode(), "０.５".encode(), b"0x1F", b"", b"-", b".", b"1e", b"--1"),
    *(b"true", b"null", b'"0.25"', b"0,5", b"1.2.3", b"9" * 400, b"99999999999999999999", b"-1"),
    *(b"0", b"1", b"65536", b"4294967296"),
)
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
WORDS = (
    *(struct.pack("<f", v) for v in (float("nan"), float("inf"), 1e38, -1.0)),
    *(struct.pack("<I", v) for v in (0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 24)),
    *(struct.pack("<H", v) for v in (0, 1, 0x7FFF, 0xFFFF)),
)


def mutants(data, n, rng, binary=None):
    """Yield `n` pairs (kind of damage, bytes), none of them equal to `data`.

    Parameters
    ----------
    data : bytes
        A good file.
    rng : numpy Generator
        The same seed gives the same mutants.
    binary : bool, optional
        Damage bytes only, numbers in binary included; else found from the bytes (a NUL in them).
    """
    binary = b"\0" in data if binary is None else binary
    kinds = {**BYTES, **(BINARY if binary else TEXT)}
    names = list(kinds)
    made = 0
    while made < n:
        kind = names[int(rng.integers(len(names)))]
        mutant = bytes(kinds[kind](data, rng))
        if mutant != data:
            made += 1
            yield kind, mutant


def _at(rng, size):
    return int(rng.integers(max(1, size)))


def _span(data, rng, longest=8):
    start = _at(rng, len(data))
    return start, start + 1 + _at(rng, longest)


def _flip(data, rng):
    out = bytearray(data)
    out[_at(rng, len(out))] ^= 1 << _at(rng, 8)
    return out


def _delete(data, rng):
    a, b = _span(data, rng)
    return data[:a] + data[b:]


def _insert(data, rng):
    a = _at(rng, len(data))
    return data[:a] + bytes([_at(rng, 256)]) + data[a:]


def _repeat(data, rng):
    a, b = _span(data, rng, 64)
    return data[:b] + data[a:]


def _cut(data, rng):
    return data[: _at(rng, len(data))]


def _blank(data, rng):
    a, b = _span(data, rng)
    return data[:a] + bytes(len(data[a:b])) + data[b:]


def _word(data, rng):
    word = WORDS[_at(rng, len(WORDS))]
    a = _at(rng, len(data) // len(word)) * len(word)
    return data[:a] + word + data[a + len(word) :]


def _lines(data):
    return data.splitlines(keepends=True)


def _drop_line(data, rng):
    lines = _lines(data)
    del lines[_at(rng, len(lines))]
    return b"".join(lines)


def _double_line(data, rng):
    lines = _lines(data)
    lines.insert(_at(rng, len(lines)), lines[_at(rng, len(lines))])
    return b"".join(lines)


def _swap_lines(data, rng):
    lines = _lines(data)
    a, b = _at(rng, len(lines)), _at(rng, len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return b"".join(lines)


def _join_lines(data, rng):
    ends = [m.start() for m in re.finditer(rb"\r?\n", data)]
    a = ends[_at(rng, len(ends))] if ends else 0
    return data[:a] + data[a:].lstrip(b"\r\n")


def _split_line(data, rng):
    a = _at(rng, len(data))
    return data[:a] + b"\n" + data[a:]


def _numbers(data, rng, change):
    """Change one number, any as likely as another."""
    found = list(NUMBER.finditer(data))
    if not found:
        return data
    m = found[_at(rng, len(found))]
    return data[: m.start()] + change(m[0]) + data[m.end() :]


def _strange_number(data, rng):
    return _numbers(data, rng, lambda _: STRANGE[_at(rng, len(STRANGE))])


def _digit(data, rng):
    def change(number):
        a = _at(rng, len(number))
        return number[:a] + b"%d" % _at(rng, 10) + number[a + 1 :]

    return _numbers(data, rng, change)


def _minus(data, rng):
    return _numbers(data, rng, lambda v: v[1:] if v.startswith(b"-") else b"-" + v)


def _fields(data, rng, change):
    """Change the fields of one line: what stands between commas, semicolons, tabs or blanks."""
    lines = _lines(data)
    at = _at(rng, len(lines))
    parts = re.split(rb"([,;\t ]+)", lines[at].rstrip(b"\r\n"))
    if len(parts) < 3:
        return data
    end = lines[at][len(lines[at].rstrip(b"\r\n")) :]
    lines[at] = b"".join(change(parts, 2 * _at(rng, (len(parts) + 1) // 2))) + end
    return b"".join(lines)


def _swap_fields(data, rng):
    def change(parts, a):
        b = 2 * _at(rng, (len(parts) + 1) // 2)
        parts[a], parts[b] = parts[b], parts[a]
        return parts

    return _fields(data, rng, change)


def _drop_field(data, rng):
    return _fields(data, rng, lambda parts, a: parts[:a] + parts[a + 2 :])


def _double_field(data, rng):
    return _fields(data, rng, lambda parts, a: parts[:a] + [parts[a], parts[1], *parts[a:]])


BYTES = {
    "bit flipped": _flip,
    "bytes deleted": _delete,
    "byte put in": _insert,
    "bytes repeated": _repeat,
    "cut off": _cut,
}
BINARY = {"zeros": _blank, "number in binary": _word}
TEXT = {
    "line dropped": _drop_line,
    "line doubled": _double_line,
    "lines swapped": _swap_lines,
    "lines joined": _join_lines,
    "line split": _split_line,
    "strange number": _strange_number,
    "digit changed": _digit,
    "minus": _minus,
    "fields swapped": _swap_fields,
    "field dropped": _drop_field,
    "field doubled": _double_field,
}


@dataclass
class Verdict:
    """What a reader said: `kind` is "refused", "python" (not in our words) or "accepted"."""

    kind: str
    message: str = ""
    result: object = None
    said: tuple = ()
    seconds: float = 0.0


def verdict(read, data, path):
    """Write `data` to `path`, read it, and judge the answer.

    A refusal is in our words if it is a ValueError, TypeError or FileNotFoundError raised by
    facelab itself, names the file, and repeats nothing that Python or a library says.
    """
    path = Path(path)
    path.write_bytes(data)
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = Verdict("accepted", result=read(path))
        except Exception as error:  # that it may be any is the point
            message = f"{type(error).__name__}: {error}"
            raised = traceback.extract_tb(error.__traceback__)[-1].filename
            ours = (
                isinstance(error, (ValueError, TypeError, FileNotFoundError))
                and raised.startswith(PACKAGE)
                and path.name in message
                and not PYTHON_WORDS.search(message)
            )
            found = Verdict("refused" if ours else "python", message)
    found.said = tuple(str(w.message) for w in caught)
    found.seconds = time.perf_counter() - start
    return found


@dataclass
class Tally:
    """Verdicts counted; `wrong` and `python` hold (kind of damage, bytes, why)."""

    counts: Counter = field(default_factory=Counter)
    wrong: list = field(default_factory=list)
    python: list = field(default_factory=list)
    slowest: float = 0.0

    def __str__(self):
        lines = [", ".join(f"{n} {kind}" for kind, n in self.counts.most_common())]
        lines += [f"wrong: {kind}: {why}" for kind, _, why in self.wrong[:8]]
        lines += [f"in Python's words: {kind}: {why}" for kind, _, why in self.python[:8]]
        return "\n".join([*lines, f"slowest {self.slowest:.2f} s"])


def tally(read, data, name, folder, n, rng, contradicts, binary=None):
    """Read `n` mutants of `data` under the file name `name` and count the verdicts."""
    found = Tally()
    path = Path(folder) / name
    for kind, mutant in mutants(data, n, rng, binary):
        v = verdict(read, mutant, path)
        found.slowest = max(found.slowest, v.seconds)
        why = contradicts(v.result, mutant, v.said) if v.kind == "accepted" else ""
        found.counts["wrong" if why else v.kind] += 1
        if why:
            found.wrong.append((kind, mutant, why))
        elif v.kind == "python":
            found.python.append((kind, mutant, v.message))
    return found
