"""What is no value of a parameter at all is refused in our words, by its name."""

import traceback
from pathlib import Path

import numpy as np
import pytest
from planted import patch_motion, quarters

import facelab
from facelab import geometry, models, posing, segmentation

HOME = Path(facelab.__file__).parent
WRONG = {"a text": "x", "a number": -2.5, "an object": object(), "a set": {3}}


def _calls():
    """Public functions with arguments that they take."""
    mesh, labels = quarters(6, 5)
    motion = patch_motion(mesh, labels, np.random.default_rng(1), n_frames=40)
    X = motion.displacements()
    regions = segmentation.Regions(labels, mesh)
    model = facelab.RegionModel(regions, 3).fit(X)
    session = facelab.PosingSession(model, mesh)
    rest = session.state
    session.pull(3, mesh.vertices[3] + [0, 0, 2])
    points = mesh.vertices
    quick = {"n_init": 1, "progress": False}

    def segment(motion, random_state):
        return facelab.segment_face(motion, n_regions=3, random_state=random_state, **quick)

    return {
        "segment_face": (segment, dict(motion=motion, random_state=0)),
        "compactness": (segmentation.compactness, dict(labels=labels, mesh=mesh)),
        "Regions": (segmentation.Regions, dict(labels=labels, mesh=mesh, rings=1)),
        "carried_to": (regions.carried_to, dict(mesh=mesh, samples=np.arange(30))),
        "rms_error": (facelab.rms_error, dict(X=X, X_hat=X)),
        "error_curves": (models.error_curves, dict(models=[model], X=X, targets={"all": X})),
        "sparse_model": (models.sparse_model, dict(X=X, n_components=2, alpha=1.0)),
        "localised_model": (
            models.localised_model,
            dict(X=X, mesh=mesh, n_components=2, support=(5.0, 20.0), rounds=1),
        ),
        "bind_to_samples": (
            facelab.bind_to_samples,
            dict(mesh=mesh, samples=np.arange(0, 30, 2), motion=motion),
        ),
        "procrustes": (geometry.procrustes, dict(source=points, target=points, weights=None)),
        "rigid_motion": (
            geometry.rigid_motion,
            dict(positions=motion.positions, reference=points, weights=None),
        ),
        "MotionSequence": (
            facelab.MotionSequence,
            dict(positions=motion.positions, fps=30.0, mesh=mesh),
        ),
        "with_noise": (motion.with_noise, dict(sigma=0.1, random_state=0)),
        "Clip.of": (posing.Clip.of, dict(keys=[(0.0, rest), (1.0, session.state)])),
        "overlay": (session.overlay, dict(track=np.zeros((2, model.n_coefficients)))),
        "vertices_in": (session.vertices_in, dict(state=rest)),
    }


CASES = [(name, part) for name, (_, parts) in _calls().items() for part in parts]


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize(("name", "part"), CASES)
def test_what_is_no_value_is_refused_in_our_words(name, part, wrong):
    function, right = _calls()[name]
    function(**right)
    with pytest.raises((TypeError, ValueError)) as refused:
        function(**{**right, part: wrong})
    place = traceback.extract_tb(refused.tb)[-1]
    assert HOME in Path(place.filename).parents, f"refused by {place.filename}"
    assert "raise" in place.line, f"broke at {place.line!r}: {refused.value}"


@pytest.mark.parametrize("seed", [np.random.default_rng(3), np.random.RandomState(3), 3, None])
def test_every_kind_of_generator_is_a_seed(seed):
    mesh, labels = quarters(6, 5)
    motion = patch_motion(mesh, labels, np.random.default_rng(1), n_frames=40)
    cut = facelab.segment_face(motion, n_regions=4, random_state=seed, n_init=2, progress=False)
    assert cut.n_regions == 4 and motion.with_noise(0.1, seed).n_frames == 40
