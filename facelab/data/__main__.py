"""Make all data ready: `python -m facelab.data`."""

import sys

from facelab.data.cache import DataUnavailable
from facelab.data.ict import load_ict_facekit
from facelab.data.takes import TAKES, load_take


def main():
    """Fetch and prepare what the notebooks use; say plainly what is not to be had."""
    try:
        rig = load_ict_facekit()
        takes = [load_take(name) for name in TAKES]
        print(f"real face: {rig}; real motion: {', '.join(map(repr, takes))}")
    except DataUnavailable as missing:
        print(f"Real data is not at hand: {missing}", file=sys.stderr)
        print("The lab runs on synthetic faces instead.", file=sys.stderr)


if __name__ == "__main__":
    main()
