"""Make the captures of the actors: `python -m data_synth --out DIR`."""

import argparse
import resource
import sys
import time

from data_synth.actors import ACTORS
from data_synth.capture import SIZES, open_capture


def main(arguments=None):
    """Make what is missing or damaged under a folder; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m data_synth",
        description="Make the marker captures of the four synthetic actors: C3D files and the "
        "truth behind them. What is there already, whole and up to date, is kept.",
    )
    parser.add_argument("--out", help="folder to write to; default: the cache of facelab")
    parser.add_argument("--actors", nargs="+", choices=ACTORS, default=ACTORS, metavar="ACTOR",
                        help=f"some of {', '.join(ACTORS)}; default: all")  # fmt: skip
    parser.add_argument("--size", choices=tuple(SIZES), default="default")
    parser.add_argument("--random-state", type=int, default=0, metavar="SEED",
                        help="everything that happens follows from it; default: 0")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    chosen = parser.parse_args(arguments)
    if chosen.random_state < 0:
        parser.error(f"--random-state {chosen.random_state}: give 0 or more")
    root = chosen.out
    if root is None:
        from facelab.keeping import cache_dir

        root = cache_dir()
    try:
        for actor in chosen.actors:
            start = time.perf_counter()
            capture = open_capture(
                actor, root, chosen.size, chosen.random_state, progress=not chosen.quiet
            )
            size = sum(file.stat().st_size for file in capture.folder.rglob("*") if file.is_file())
            print(
                f"{capture} in {capture.folder}: {time.perf_counter() - start:.0f} s, "
                f"{size / 1e6:.0f} MB, peak memory {_peak_memory():.1f} GB"
            )
    except KeyboardInterrupt:
        print("Interrupted: finished actors are kept, nothing half-made is.", file=sys.stderr)
        return 130
    except OSError as error:  # no space, no permission, a file where a folder should be
        print(f"Could not write to {root}: {error}", file=sys.stderr)
        return 1
    return 0


def _peak_memory():
    """The most memory this process has used so far, GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)  # bytes there, kB elsewhere


if __name__ == "__main__":
    sys.exit(main())
