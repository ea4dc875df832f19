"""All benchmarks, one after the other: `make bench`, or `run.py NAME ...` for some."""

import importlib
import sys

NAMES = (
    "drag",
    "expression_latency",
    "generalisation",
    "latency",
    "locality",
    "long_takes",
    "markers",
    "peers",
    "readers",
    "registration",
    "regression",
    "rig_drag",
    "scale",
    "segmentation",
    "takes",
    "training",
    "transfer",
)

if __name__ == "__main__":
    for name in sys.argv[1:] or NAMES:
        print(f"\n== {name} " + "=" * (70 - len(name)), flush=True)
        importlib.import_module(name).main()
