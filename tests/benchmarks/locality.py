"""How local a drag is: share of the motion's energy outside the edited region, both models.

Fifty vertices, spread over the face, are pulled by 8 mm each the way the region model lets them
move most. Far means another region than that of the vertex; beyond 40 mm is told as well. On the
real face (ICT-FaceKit, performance of alex) and on the synthetic actor.
"""

import numpy as np
from setup import example_motion

import facelab


def faces():
    """Name, control mesh, noisy training motion."""
    _, _, rig, train, _, _ = example_motion()
    yield "real", rig.neutral, train
    actor = facelab.load_registered("M1")
    yield "synthetic M1", actor.mesh, actor.motion("train")


def spread_over(mesh, n):
    """Vertices far from each other: farthest points."""
    found = [0]
    off = np.full(mesh.n_vertices, np.inf)
    while len(found) < n:
        off = np.minimum(off, mesh.geodesics([found[-1]])[0])
        found.append(int(off.argmax()))
    return found


def shares(session, vertex, pull, labels):
    """Of the energy of one drag: outside the region, beyond 40 mm; and how far the pin went, mm."""
    session.reset()
    session.drag(vertex, session.vertices[vertex] + pull)
    x = session.vertices - session.neutral.vertices
    session.cancel()
    energy = np.sum(x**2, axis=1)
    V = session.neutral.vertices
    far = np.linalg.norm(V - V[vertex], axis=1) > 40
    whole = energy.sum()
    return (
        energy[labels != labels[vertex]].sum() / whole,
        energy[far].sum() / whole,
        np.linalg.norm(x[vertex]),
    )


def measure(mesh, motion, n_drags=50, n_components=20):
    """Shares of each drag for the region and the holistic model: (2, n_drags, 3)."""
    regions = facelab.segment_face(
        motion.resampled(15), n_regions=10, random_state=0, progress=False
    )
    X = motion.displacements()
    sessions = [
        facelab.PosingSession(model.fit(X), mesh)
        for model in (
            facelab.RegionModel(regions, n_components),
            facelab.HolisticModel(n_components),
        )
    ]
    found = []
    for v in spread_over(mesh, n_drags):
        ways = np.linalg.svd(facelab.posing.PoseSolver(sessions[0].model).rows(v))[0]
        found.append([shares(s, v, 8 * ways[:, 0], regions.labels) for s in sessions])
    return np.array(found).transpose(1, 0, 2)


def main():
    """Print medians and quartiles for each face and model."""
    print("50 drags of 8 mm: median (quartiles)   outside the region    beyond 40 mm   pin went")
    for name, mesh, motion in faces():
        both = measure(mesh, motion)
        for model, rows in zip(("region", "holistic"), both, strict=True):
            low, mid, high = np.percentile(rows, (25, 50, 75), axis=0)
            print(
                f"{name:>14} {model:>9}   {mid[0]:13.2f} ({low[0]:.2f} to {high[0]:.2f}) "
                f"{mid[1]:9.2f} ({low[1]:.2f} to {high[1]:.2f}) {mid[2]:7.1f} mm"
            )
        won = np.mean(both[0, :, 0] < both[1, :, 0])
        print(f"{name:>14}: the region model is the more local one in {100 * won:.0f} % of drags")


if __name__ == "__main__":
    main()
