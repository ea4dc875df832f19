"""What reading a user's file costs: processor time, and memory at the peak.

Meshes of 200,000 faces, and a rig of 52 shapes on a tenth of that. Each file is read in a process
of its own; the memory is what its peak adds to what it had before reading. The ratio is to the
seconds that trimesh takes for the same file, which reads no shapes of a rig.
"""

import json
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import trimesh

import facelab

ROWS, COLUMNS = 251, 401  # of a sheet of 200,000 triangles


def sheet(rows, columns):
    """A bent sheet of a face's size."""
    y, x = np.mgrid[0 : 1 : rows * 1j, 0 : 1 : columns * 1j]
    V = np.stack([160 * x, 200 * y, 60 * np.sin(3 * x) * np.cos(2 * y)], axis=2).reshape(-1, 3)
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    F = np.stack([a, a + 1, a + columns + 1, a, a + columns + 1, a + columns], axis=1)
    return facelab.TriangleMesh(V, F.reshape(-1, 3))


def write_text_ply(path, mesh):
    head = f"ply\nformat ascii 1.0\nelement vertex {mesh.n_vertices}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    with open(path, "w") as out:
        out.write(head)
        np.savetxt(out, mesh.vertices, fmt="%.6f")
        np.savetxt(out, mesh.faces, fmt="3 %d %d %d")


def write_stl(path, mesh):
    rows = np.zeros(len(mesh.faces), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("extra", "<u2")])
    rows["v"] = mesh.vertices[mesh.faces]
    path.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())


def write_text_stl(path, mesh):
    corners = mesh.vertices[mesh.faces].reshape(-1, 9)
    vertex = "vertex %.6f %.6f %.6f\n"
    row = "facet normal 0 0 1\nouter loop\n" + 3 * vertex + "endloop\nendfacet"
    with open(path, "w") as out:
        out.write("solid sheet\n")
        np.savetxt(out, corners, fmt=row)
        out.write("endsolid sheet\n")


def write_avatar(path, mesh):
    middles = mesh.vertices[np.linspace(0, mesh.n_vertices - 1, 52).astype(int)]
    near = np.exp(-(((mesh.vertices - middles[:, None]) / 40) ** 2).sum(axis=2))
    near[near < 0.01] = 0
    names = [f"shape {k}" for k in range(52)]
    facelab.files.write_glb(path, mesh, near[:, :, None] * [0, -5.0, 1], names)


CASES = {  # file: what writes it, what it shows, what reads it
    "sheet.obj": (facelab.files.write_obj, (ROWS, COLUMNS), facelab.read_mesh),
    "binary.ply": (facelab.files.write_ply, (ROWS, COLUMNS), facelab.read_mesh),
    "text.ply": (write_text_ply, (ROWS, COLUMNS), facelab.read_mesh),
    "binary.stl": (write_stl, (ROWS, COLUMNS), facelab.read_mesh),
    "text.stl": (write_text_stl, (ROWS, COLUMNS), facelab.read_mesh),
    "sheet.glb": (facelab.files.write_glb, (ROWS, COLUMNS), facelab.read_mesh),
    "rig.glb": (write_avatar, (101, 101), facelab.read_rig),
}


def peak_mb():
    """The largest memory of this process since the peak was reset (Linux)."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def measure(path):
    """In a process of its own: seconds of the processor and megabytes of reading one file."""
    read = CASES[path.name][2]
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew here
    before, start = peak_mb(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = read(path)
    seconds = time.process_time() - start
    peak, start = peak_mb() - before, time.process_time()
    trimesh.load(path, process=False)
    print(json.dumps([repr(found), seconds, peak, seconds / (time.process_time() - start)]))


def main():
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'file':12s} {'MB':>6s} {'s':>6s} {'ratio':>6s} {'MB at the peak':>15s}")
        for name, (write, shape, _) in CASES.items():
            path = Path(folder) / name
            write(path, sheet(*shape))
            run = [sys.executable, __file__, str(path)]
            done = subprocess.run(run, capture_output=True, text=True, check=True)
            found, seconds, peak, ratio = json.loads(done.stdout)
            size = path.stat().st_size / 1e6
            spent = f"{seconds:6.2f} {ratio:6.2f} {peak:15.0f}"
            print(f"{name:12s} {size:6.1f} {spent}  {found}", flush=True)


if __name__ == "__main__":
    measure(Path(sys.argv[1])) if len(sys.argv) > 1 else main()
