"""Registration against the synthetic truth, beside two peers, and how fast it is.

Peers: `trimesh.registration.nricp_amberg` on the same neutral, and an interpolation by radial basis
functions of every frame's seen markers. Synthetic actors; the template is the average face.
"""

import time
import warnings

import numpy as np
import trimesh
from scipy.interpolate import RBFInterpolator
from setup import milliseconds
from threadpoolctl import threadpool_limits
from trimesh.registration import nricp_amberg

import facelab
from data_synth.action_units import actor_rig
from data_synth.actors import ACTORS
from data_synth.template import build_template
from facelab.data.cache import DataUnavailable
from facelab.geometry.alignment import procrustes
from facelab.geometry.closest import closest_points
from facelab.motion import MarkerSequence
from facelab.registration import fit_markers, fit_scan, rest_markers
from facelab.registration.sequence import register_sequence


def template(n_vertices):
    """The average face with its landmarks."""
    face = build_template(n_vertices=n_vertices)
    names = dict(zip(facelab.geometry.MULTI_PIE, face.landmarks.tolist(), strict=True))
    return facelab.TriangleMesh(face.vertices, face.faces, names)


def fitted(actor, mesh):
    """A small capture, its fitted neutral, and the seconds that took."""
    capture = facelab.data.load_capture(actor, size="small", progress=False)
    positions, names = rest_markers([capture.markers(take) for take in capture.texts])
    start = time.perf_counter()
    fit = fit_markers(mesh, positions, names)
    return capture, fit, time.perf_counter() - start


def correspondence(vertices, truth):
    """Distance of each vertex from its true place, the heads brought together, mm."""
    return np.linalg.norm(procrustes(vertices, truth).apply(vertices) - truth, axis=1)


def head_errors(fit, capture, take, head):
    """RMS over a take, degrees and mm: the turn, and the place between the eyes."""
    truth, face = capture.truth(take), capture.neutral
    feet, normals = capture.sites.feet_and_normals(
        face.vertices[face.faces[capture.sites.faces]][None]
    )
    at = [capture.sites.names.index(name) for name in fit.names]
    link = procrustes((feet + fit.offset * normals)[0, at], fit.rest)
    motion = register_sequence(fit, capture.markers(take), head=head).head
    turn = np.einsum("fij,jk,flk->fil", motion.rotation, link.rotation, truth.rotation)
    angle = np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1))
    place = motion.rotation @ link.translation + motion.translation - truth.translation
    return np.degrees(np.sqrt((angle**2).mean())), np.sqrt((place**2).sum(axis=1).mean())


def with_gaps(markers, share, rng, seconds=0.12):
    """The same take with more markers occluded, in bursts, until `share` is missing."""
    hidden = ~markers.visible
    length = max(1, round(seconds * markers.fps))
    while hidden.mean() < share:
        first, marker = rng.integers(markers.n_frames), rng.integers(markers.n_markers)
        hidden[first : first + length, marker] = True
    positions = np.where(hidden[..., None], np.nan, markers.positions)
    return MarkerSequence(positions, markers.names, markers.fps)


def rms(values):
    return float(np.sqrt((values**2).mean()))


def neutrals(mesh):
    """Print how well neutrals correspond; give captures, fits, and true neutrals."""
    print(f"neutrals, {mesh.n_vertices} vertices   s  markers mm  surface rms, p95 mm  "
          "unused landmarks mean, max mm")  # fmt: skip
    made = {}
    for actor in ACTORS:
        capture, fit, seconds = fitted(actor, mesh)
        rig = actor_rig(actor, mesh.n_vertices)
        off = correspondence(fit.mesh.vertices, rig.neutral.vertices)
        unused = [v for name, v in mesh.landmarks.items() if name not in fit.landmarks]
        print(
            f"{actor:>22} {seconds:7.2f} {fit.rms:11.2f} {rms(off):13.2f} "
            f"{np.percentile(off, 95):6.2f} {off[unused].mean():22.2f} {off[unused].max():6.2f}"
        )
        made[actor] = capture, fit, rig
    return made


def peer_neutral(mesh):
    """The same neutral by nricp_amberg, on a coarse template: it takes minutes on a dense one."""
    capture, fit, seconds = fitted("M1", mesh)
    truth = capture.neutral.vertices
    at = [fit.names.index(name) for name in fit.landmarks]
    grown = trimesh.Trimesh(fit.steps["similarity"], mesh.faces, process=False)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer = nricp_amberg(
            grown,
            trimesh.PointCloud(fit.rest),
            source_landmarks=np.array([mesh.landmarks[n] for n in fit.landmarks]),
            target_positions=fit.rest[at],
            use_faces=False,
        )
    peer_seconds = time.perf_counter() - start
    ours, theirs = (rms(correspondence(V, truth)) for V in (fit.mesh.vertices, peer))
    print(f"M1, {mesh.n_vertices} vertices: facelab {seconds:.2f} s, {ours:.2f} mm; "
          f"nricp_amberg {peer_seconds:.1f} s, {theirs:.2f} mm")  # fmt: skip


def rbf_frames(fit, registration, frames):
    """Dense displacements by radial basis functions through the seen markers of each frame."""
    feet = fit.rest
    moved = []
    for frame in frames:
        seen = registration.seen[frame]
        warp = RBFInterpolator(feet[seen], registration.displacements[frame, seen], kernel="linear")
        moved.append(warp(fit.mesh.vertices))
    return np.array(moved)


