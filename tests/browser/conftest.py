"""What the browser tests share: one server, and the posing lab of the example face on it."""

import pytest
from browser_lab import LABS, Lab, Server, write_notebook

CELLS = (
    "from facelab.widgets import PosingLab",
    # small, for it grows to twice as many pixels, and those are drawn without a graphics card
    "lab = PosingLab.example(width=320, height=368)\nlab",
    "twin = PosingLab(lab.session, lab.models, lab.props, width=240, height=276)\ntwin",
)


@pytest.fixture(autouse=True)
def quiet_console():
    """No page complains of anything of ours, in any test."""
    yield
    told = [error for lab in LABS for error in lab.complaints()]
    assert not told, f"the console of the page says: {told}"


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    """One for all tests: a folder of its own, any number of notebooks."""
    server = Server(tmp_path_factory.mktemp("server"))
    try:
        yield server
    finally:
        server.close()


@pytest.fixture(scope="module")
def posing_lab(server):
    """A lab of the example face in JupyterLab, with a second view of its session below."""
    lab = Lab(server)
    try:
        lab.open(write_notebook(lab.folder / "source" / "posing.ipynb", CELLS))
        lab.bring_into_view()
        yield lab
    finally:
        lab.close()
