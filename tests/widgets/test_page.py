"""What all pages share: text from files is never HTML, and files stay where they belong."""

import base64
import io

import ipywidgets as widgets
import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image
from planted import bumps, quarters

from facelab import plotting
from facelab.expression.session import ExpressionSession
from facelab.geometry.mesh import TriangleMesh
from facelab.models.region import RegionModel
from facelab.motion import MarkerSequence, MotionSequence
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.widgets import ExpressionLab, Player, PosingLab
from facelab.widgets.page import Page, markup, path_in, uploaded, written
from facelab.widgets.thumbnail import captioned

HOSTILE = "<img src=x onerror=\"window.hacked='{}'\">"


def hostile(what):
    return HOSTILE.format(what)


class Upload:
    """What a FileUpload holds after a file was chosen."""

    def __init__(self, name, content):
        self.value = ({"name": name, "content": memoryview(content)},)


def hostile_labs(folder):
    """Every lab, with a name that is HTML wherever a name can come from a file."""
    mesh, labels = quarters()
    X = bumps(mesh, labels, np.random.default_rng(3))
    face = TriangleMesh(mesh.vertices, mesh.faces, {hostile("landmark"): 40})
    model = RegionModel(Regions(labels, face), 4).fit(X)
    deltas = X.reshape(len(X), -1, 3)[:3]
    rig = BlendshapeRig(face, [hostile("unit"), "b", "c"], deltas)
    motion = MotionSequence(face.vertices + np.zeros((3, 1, 1)), 30.0, face)
    (folder / f"{hostile('file').replace('/', '')}.json").write_text("{}")
    posing = PosingLab(
        PosingSession(model, face),
        {hostile("model"): model, "rig": rig},
        takes={hostile("take"): motion},
        folder=folder,
    )
    posing.stage.beside.value = "rig"
    posing.stage._hover(40)
    posing.session.set_pin(40)
    posing.shape.choose_at(40)
    posing.strip.add(hostile("pose"))
    expression = ExpressionLab(
        ExpressionSession(rig, rig.shape([0.5, 0, 0]), origin=hostile("origin")),
        {hostile("sketch"): motion},
        {hostile("other"): rig},
        folder=folder,
    )
    markers = MarkerSequence(face.vertices[None, :1] + np.zeros((3, 1, 1)), [hostile("marker")], 30)
    return posing, expression, Player(motion, markers)


def inside(widget):
    """A widget and all that it holds."""
    yield widget
    for child in getattr(widget, "children", ()):
        yield from inside(child)


def test_no_name_from_a_file_becomes_html(tmp_path):
    for lab in hostile_labs(tmp_path):
        lab.fail(ValueError(hostile("error")))
        html = [w for w in inside(lab.widget) if isinstance(w, (widgets.HTML, widgets.HTMLMath))]
        assert html and any("&lt;img" in w.value for w in html)
        for each in html:
            assert "<img" not in each.value, each.value


def test_names_with_signs_of_mathematics_are_drawn_as_they_are():
    figure, ax = plt.subplots()
    names = ["$\\frac$", "<b>"]
    plotting.draw_weights(ax, dict.fromkeys(names, 0.5), names, names)
    figure.canvas.draw()  # a name taken for a formula fails here
    plt.close(figure)


def test_markup_escapes_what_is_put_in_and_keeps_what_is_ours():
    bold = markup("<b>{}</b>", "<i>")
    assert bold == "<b>&lt;i&gt;</b>"
    assert markup("<p>{}</p>", bold) == "<p><b>&lt;i&gt;</b></p>"
    page = Page()
    page._build_messages()
    page.say("<i>")
    assert "&lt;i&gt;" in page._status.value


@pytest.mark.parametrize(
    "name", ["../pose", "/etc/pose", "a/b", "..", ".", "C:pose", "a\\b", "a\0"]
)
def test_a_typed_name_stays_in_the_folder(name, tmp_path):
    with pytest.raises(ValueError, match="leads out of the folder"):
        path_in(tmp_path, name, ".json")


def test_a_typed_name_gets_its_ending_once_and_must_be_there(tmp_path):
    assert path_in(tmp_path, " smirk ", ".json") == tmp_path / "smirk.json"
    assert path_in(tmp_path, "smirk.json", ".json") == tmp_path / "smirk.json"
    with pytest.raises(ValueError, match="name is empty"):
        path_in(tmp_path, "  ")


def test_an_uploaded_file_is_read_under_its_bare_name_and_goes_away():
    upload = Upload("../../x/C:\\pose.json", b"{}")
    with uploaded(upload) as path:
        assert path.name == "pose.json" and path.read_bytes() == b"{}"
    assert not path.exists() and upload.value == ()


def test_what_was_written_is_named_escaped_and_linked(tmp_path):
    path = tmp_path / "<b>.txt"
    path.write_text("abc")
    text = written(path)
    assert "&lt;b&gt;.txt" in text and "base64,YWJj" in text and "<b>.txt" not in text


def test_a_caption_is_whole_below_a_narrow_picture_and_greek_is_in_it():
    file = io.BytesIO()
    Image.new("RGB", (40, 30), "black").save(file, "PNG")
    text = "λ is 0.70: a line far longer than the picture"
    made = Image.open(io.BytesIO(base64.b64decode(captioned(file.getvalue(), text))))
    ink = np.asarray(made.convert("L"))[30:] < 128
    assert made.width > 200 and ink.any() and not ink[:, -8:].any()
    first, second = (captioned(file.getvalue(), letter) for letter in "λμ")
    assert first != second  # not one and the same box
