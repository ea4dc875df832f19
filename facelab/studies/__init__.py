"""The experiments of the notebooks that take more than a cell."""
