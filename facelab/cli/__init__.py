"""The command `facelab`: the roads of the package from a terminal, for one file or for many."""

from facelab.cli.main import main

__all__ = ["main"]