def sequences(made, take="rage_1"):
    """Print the errors of dense motion, ours and the peer's, and of head motion."""
    print(f"\n{take}: dense motion, RMS mm over skin within 11 mm of a marker   head: degrees, mm")
    print("actor    ours   +20 % missing   RBF   confidence    rigid parts    whole face")
    for actor, (capture, fit, rig) in made.items():
        markers, truth = capture.markers(take), capture.truth(take)
        frames = np.arange(0, markers.n_frames, 4)
        true = rig.animate(truth.weights.weights[frames]) - rig.neutral.vertices
        link = procrustes(fit.mesh.vertices, rig.neutral.vertices)
        near = rig.neutral.geodesics(np.unique(fit.mesh.faces[fit.faces][:, 0])).min(axis=0) < 11

        def error(moved, true=true, link=link, near=near):
            return rms(np.linalg.norm(moved @ link.rotation.T - true, axis=2)[:, near])

        whole = register_sequence(fit, markers)
        gappy = with_gaps(markers, 0.2, np.random.default_rng(0))
        less = register_sequence(fit, gappy)
        ours, fewer = (r.positions(frames) - fit.mesh.vertices for r in (whole, less))
        peer = error(rbf_frames(fit, whole, frames))
        heads = [head_errors(fit, capture, take, head) for head in ("rigid", "whole")]
        print(
            f"{actor:>5} {error(ours):7.2f} {error(fewer):15.2f} {peer:5.2f} "
            f"{rms(whole.confidence[near]):12.2f}"
            + "".join(f"{angle:9.2f}, {place:.2f}" for angle, place in heads)
        )


def speed(capture, fit):
    """Print frames a second, by step."""
    take = capture.markers("rage_1")
    many = np.concatenate([take.positions] * 6)
    markers = MarkerSequence(many, take.names, take.fps)
    gappy = with_gaps(markers, 0.2, np.random.default_rng(0))
    vertices, _ = fit.mesh.subsample(397)
    registration = register_sequence(fit, markers)
    n, rows = markers.n_frames, []
    rows.append(("layout, once", None, milliseconds(lambda: type(fit.layout)(fit), 3)))
    rows.append(
        ("head, faults, occlusion", n, milliseconds(lambda: register_sequence(fit, markers), 3))
    )
    rows.append(
        ("the same, 20 % missing", n, milliseconds(lambda: register_sequence(fit, gappy), 3))
    )
    rows.append(
        (f"{fit.mesh.n_vertices} vertices", n, milliseconds(lambda: registration.positions(), 3))
    )
    rows.append(
        ("397 vertices", n, milliseconds(lambda: registration.positions(None, vertices), 3))
    )
    frames = range(5)
    rows.append(
        ("RBF per frame", 5, milliseconds(lambda: rbf_frames(fit, registration, frames), 3))
    )
    print(f"\nspeed, {fit.mesh.n_vertices} vertices, {len(fit.names)} markers")
    for name, count, ms in rows:
        print(f"{name:>26} {ms:9.1f} ms" + (f" {1000 * count / ms:9.0f} frames/s" if count else ""))


def scans(mesh):
    """Print how well the template fits scanned identities of ICT-FaceKit."""
    try:
        rig = facelab.load_ict_facekit(area="face", n_identities=20)
    except DataUnavailable as missing:
        print("without scanned faces:", missing)
        return
    rng = np.random.default_rng(0)
    modes = np.stack(list(rig.identities.values()))
    print("\nscanned identities    s  distance mean, p95, all mm  drawn  landmarks not used mm")
    # contour landmarks of two conventions differ along the jaw: they are not held out
    held = [n for n in facelab.geometry.MULTI_PIE if not n.startswith("jaw")][::4]
    for k in range(4):
        shift = np.tensordot(rng.normal(size=len(modes)) * (k > 0), modes, 1)
        scan = rig.neutral.with_vertices(rig.neutral.vertices + shift)
        start = time.perf_counter()
        fit = fit_scan(mesh, scan, [n for n in scan.landmarks if n not in held])
        seconds = time.perf_counter() - start
        scan = scan.with_vertices(fit.alignment.apply(scan.vertices))
        faces, weights = closest_points(scan, fit.mesh.vertices)
        place = np.einsum("nc,ncx->nx", weights, scan.vertices[scan.faces[faces]])
        off = np.linalg.norm(place - fit.mesh.vertices, axis=1)
        marks = [
            fit.mesh.vertices[mesh.landmarks[n]] - scan.vertices[scan.landmarks[n]] for n in held
        ]
        print(
            f"{k:>18} {seconds:5.2f} {off.mean():13.2f} {np.percentile(off, 95):5.2f} "
            f"{len(fit.residuals) / len(off):16.2f} {np.linalg.norm(marks, axis=1).mean():10.2f}"
        )


def main():
    """Print errors and times."""
    with threadpool_limits(1):
        made = neutrals(template(8820))
        peer_neutral(template(3000))
        sequences(made)
        speed(*made["M1"][:2])
        scans(template(8820))


if __name__ == "__main__":
    main()
