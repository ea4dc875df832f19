"""Break the mathematics on purpose, one place at a time, and see whether a test notices.

    python tests/mutate.py --sample 20 --seed 0

A mutant lives if the tests of its module pass with it. The sources are never touched: each mutant
is a copy of the package in a folder of its own, which is put first on the path.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

TESTS = {
    "facelab/segmentation/*.py": ["tests/segmentation", "tests/test_second_roads.py"],
    "facelab/models/*.py": ["tests/models", "tests/test_second_roads.py"],
    "facelab/posing/solver.py": ["tests/posing/test_session.py", "tests/test_second_roads.py"],
    "facelab/expression/re*.py": [
        "tests/expression/test_regression.py", "tests/expression/test_reading.py",
    ],
    "facelab/numeric/least_squares.py": ["tests/numeric", "tests/expression/test_regression.py"],
    "facelab/geometry/*.py": ["tests/geometry"],
}  # fmt: skip
"""Modules that are broken, and the tests that must notice."""

SWAPS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt,
    ast.And: ast.Or, ast.Or: ast.And, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
}  # fmt: skip
CALLS = {
    "mean": "sum", "sum": "mean", "max": "min", "min": "max", "sqrt": "abs",
    "argmin": "argmax", "argmax": "argmin", "maximum": "minimum", "minimum": "maximum",
}  # fmt: skip


class Places(ast.NodeVisitor):
    """All places of a module that can be broken: (words, function that breaks it)."""

    def __init__(self):
        self.found = []

    def add(self, node, words, change):
        self.found.append((f"line {node.lineno}: {words}", change))

    def visit_Raise(self, node):
        """Errors are the business of other tests."""

    def visit_BinOp(self, node):
        text = isinstance(node.left, ast.Constant | ast.JoinedStr) and isinstance(
            getattr(node.left, "value", ""), str
        )
        if type(node.op) in SWAPS and not text:
            new = SWAPS[type(node.op)]
            words = f"{type(node.op).__name__} becomes {new.__name__}"
            self.add(node, words, lambda n=node, o=new: setattr(n, "op", o()))
        self.generic_visit(node)

    def visit_Compare(self, node):
        if type(node.ops[0]) in SWAPS:
            new = SWAPS[type(node.ops[0])]
            words = f"{type(node.ops[0]).__name__} becomes {new.__name__}"
            self.add(node, words, lambda n=node, o=new: n.ops.__setitem__(0, o()))
        self.generic_visit(node)

    def visit_BoolOp(self, node):
        new = SWAPS[type(node.op)]
        words = f"{type(node.op).__name__} becomes {new.__name__}"
        self.add(node, words, lambda n=node, o=new: setattr(n, "op", o()))
        self.generic_visit(node)

    def visit_Attribute(self, node):
        if node.attr in CALLS:
            words = f"{node.attr} becomes {CALLS[node.attr]}"
            self.add(node, words, lambda n=node: setattr(n, "attr", CALLS[n.attr]))
        self.generic_visit(node)

    def visit_Constant(self, node):
        if isinstance(node.value, float) and node.value and abs(node.value) > 1e-4:
            words = f"{node.value} becomes {node.value / 2}"
            self.add(node, words, lambda n=node: setattr(n, "value", n.value / 2))

    def visit_UnaryOp(self, node):
        if isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
            words = "a minus is lost"
            self.add(node, words, lambda n=node: setattr(n, "op", ast.UAdd()))
        self.generic_visit(node)


def places(path):
    """Ways of breaking one module: (words, source of the broken module)."""
    count = Places()
    count.visit(ast.parse(path.read_text()))
    for i in range(len(count.found)):
        tree, again = ast.parse(path.read_text()), Places()
        again.visit(tree)
        words, change = again.found[i]
        change()
        yield words, ast.unparse(tree)


def lives(path, source, tests, seconds):
    """Whether all tests pass with a module replaced; a test that takes too long has noticed."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "facelab", Path(folder) / "facelab")
        (Path(folder) / path.relative_to(ROOT)).write_text(source)
        where = os.pathsep.join([folder, str(ROOT)])
        command = [sys.executable, "-P", "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
                   "--rootdir", str(ROOT), *tests]  # fmt: skip
        given = os.environ | {"PYTHONPATH": where}
        try:
            done = subprocess.run(
                command, cwd=ROOT, env=given, capture_output=True, timeout=seconds, check=False
            )
        except subprocess.TimeoutExpired:
            return False
        if done.returncode not in (0, 1, 2):
            raise RuntimeError(done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:])
        return done.returncode == 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sample", type=int, default=20, help="mutants drawn; 0 for all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="part of a module's path")
    parser.add_argument("--seconds", type=float, default=240, help="allowed for one mutant")
    given = parser.parse_args()
    drawn = [
        (path, words, source, tests)
        for pattern, tests in TESTS.items()
        for path in sorted(ROOT.glob(pattern))
        if given.only in str(path)
        for words, source in places(path)
    ]
    total = len(drawn)
    if given.sample:
        drawn = random.Random(given.seed).sample(drawn, min(given.sample, total))
    alive = []
    for path, words, source, tests in drawn:
        living = lives(path, source, tests, given.seconds)
        alive += [f"{path.relative_to(ROOT)} {words}"] if living else []
        print("LIVES" if living else "dead ", path.relative_to(ROOT), words, flush=True)
    print(f"{len(alive)} of {len(drawn)} live ({total} in all)", *alive, sep="\n")


if __name__ == "__main__":
    main()
