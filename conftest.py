"""What examples in docstrings write goes away again, where pytest runs them."""

import pytest


@pytest.fixture(autouse=True)
def own_folder(request):
    """An example runs in a folder of its own."""
    if isinstance(request.node, pytest.DoctestItem):
        folder = request.getfixturevalue("tmp_path")
        request.getfixturevalue("monkeypatch").chdir(folder)
