"""Weights in JSON and npz: names beside a matrix, frames one by one, or a column for each name."""

import json

import numpy as np

from facelab.files.npz import stored_rate
from facelab.files.takes.columns import weight_columns
from facelab.files.takes.recording import Recording
from facelab.files.words import listed
from facelab.names import normalised
from facelab.storage import StoredArrays, existing_file

_MOST = 200e6  # bytes of JSON that are read: each number in it takes three times its room
_NPZ = "npz file of weights"
_NAMES = ("names", "facsnames", "blendshapenames", "blendshapes", "shapes", "channels", "columns")
_WEIGHTS = ("weights", "weightmat", "values", "blendshapes", "blendshapeweights", "coefficients")
_WEIGHTS += ("faceblendshapes", "categories")
_TIMES = {"time": 1, "timecode": 1, "timestamp": 1, "timestampms": 1000}  # how many make a second
_ALL_TIMES = ("times", "timestamps")
_VALUES = (int, float)
_HEAD = ("headindex", "headname")  # what MediaPipe writes beside categories
_ROWS = (*_WEIGHTS, "frames", "data")
_FPS = ("fps", "exportfps", "framerate")
_WHOLE = (b"{}", b"[]")  # a line that begins and ends so is a text of JSON by itself
_COUNTS = {"numframes": 0, "framecount": 0, "nframes": 0, "numposes": 1, "numblendshapes": 1}


def _recording(path, header, matrix, names, fps=None, codes=None, left_out=()):
    """A recording of a matrix with a name for each column, time among them."""
    columns = weight_columns(header, f"{path}", names)
    numbers = list(columns.numbers)
    found = Recording(
        path=path,
        names=list(columns.numbers.values()),
        values=matrix[:, numbers],
        rows=list(range(len(matrix))),
        what="frame",
        codes=codes,
        fps=fps,
        others={name: matrix[:, k] for k, name in columns.others.items()},
    )
    if codes is None and columns.time is not None:
        seconds = matrix[:, columns.time] / (1000 if columns.milliseconds else 1)
        found.codes = _as_codes(seconds)
    if columns.frame is not None:
        frames = matrix[:, columns.frame]
        if (frames % 1 != 0).any():
            row = int(np.flatnonzero(frames % 1 != 0)[0])
            raise ValueError(f"{path}, frame {row}: frame number {frames[row]} is none.")
        found.frames = frames.astype(int).tolist()
    if left_out:
        found.warned.append(f"no numbers for each frame, left out: {', '.join(left_out)}")
    return found


def _as_codes(seconds):
    return [f"{s:.9f}".rstrip("0") for s in seconds.tolist()]


# --- JSON -----------------------------------------------------------------------------------------


def read_json_recording(path, names=None):
    """The rows of a JSON file of weights; see `read_weights` for its forms."""
    path = existing_file(path, "JSON file of weights")
    if path.stat().st_size > _MOST:
        raise ValueError(
            f"{path}: {path.stat().st_size / 1e6:.0f} MB of JSON, and at most {_MOST / 1e6:.0f} "
            "are read; write an npz or CSV file."
        )
    content = _parsed(path)
    if isinstance(content, list):
        return _of_frames(path, content, names, None, None)
    if not isinstance(content, dict):
        raise ValueError(
            f"{path}: neither names nor frames on top; see read_weights for its forms."
        )
    inner = {k: v for k, v in content.items() if isinstance(v, dict)}
    keys = {normalised(k): v for part in (*inner.values(), content) for k, v in part.items()}
    fps = next((keys[k] for k in _FPS if k in keys), None)
    if fps is not None:
        fps = _number(fps, f"{path}: frames a second")
        if fps <= 0:
            raise ValueError(f"{path}: {fps:g} frames a second; it must be more than 0.")
    shapes = next((keys[k] for k in _NAMES if _is_list_of(keys.get(k), str)), None)
    rows = next(
        (keys[k] for k in _ROWS if _is_list_of(keys.get(k), (list, dict, type(None)))), None
    )
    if rows is not None:
        _refuse_several(path, inner, rows)
        times = next((keys[k] for k in _ALL_TIMES if _is_list_of(keys.get(k), (int, float))), None)
        found = _of_frames(path, rows, names, shapes, fps, times)
        beside = {k: v for part in (*inner.values(), content) for k, v in part.items()}
        unread = [
            k for k, v in beside.items() if _is_list_of(v, (*_VALUES, list)) and v is not rows
        ]
        unread = [k for k in unread if len(beside[k]) == len(rows) and beside[k] is not times]
        if unread := [k for k in unread if beside[k] is not shapes and len(rows) > 1]:
            found.warned.append(f"as long as the frames and left out: {listed(unread)}")
    else:
        found = _of_columns(path, content, names, fps)
    for key, axis in _COUNTS.items():
        size = (len(found.rows), len(found.names) + len(found.others))[axis]
        if key in keys and keys[key] != size:
            raise ValueError(
                f"{path}: it says {key}={keys[key]!r}, but holds {size}; it was cut or edited."
            )
    return found


