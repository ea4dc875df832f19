"""The base-colour picture of a glTF mesh, and where its corners lie in it.

References
----------
Khronos Group, glTF 2.0 specification, sections 3.8 (textures) and 3.9 (materials);
KHR_texture_transform.
"""

import numpy as np

from facelab.files.pictures import MOST_BYTES, most_seen, picture
from facelab.geometry.texture import Texture


def texture_of(data, primitives, faces):
    """The texture of a mesh, or None; of several pictures the one on most triangles.

    Parameters
    ----------
    data : GltfData
    primitives : list of Item
    faces : list of ndarray of int, shape (n_faces, 3)
        Triangles of each primitive, numbered from its own first vertex.

    Returns
    -------
    Texture or None
        Its faces are those of all primitives, one after the other.
    """
    looks = [_look(data, primitive) for primitive in primitives]
    on = {}
    for look, F in zip(looks, faces, strict=True):
        if look is not None:
            on[look[0]] = on.get(look[0], 0) + len(F)
    if not on:
        return None
    chosen = most_seen(data.path, on)
    uv, factor = [], [1.0, 1.0, 1.0]
    for primitive, look, F in zip(primitives, looks, faces, strict=True):
        if look is None or look[0] != chosen:
            uv.append(np.full((len(F), 3, 2), np.nan, np.float32))
            continue
        _, place, material = look
        factor = material.numbers("baseColorFactor", 4, [1.0] * 4)[:3]
        uv.append(_places(data, primitive, place)[F])
    image = _image(data, chosen)
    if factor != [1.0, 1.0, 1.0]:  # a factor of light, not of sRGB
        scaled = image * np.clip(factor, 0, 1) ** (1 / 2.2)
        image = np.round(scaled).astype(np.uint8)
    return Texture(image, np.concatenate(uv))


def _look(data, primitive):
    """Picture, place of its coordinates and material of a primitive; None without a picture."""
    if "material" not in primitive:
        return None
    materials, textures = data.json.items("materials"), data.json.items("textures")
    material = materials[primitive.index("material", materials)].item("pbrMetallicRoughness")
    if "baseColorTexture" not in material:
        return None
    place = material.item("baseColorTexture")
    texture = textures[place.index("index", textures)]
    others = list(texture.item("extensions").value)
    if others and "source" not in texture:
        raise ValueError(
            f"{data.path}: {texture.place} has its picture as {', '.join(others)} alone, which is "
            "not read; export the file with PNG or JPEG."
        )
    return texture.index("source", data.json.items("images")), place, material


def _places(data, primitive, place):
    """Texture coordinates of the vertices of a primitive, shape (n, 2)."""
    moved = place.item("extensions").item("KHR_texture_transform")
    semantic = f"TEXCOORD_{moved.whole('texCoord', place.whole('texCoord', 0), high=9)}"
    uv = data.attribute(primitive, semantic, "VEC2")
    if not (np.abs(uv) < 1e4).all():
        raise primitive.item("attributes").damaged(
            f"does not hold two sound numbers for each of {len(uv)} vertices", semantic
        )
    if moved.value.get("rotation", 0) != 0:
        raise moved.wrong("rotation", "0: textures that are turned are not read")
    return uv * moved.numbers("scale", 2, [1.0, 1.0]) + moved.numbers("offset", 2, [0.0, 0.0])


def _image(data, index):
    """The picture, shape (height, width, 3), at most 2048 pixels wide or high."""
    item = data.json.items("images")[index]
    uri = item.text("uri")
    if uri is not None:
        stored = data.from_uri(item, uri, most=MOST_BYTES)
    else:
        stored = bytes(data.view(item.index("bufferView", data.lists["bufferViews"]))[0])
    return picture(stored, f"{data.path}: {item.place}")
