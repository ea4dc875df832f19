"""The plan of the house in CONTRIBUTING.md holds: arrows, doors, sizes.

Nothing is imported: the sources are read.
"""

import ast
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted([*ROOT.glob("facelab/**/*.py"), *ROOT.glob("data_synth/**/*.py")])
LONGEST = 600


def floors():
    """Rooms by their floor in the picture of CONTRIBUTING.md, the ground being 0."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    picture = re.search(r"```house\n(.*?)```", text, flags=re.S).group(1)
    rooms = [line.split("|")[0].split() for line in picture.strip().splitlines()]
    return {room: i for i, floor in enumerate(reversed(rooms)) for room in floor}


def room_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return parts[0] if parts[0] == "data_synth" else parts[1]


def imports(path):
    """What a file imports: (module, name or None) pairs."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.name) for alias in node.names)


def room_imported(module, name):
    top, *inside = module.split(".")
    if top == "facelab":
        return inside[0] if inside else name
    return top if top == "data_synth" else None


def is_command(path):
    """Commands stand outside the house and may enter by any door."""
    return path.name == "__main__.py"


def test_arrows_run_one_way():
    floor = floors()
    up = []
    for path in SOURCES:
        room = room_of(path)
        if (path.name == "__init__.py" and path.parent.name == "facelab") or is_command(path):
            continue
        for module, name in imports(path):
            other = room_imported(module, name)
            if other in (None, room):
                continue
            assert other in floor, f"{other} is not in the picture of CONTRIBUTING.md"
            if floor[other] >= floor[room]:
                up.append(f"{path.relative_to(ROOT)} -> {other}")
    assert not up, "arrows that do not run down: " + ", ".join(up)


def test_every_room_is_in_the_picture_and_no_other():
    rooms = {room_of(path) for path in SOURCES} - {"__init__", "__main__"}
    assert rooms == set(floors())


def test_no_room_reads_the_private_names_of_another():
    read = []
    for path in SOURCES:
        for module, name in imports(path):
            if module.split(".")[0] in ("facelab", "data_synth") and (name or "").startswith("_"):
                read.append(f"{path.relative_to(ROOT)}: {module}.{name}")
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and re.match(r"_[a-z]", node.attr):
                owner = node.value
                own = isinstance(owner, ast.Name) and owner.id in ("self", "cls", "other")
                own |= isinstance(owner, ast.Call) and getattr(owner.func, "id", "") == "super"
                own |= f"def {node.attr}(" in path.read_text()  # of a class of this very file
                own |= f"self.{node.attr} = " in path.read_text()
                if not own:
                    read.append(f"{path.relative_to(ROOT)}: {ast.unparse(node)}")
    assert not read, "private names of others: " + "; ".join(read)


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_module_is_too_long_to_read(path):
    n_lines = len(path.read_text().splitlines())
    assert n_lines <= LONGEST, f"{path.name} has {n_lines} lines, more than {LONGEST}: cut it"


def test_notebooks_come_in_by_the_front_door():
    deep = []
    for path in sorted(ROOT.glob("notebooks/*.ipynb")):
        for cell in json.loads(path.read_text())["cells"]:
            if cell["cell_type"] == "code":
                deep += re.findall(
                    r"(?:from|import) (facelab\.\w+\.[\w.]+)", "".join(cell["source"])
                )
    assert not deep, "notebooks import from facelab and its rooms only, not " + ", ".join(deep)


def test_the_top_level_is_short_and_every_room_says_what_it_is():
    tree = ast.parse((ROOT / "facelab" / "__init__.py").read_text())
    rooms = {p.parent.name for p in ROOT.glob("facelab/*/__init__.py")}
    listed = next(n for n in tree.body if ast.unparse(n).startswith("__all__"))
    names = set(ast.literal_eval(listed.value)) - rooms
    assert 20 <= len(names) <= 30, f"{len(names)} names: about 25 can be kept in mind"
    for room in sorted(rooms):
        text = (ROOT / "facelab" / room / "__init__.py").read_text()
        assert ast.get_docstring(ast.parse(text)), f"facelab/{room} does not say what it is for"