def _refuse_several(path, inner, rows):
    """Where several tables have weights of their own, none of them is the one that is meant."""
    held = [
        name
        for name, part in inner.items()
        if any(normalised(k) in _ROWS and _is_list_of(v, (list, dict)) for k, v in part.items())
    ]
    if len(held) > 1 and any(rows is v for name in held for v in inner[name].values()):
        raise ValueError(
            f"{path}: {listed(held)} each hold weights, and one is read; write each to a file of "
            "its own."
        )


def _parsed(path):
    """What a file holds, or a list of what each of its lines does."""
    text = path.read_bytes()
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines()) if line.strip()]
    by_line = path.suffix.lower() in (".jsonl", ".ndjson")
    if by_line or (len(lines) > 1 and all(line[:1] + line[-1:] in _WHOLE for _, line in lines)):
        return [_value(path, line, k) for k, line in lines]
    return _value(path, text)


def _value(path, text, above=0):
    """The value of a JSON text, below so many lines of its file."""

    def unique(pairs):
        keys = [k for k, _ in pairs]
        twice = sorted({k for k in keys if keys.count(k) > 1}) if len({*keys}) < len(keys) else []
        if twice:
            raise _OursError(f"{path}: {', '.join(twice)} stand more than once in one table.")
        return dict(pairs)

    def constant(word):
        raise _OursError(f"{path}: {word} is no number; write null where a face was lost.")

    def whole(digits):
        return int(digits) if len(digits) < 16 else float(digits)

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=constant, parse_int=whole)
    except _OursError as error:
        raise ValueError(str(error)) from None
    except json.JSONDecodeError as error:
        raise ValueError(
            f"{path}, line {above + error.lineno}, column {error.colno}: no JSON from here on; the "
            "file is cut or damaged."
        ) from None
    except (UnicodeDecodeError, RecursionError):
        raise ValueError(f"{path}: no JSON text; the file is damaged or of another kind.") from None


class _OursError(Exception):
    """Refusals from within the parser."""


def _is_list_of(value, kinds):
    return isinstance(value, list) and bool(value) and all(isinstance(v, kinds) for v in value)


def _number(value, place):
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ValueError(f"{place}: {str(value)[:40]!r} ({type(value).__name__}) is no number.")
    return float(value)


def _numbers(values, places):
    """Numbers of a list, NaN for null."""
    pairs = zip(values, places, strict=True)
    return [np.nan if value is None else _number(value, place) for value, place in pairs]


def _of_frames(path, rows, names, shapes, fps, times=None):
    """Frames one by one: lists beside `shapes`, or tables of names, bare or under a word."""
    header, read, codes, left_out = shapes and list(shapes), [], [], set()
    for i, row in enumerate(rows):
        place = f"{path}, frame {i}"
        row, beside = _opened(row, place)
        if _is_list_of(row, (dict, list)):
            raise ValueError(
                f"{place} holds {len(row)} lists or tables, as of {len(row)} faces, but must hold "
                "the weights of one; write each face to a file of its own."
            )
        if isinstance(row, dict):
            left_out |= {k for k, v in row.items() if not _is_scalar(v)}
            row = {k: v for k, v in row.items() if _is_scalar(v)}
            header = header or list(row)
            if row and {*row} != {*header}:
                odd = sorted({*row} ^ {*header})
                raise ValueError(f"{place} has not the names of the first: {listed(odd)}.")
            row = [row[name] for name in header] if row else []
        if not isinstance(row, list) and row is not None:
            raise ValueError(f"{place} is a {type(row).__name__}, but must hold weights.")
        if row and not header:
            raise ValueError(f"{path}: weights without names; a list of names must stand beside.")
        if row and len(row) != len(header):
            raise ValueError(f"{place} has {len(row)} weights for {len(header)} names.")
        time = [k for k in beside if normalised(k) in _TIMES]
        codes += [_code(beside[k], normalised(k), f"{place}, {k}") for k in time[:1]]
        left_out |= {*beside} - {*time[:1]}
        read.append(row and _numbers(row, [f"{place}, {name}" for name in header]))
    if not codes and times is not None:
        if len(times) != len(rows):
            raise ValueError(f"{path}: {len(times)} times of {len(rows)} frames; each needs one.")
        codes = _as_codes(np.array(_numbers(times, [f"{path}, times"] * len(times))))
    if codes and len(codes) < len(rows):
        raise ValueError(f"{path}: only {len(codes)} of {len(rows)} frames have a time.")
    if not header:
        raise ValueError(f"{path}: no frames with weights in it.")
    lost = [np.nan] * len(header)  # of a frame without a face
    matrix = np.array([row or lost for row in read]).reshape(len(rows), len(header))
    return _recording(path, header, matrix, names, fps, codes or None, sorted(left_out))


