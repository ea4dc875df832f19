"""Takes: weights over time, as Live Link Face and other programs write them."""

from facelab.files.takes.live_link import read_live_link_csv, to_arkit, write_live_link_csv
from facelab.files.takes.recording import TakeReport
from facelab.files.takes.weights import read_weights, write_weights_csv

__all__ = [
    "TakeReport",
    "read_live_link_csv",
    "read_weights",
    "to_arkit",
    "write_live_link_csv",
    "write_weights_csv",
]
