"""What the browser tests share: the posing lab of the example face, open in JupyterLab."""

import pytest
from browser_lab import Lab, write_notebook

CELLS = (
    "from facelab.widgets import PosingLab",
    "lab = PosingLab.example()\nlab",
    "twin = PosingLab(lab.session, lab.models, lab.props, width=240, height=276)\ntwin",
)


@pytest.fixture(scope="module")
def posing_lab(tmp_path_factory):
    """A lab of the example face in JupyterLab, with a second view of its session below."""
    lab = Lab(tmp_path_factory.mktemp("lab"))
    try:
        lab.open(write_notebook(lab.folder / "source" / "posing.ipynb", CELLS))
        lab.bring_into_view()
        yield lab
    finally:
        lab.close()