def _code(moment, key, place):
    """The time of a frame as a time code."""
    if _TIMES[key] == 1:
        return str(moment)
    return _as_codes(np.array([_number(moment, place) / _TIMES[key]]))[0]


def _opened(row, place):
    """The weights of a frame, be they bare or under a word or two, and what stands beside them."""
    beside, keys = {}, ("categoryName", "category_name")
    while True:
        if _is_list_of(row, dict):  # categories of MediaPipe, with a score each
            key = next((k for k in keys if k in row[0]), None)
            if key and all(isinstance(c.get(key), str) and "score" in c for c in row):
                scores = {c[key]: c["score"] for c in row}
                if len(scores) < len(row):
                    raise ValueError(
                        f"{place} has {len(row)} weights of {len(scores)} names, as of several "
                        "faces; write each face to a file of its own."
                    )
                return scores, beside
        if isinstance(row, list) and len(row) == 1 and isinstance(row[0], (list, dict)):
            row = row[0]  # of the one face
            continue
        held = [] if not isinstance(row, dict) else [k for k, v in row.items() if not _is_scalar(v)]
        word = next((k for k in held if normalised(k) in _WEIGHTS), None)
        if word is None:
            return row, beside
        beside |= {k: v for k, v in row.items() if k != word and normalised(k) not in _HEAD}
        row = row[word]


def _is_scalar(value):
    return not isinstance(value, (list, dict))


def _of_columns(path, content, names, fps):
    """A list of numbers for each name."""
    lists = {k: v for k, v in content.items() if isinstance(v, list)}
    if not lists:
        raise ValueError(
            f"{path}: no weights found in it; see read_weights for the forms it knows."
        )
    if len({len(v) for v in lists.values()}) > 1:
        sizes = listed(f"{k} {len(v)}" for k, v in lists.items())
        raise ValueError(f"{path}: lists of different length: {sizes}; each needs all frames.")
    matrix = np.array(
        [_numbers(c, [f"{path}, {k}, frame {i}" for i in range(len(c))]) for k, c in lists.items()]
    )
    left_out = [k for k in content if k not in lists and normalised(k) not in (*_FPS, *_COUNTS)]
    return _recording(path, list(lists), matrix.T, names, fps, None, left_out)


# --- npz ------------------------------------------------------------------------------------------


def read_npz_recording(path, names=None):
    """The rows of an npz file of weights; see `read_weights` for its forms."""
    path = existing_file(path, _NPZ)
    with open(path, "rb") as file, StoredArrays(path, file, _NPZ) as stored:
        fps = stored_rate(stored, "rate")
        if "weights" in stored:
            return _of_matrix(path, stored, names, fps)
        tracks = [k for k in stored.names if k != "fps" and len(stored.shape(k)) == 1]
        if not tracks or len({stored.shape(k) for k in tracks}) > 1:
            raise ValueError(
                f"{path}: neither names and weights, nor a track of one length for each name; it "
                f"holds {', '.join(f'{k} {stored.shape(k)}' for k in stored.names)}."
            )
        matrix = np.column_stack([stored.read(k, kinds="fiu").astype(float) for k in tracks])
        left_out = [k for k in stored.names if k not in tracks and k != "fps"]
        return _recording(path, tracks, matrix, names, fps, None, left_out)


def _of_matrix(path, stored, names, fps):
    if "names" not in stored:
        raise ValueError(f"{path}: weights without names; add an array of strings, names.")
    header = stored.read("names", ("n_names",), "U").tolist()
    weights = stored.read("weights", ("n_frames", len(header)), "fiu").astype(float)
    frames = (len(weights),)
    codes = None
    if "valid" in stored:
        weights[~stored.read("valid", frames, "b")] = np.nan
    if "times" in stored:
        codes = _as_codes(stored.read("times", frames, "fiu"))
    left_out = {*stored.names} - {"weights", "names", "fps", "valid", "times"}
    return _recording(path, header, weights, names, fps, codes, sorted(left_out))
