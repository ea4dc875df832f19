"""Faults of captured markers, counted; angles of meshes and spectra of motion."""

import numpy as np


def in_head(positions, truth):
    """Positions with the motion of the head undone, x = R' (y - t): (n_frames, n_markers, 3), mm.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_markers, 3)
        As the cameras have them.
    truth : object
        With `rotation`, (n_frames, 3, 3), and `translation`, (n_frames, 3), mm.
    """
    return np.einsum("fmy,fyx->fmx", positions - truth.translation[:, None], truth.rotation)


def spread(positions):
    """RMS distance of markers from their own mean place, over what was seen, mm."""
    apart = positions - np.nanmean(positions, axis=0)
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=2))))


def gap_lengths(visible):
    """Frames that each gap lasts: ndarray of int, marker by marker.

    >>> gap_lengths(np.array([[True], [False], [False], [True], [False]]))
    array([2, 1])
    """
    ends = np.diff(np.pad(~visible, ((1, 1), (0, 0))).astype(int), axis=0)
    return np.concatenate([np.flatnonzero(e == -1) - np.flatnonzero(e == 1) for e in ends.T])


def longest(captures, kind):
    """The longest swap or ghost of the first capture that has one: capture, take, fault.

    Parameters
    ----------
    captures : iterable of Capture
    kind : {"swaps", "ghosts"}

    Raises
    ------
    ValueError
        If none has any.
    """
    for capture in captures:
        found = [(t, fault) for t in capture.texts for fault in getattr(capture.truth(t), kind)]
        if found:
            take, fault = max(found, key=lambda case: case[1].stop - case[1].first)
            return capture, take, fault
    raise ValueError(f"kind={kind!r}: none of these captures has any; give others.")


def bridged(positions, visible, seconds):
    """Gaps filled by straight lines in time: (n_frames, n_markers, 3), mm."""
    filled = np.array(positions, dtype=float)
    for m, seen in enumerate(visible.T):
        for axis in range(3):
            filled[:, m, axis] = np.interp(seconds, seconds[seen], positions[seen, m, axis])
    return filled


def lag(filtered, true, most=12):
    """How many frames a filtered curve runs behind the true one, 0 to `most`."""
    n = len(true) - most
    alike = [np.corrcoef(filtered[d : n + d], true[:n])[0, 1] for d in range(most + 1)]
    return int(np.argmax(alike))


def smallest_angles(mesh):
    """The smallest angle of each triangle, degrees: (n_faces,)."""
    corner = mesh.vertices[mesh.faces]
    a, b = np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner
    cosine = (a * b).sum(axis=2) / np.linalg.norm(a, axis=2) / np.linalg.norm(b, axis=2)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).min(axis=1)


def spectrum(positions):
    """RMS motion of the vertices, mm, and the share of variance by so many components.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_vertices, 3)
        Millimetres.
    """
    X = positions.reshape(len(positions), -1).astype(float)
    X -= X.mean(axis=0)
    variance = np.linalg.eigvalsh(X.T @ X / len(X))[::-1].clip(0)
    rms = float(np.sqrt(variance.sum() / positions.shape[1]))
    return rms, np.cumsum(variance) / variance.sum()
