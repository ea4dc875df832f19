"""The light of the page beside an offline render of the same faces: docs/light.png.

The offline render (Mitsuba 3, `pip install mitsuba`) traces the paths of light: shadows, and light
that skin throws on skin, which the page leaves out or keeps in the colours of its vertices. Both
have the same camera, the same lights and the same plain skin. What is said: by how much the
lightness of the two differs over the face, and how far it varies together.
"""

import sys
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from browser_lab import ROOT, Server
from matplotlib.colors import to_rgb
from pictures import canvas, opened
from PIL import Image

import facelab
from facelab.looks import Lining, lids_off, palette, shown
from facelab.looks.light import FILL, KEY, RIM, STRENGTHS
from facelab.plotting import SKIN

POSES = {  # on the generic face; where it is not, on a synthetic actor
    "rest": {},
    "smile": dict.fromkeys(("mouthSmile_L", "mouthSmile_R", "AU12L", "AU12R"), 0.8)
    | dict(jawOpen=0.15, AU26=0.3),
    "wink and frown": dict.fromkeys(("eyeBlink_L", "AU45L"), 1.0)
    | dict.fromkeys(("mouthFrown_L", "browDown_R", "AU4", "AU15"), 0.8),
}
WIDTH, HEIGHT = 360, 420
SAMPLES = 96
CELL = f"""
import facelab
from facelab.widgets.viewer import FaceView
import numpy as np
example = facelab.load_example()
view = FaceView(example.rig.neutral, example.props, width={WIDTH}, height={HEIGHT})
view.widget"""
EYE, MIDDLE = "(view._middle + view._camera.position).tolist()", "view._middle.tolist()"


def linear(color):
    """Colours of a screen, 0 to 1, as amounts of light."""
    color = np.asarray(color)
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def screen(light):
    """The colours of a screen, 0 to 1, for amounts of light."""
    light = light.clip(0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def parts_of(example, vertices):
    """What is seen of a face: (vertices, triangles, colours, gloss) of each part."""
    mesh, props = example.rig.neutral, example.props
    vertices, lining = lids_off(props, vertices), Lining(mesh)
    skin = np.tile(to_rgb(SKIN), (len(vertices), 1))
    yield vertices, mesh.faces, skin, 0.0
    yield lining.vertices(vertices), lining.faces, lining.colors, 0.0
    for prop in props:
        at, _ = shown(prop, vertices)
        yield at, prop.mesh.faces, prop.colors, getattr(prop, "gloss", 0.0)


def traced(mi, parts, eye, middle, fov):
    """The picture that a path tracer makes: (HEIGHT, WIDTH, 3), light."""
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6, "hide_emitters": True},
        "around": {
            "type": "constant",
            "radiance": {"type": "rgb", "value": 1.25 * STRENGTHS["around"]},
        },
        "camera": {
            "type": "perspective",
            "fov": fov,
            "fov_axis": "y",
            "to_world": mi.ScalarTransform4f().look_at(origin=eye, target=middle, up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "pixel_format": "rgba"},
            "sampler": {"type": "independent", "sample_count": SAMPLES},
        },
    }
    for name, way in (("key", KEY), ("fill", FILL), ("rim", RIM)):
        light = {"type": "rgb", "value": np.pi * STRENGTHS[name]}
        scene[name] = {"type": "directional", "direction": (-way).tolist(), "irradiance": light}
    for k, (V, F, colors, gloss) in enumerate(parts):
        base = {"type": "mesh_attribute", "name": "vertex_color"}
        material = {"type": "principled", "base_color": base, "roughness": 0.55}
        if gloss:
            material |= {"roughness": 1 - 0.78 * gloss}
        options = mi.Properties()
        options["bsdf"] = mi.load_dict({"type": "twosided", "inner": material})
        shape = mi.Mesh(f"part{k}", len(V), len(F), has_vertex_normals=True, props=options)
        shape.add_attribute("vertex_color", 3, linear(colors).astype(np.float32).ravel())
        told = mi.traverse(shape)
        told["vertex_positions"] = np.float32(V).ravel()
        told["vertex_normals"] = np.float32(facelab.TriangleMesh(V, F).normals).ravel()
        told["faces"] = np.uint32(F).ravel()
        told.update()
        scene[f"part{k}"] = shape
    return np.array(mi.render(mi.load_dict(scene), seed=0))


def pages(folder, poses):
    """Faces as the page shows them; and the arguments of `traced` that its camera says."""
    server = Server(folder)
    try:
        lab = opened(server, "light", CELL)
        look = lab.run("", eye=EYE, middle=MIDDLE, fov="view._camera.fov")
        found = []
        for vertices in poses:
            lab.run(f"view.show(np.array({vertices.tolist()}))")
            lab.page.mouse.move(2, 2)
            lab.settle()
            found.append(canvas(lab))
        return found, look
    finally:
        server.close()


def main(folder):
    try:
        import mitsuba as mi
    except ImportError:
        return "the offline render needs Mitsuba 3: .venv/bin/python -m pip install mitsuba"
    mi.set_variant("scalar_rgb")
    example = facelab.load_example()
    rig = example.rig
    poses = [
        rig.shape({name: w for name, w in weights.items() if name in rig.names})
        for weights in POSES.values()
    ]
    shots, look = pages(folder, poses)
    figure, axes = plt.subplots(2, len(POSES), figsize=(8.4, 6.8), layout="constrained")
    for ax, name, V, shot in zip(axes.T, POSES, poses, shots, strict=True):
        light = traced(mi, parts_of(example, V), **look)
        seen = light[..., 3:].clip(0, 1)
        paper = np.array([244, 244, 242]) / 255
        picture = seen * screen(light[..., :3]) + (1 - seen) * paper
        ax[0].imshow(shot)
        ax[1].imshow(picture)
        ax[0].set_title(name, fontsize=9)
        page = Image.fromarray(np.uint8(255 * shot[..., :3])).resize((WIDTH, HEIGHT))
        page = np.asarray(page) / 255
        inside = seen[..., 0] > 0.99
        a, b = (palette.lab(x[inside])[:, 0] for x in (page, picture))
        print(
            f"{name}: lightness {a.mean():.0f} in the page, {b.mean():.0f} offline, "
            f"differs by {np.sqrt(np.mean((a - a.mean() - b + b.mean()) ** 2)):.1f} of 100 beside "
            f"that, correlation {np.corrcoef(a, b)[0, 1]:.2f}",
            flush=True,
        )
    for ax, label in zip(axes[:, 0], ("the page", "offline, path traced"), strict=True):
        ax.set_ylabel(label, fontsize=9)
    for ax in axes.flat:
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
    figure.savefig(ROOT / "docs" / "light.png", dpi=100)
    return 0


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(folder))
