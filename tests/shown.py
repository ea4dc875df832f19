"""What a page leaves in a notebook."""

import base64
import io
import re

import matplotlib.image


def shown(page, monkeypatch):
    """What a page displays: the picture that stands for it (HTML, RGB array) and its bundle."""
    told = []
    monkeypatch.setattr("facelab.widgets.page.display", lambda what, raw=False: told.append(what))
    page._ipython_display_()
    still, bundle = told
    png = re.search(r"base64,([^\"]+)", still.data)[1]
    image = matplotlib.image.imread(io.BytesIO(base64.b64decode(png)))[..., :3]
    assert "application/vnd.jupyter.widget-view+json" in bundle
    return still.data, image, bundle
