"""What a drag of a blendshape rig costs, its weights kept within 0 and 1: each move solves.

Against `lsq_linear` on the same programme: its 53 x 53 form, and the full one it stands for.
"""

import numpy as np
from scipy.optimize import lsq_linear
from setup import milliseconds
from threadpoolctl import threadpool_limits

import facelab
from facelab.posing import PoseSolver


def rigs():
    """The narrow and the wide face of ICT-FaceKit, or what stands in for them."""
    yield facelab.load_example().rig
    try:
        yield facelab.load_ict_facekit(area="face")
    except facelab.DataUnavailable as missing:
        print("without the wide face of ICT-FaceKit:", missing)


def path_of(face, vertex, n_moves=60):
    """Targets along a circle that leaves what the rig can do and comes back."""
    angle = np.linspace(0, 2 * np.pi, n_moves, endpoint=False)
    ring = np.stack([np.cos(angle) - 1, np.sin(angle), 0.3 * np.sin(angle)], axis=1)
    return face.vertices[vertex] + 12 * ring


def time_rig(rig, n_pins):
    """Milliseconds of a move (solve and mesh), of its solve alone, of a press; of lsq_linear."""
    face = rig.neutral
    session = facelab.PosingSession(rig, face)
    vertex = face.landmarks["mouth_corner_left"]
    for name in list(face.landmarks)[: n_pins - 1]:
        session.hold(face.landmarks[name])
    press = milliseconds(lambda: (session.cancel(), session.press(vertex)), 20)
    path, k = path_of(face, vertex), iter(range(10**6))

    def move():
        session.drag(vertex, path[next(k) % len(path)])
        return session.vertices

    whole = milliseconds(move, 240)
    pins = [*session.state.pins, vertex]
    solver = PoseSolver(rig)
    problem, rest = solver.problem(pins), np.zeros(len(rig.names))
    held = [session.state.pins.get(v, np.zeros(3)) for v in pins]

    def targets():
        return np.array([*held[:-1], path[next(k) % len(path)] - face.vertices[vertex]])

    alone = milliseconds(lambda: problem.solve(targets(), rest, rest), 240)
    J = np.concatenate([solver.seen(v) for v in pins])
    A = np.vstack([J, np.sqrt(solver.last_term)])
    off = 0.0
    for _ in range(12):
        t = targets()
        b = np.concatenate([t.ravel(), 0 * rest])
        theirs = lsq_linear(A, b, (0, 1), method="bvls", tol=1e-14).x
        off = max(off, np.abs(problem.solve(t, rest, rest) - theirs).max())
    slow = milliseconds(lambda: lsq_linear(A, b, (0, 1), tol=1e-10), 10)
    return whole, alone, press, slow, off


def main():
    """Print a row for each rig and number of pins."""
    print("ms, one thread       pins   move  solve  press  lsq_linear           off from it by")
    with threadpool_limits(1):
        for rig in rigs():
            for n_pins in (1, 5, 20):
                whole, alone, press, slow, off = time_rig(rig, n_pins)
                print(
                    f"{rig.neutral.n_vertices:>6} x {len(rig.names)} units {n_pins:7} {whole:7.3f} "
                    f"{alone:6.3f} {press:6.2f} {slow:7.2f} ({slow / alone:3.0f}x)  {off:.0e}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
