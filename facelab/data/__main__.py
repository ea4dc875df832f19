"""Make all data ready: `python -m facelab.data`."""

import sys

from facelab.data.aura import load_aura, load_aura_take
from facelab.data.cache import DataUnavailable
from facelab.data.ict import load_ict_facekit
from facelab.data.markers import MARKERS, load_markers
from facelab.data.takes import TAKES, load_take

SOURCES = {
    "generic face": lambda: [load_ict_facekit(n_identities=20)],  # a person of them is fitted in 02
    "recorded takes": lambda: [load_take(name) for name in TAKES],
    "production head": lambda: [load_aura(), load_aura_take()],
    "optical capture": lambda: [load_markers(name) for name in MARKERS],
}


def main():
    """Fetch and prepare what the notebooks use; say plainly what is not to be had."""
    missing = {}
    for name, load in SOURCES.items():
        try:
            print(f"{name}: {', '.join(map(repr, load()))}", flush=True)
        except DataUnavailable as why:
            missing[name] = why
    if missing:
        why = next(iter(missing.values()))
        print(f"Real data is not at hand ({', '.join(missing)}): {why}", file=sys.stderr)
        print("The lab runs without it, on synthetic faces.", file=sys.stderr)


if __name__ == "__main__":
    main()
