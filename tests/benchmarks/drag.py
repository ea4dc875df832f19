"""What a drag costs: one move and one mouse down, against solving Eq. 10 anew at every move.

"solved anew" finds the matrix of the boundary term ready; "assembled too" builds that as well.
"""

import tracemalloc

import numpy as np
from setup import example_motion, milliseconds
from threadpoolctl import threadpool_limits

import facelab


def cases():
    """Name, model, shown face, binding: bound to dense faces, and trained on them."""
    example, _, rig, train, _, _ = example_motion()
    regions = facelab.segment_face(train.resampled(15), n_regions=10, random_state=0)
    model = facelab.RegionModel(regions, 30).fit(train.displacements())
    yield "397 alone", model, rig.neutral, None
    faces = {"narrow": (example.rig, example.train)}
    try:
        faces["face"] = (facelab.load_ict_facekit(area="face"), example.train)
    except facelab.DataUnavailable as missing:
        print("without the wide face of ICT-FaceKit:", missing)
    for dense, take in faces.values():
        n = dense.neutral.n_vertices
        corners = [dense.neutral.landmarks[f"mouth_corner_{s}"] for s in ("left", "right")]
        samples, control = dense.neutral.subsample(397, keep=corners)
        motion = dense.on(samples, control).animate(take).with_noise(0.3, 0)
        own = facelab.segment_face(motion.resampled(15), n_regions=10, random_state=0)
        bound = facelab.RegionModel(own, 30).fit(motion.displacements())
        yield f"397 -> {n}", bound, dense.neutral, facelab.bind_to_samples(dense.neutral, samples)
        full = dense.animate(take[::4])
        trained = facelab.RegionModel(own.carried_to(dense.neutral, samples), 30)
        yield f"{n} trained", trained.fit(full.displacements()), dense.neutral, None


def time_case(model, face, binding):
    """Milliseconds of: a move, the mouse going down, solving anew, and assembling too."""
    session = facelab.PosingSession(model, face, binding=binding)
    vertex = face.landmarks["mouth_corner_left"]
    wanted = np.array([2.0, 4.0, 0.0])
    target = face.vertices[vertex] + wanted
    ready = facelab.posing.PoseSolver(model, binding=binding)

    def move():
        session.drag(vertex, target)
        return session.vertices

    def press():
        session.cancel()
        session.press(vertex)

    def solved(solver=ready):
        return face.vertices + solver.shown(solver.solve({vertex: wanted}))[0]

    def assembled():
        model.boundary_ = model.boundary(range(model.n_vertices))
        return solved(facelab.posing.PoseSolver(model, binding=binding))

    down = milliseconds(press)
    session.cancel()
    np.testing.assert_allclose(move(), assembled(), atol=1e-8)
    return milliseconds(move, 300), down, milliseconds(solved, 30), milliseconds(assembled, 10)


def pinned(session, n_pins):
    """The session with pins where some vertices are, far from each other."""
    session.reset()
    V = session.neutral.vertices
    order = [session.neutral.landmarks["mouth_corner_left"]]
    while len(order) < n_pins + 1:
        off = np.linalg.norm(V[:, None] - V[order], axis=2).min(axis=1)
        order.append(int(off.argmax()))
    for v in order[1:]:
        session.hold(v)
    return order[0]


def mouse_down(model, face, binding):
    """Milliseconds of the mouse going down with so many pins set, and of a move with a limit."""
    session = facelab.PosingSession(model, face, binding=binding)
    found = []
    for n_pins in (1, 5, 20):
        vertex = pinned(session, n_pins)
        found.append(milliseconds(lambda v=vertex: (session.cancel(), session.press(v)), 20))
        session.cancel()
    session.set(limit=3.0)
    step = iter(range(10**6))

    def move():
        by = np.array([0.3, 0.4, 0]) * (next(step) % 60)
        session.drag(vertex, face.vertices[vertex] + by)
        return session.vertices

    return found, milliseconds(move, 60)


def pin_error(model, face, binding):
    """Print how far a pin stays behind a pull of 8 mm for several gamma, mean of six landmarks."""
    names = ("mouth_corner_left", "lip_upper", "lip_lower", "brow_left_3", "brow_right_2", "chin")
    session = facelab.PosingSession(model, face, binding=binding)
    for gamma in (0.0025, 0.025, 0.25, 2.5):
        session.set(gamma=gamma)
        left = []
        for name in names:
            v = face.landmarks[name]
            session.reset()
            session.drag(v, session.vertices[v] + [2.4, 7.2, 2.6])
            left.append(np.linalg.norm(session.vertices[v] - session.pins[v]))
            session.release()
        print(f"gamma {gamma:6.4f}: {np.mean(left):.2f} mm of 8 are missing at the pin")


def memory(model, face, binding):
    """Print what the kernel holds after a thousand drags of 20 moves each, undo kept and not."""
    session = facelab.PosingSession(model, face, binding=binding)
    rng = np.random.default_rng(0)
    pulled = rng.choice(face.n_vertices, 50, replace=False).tolist()

    def drags(n):
        for k in range(n):
            v = pulled[k % 50]
            for by in np.cumsum(rng.normal(size=(20, 3)), axis=0):
                session.drag(v, face.vertices[v] + by)
                session.vertices  # noqa: B018
            session.cancel()

    tracemalloc.start()
    drags(100)
    before = tracemalloc.get_traced_memory()[0]
    drags(1000)
    given_up = tracemalloc.get_traced_memory()[0] - before
    for k in range(1000):
        session.drag(k % 20, face.vertices[k % 20] + rng.normal(size=3))
        session.release()
    kept = tracemalloc.get_traced_memory()[0] - before - given_up
    tracemalloc.stop()
    print(
        f"memory after 1,000 drags of 20 moves: {given_up / 1e6:+.2f} MB; after 1,000 more that "
        f"are kept as {session.n_undo} steps of undo with 20 pins: {kept / 1e6:+.2f} MB"
    )


def main():
    """Print a row for each size, then what pins, gamma and a thousand drags do."""
    print("ms, one thread     move  mouse down    solved anew   assembled too")
    with threadpool_limits(1):
        for name, *case in cases():
            move, down, solved, assembled = time_case(*case)
            print(
                f"{name:>14} {move:8.4f} {down:11.2f} {solved:7.2f} ({solved / move:3.0f}x) "
                f"{assembled:8.2f} ({assembled / move:4.0f}x)",
                flush=True,
            )
            if name != "397 -> 6706":
                continue
            (one, five, twenty), limited = mouse_down(*case)
            print(
                f"    mouse down with 1, 5, 20 pins: {one:.2f}, {five:.2f}, {twenty:.2f}; "
                f"a move with a limit of 3 standard deviations: {limited:.2f}"
            )
            pin_error(*case)
            memory(*case)


if __name__ == "__main__":
    main()
