"""What a drag costs: one move and one mouse down, against solving Eq. 10 anew at every move.

"solved anew" finds the matrix of the boundary term ready; "assembled too" builds that as well.
"""

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
        yield f"397 -> {n}", bound, dense.neutral, facelab.bind(dense.neutral, samples)
        full = dense.animate(take[::4])
        trained = facelab.RegionModel(own.carried_to(dense.neutral, samples), 30)
        yield f"{n} trained", trained.fit(full.displacements()), dense.neutral, None


def time_case(model, face, binding):
    """Milliseconds of: a move, the mouse going down, solving anew, and assembling too."""
    session = facelab.PosingSession(model, face, binding=binding)
    vertex = face.landmarks["mouth_corner_left"]
    held = vertex if binding is None else int(binding.handle_of[vertex])
    wanted = np.array([2.0, 4.0, 0.0])
    target = face.vertices[vertex] + wanted
    ready = facelab.PoseSolver(model)

    def move():
        session.drag(vertex, target)
        return session.vertices

    def press():
        session.cancel()
        session.press(vertex)

    def solved(solver=ready):
        x = solver.displacements(solver.solve({held: wanted}))[0]
        return face.vertices + (x if binding is None else binding.carry(x))

    def assembled():
        model.boundary_ = model._boundary_matrix()
        return solved(facelab.PoseSolver(model))

    down = milliseconds(press)
    session.cancel()
    np.testing.assert_allclose(move(), assembled(), atol=1e-8)
    return milliseconds(move, 300), down, milliseconds(solved, 30), milliseconds(assembled, 10)


def main():
    """Print a row for each size."""
    print("ms, one thread     move  mouse down    solved anew   assembled too")
    with threadpool_limits(1):
        for name, *case in cases():
            move, down, solved, assembled = time_case(*case)
            print(
                f"{name:>14} {move:8.4f} {down:11.2f} {solved:7.2f} ({solved / move:3.0f}x) "
                f"{assembled:8.2f} ({assembled / move:4.0f}x)",
                flush=True,
            )


if __name__ == "__main__":
    main()
