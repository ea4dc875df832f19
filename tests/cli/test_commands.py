"""Each command against the package's own functions, on faces whose answer is known."""

import json

import numpy as np
import pytest
from planted import bumpy_rig, patch_motion, quarters

import facelab
from facelab import files
from facelab.cli import main
from facelab.models import load_model
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence
from facelab.posing import Clip, PosingSession
from facelab.storage import load_npz


def done(report):
    """The numbers of the one result of a report."""
    (entry,) = json.loads(report.read_text())["done"]
    return entry


@pytest.fixture
def run(tmp_path):
    """Run a command that must succeed; gives its numbers."""

    def run(*arguments):
        report = tmp_path / "report.json"
        code = main([*map(str, arguments), "--report", str(report), "--quiet"])
        assert code == 0, report.read_text() if report.exists() else code
        return done(report)

    return run


@pytest.fixture
def rig():
    return bumpy_rig()


@pytest.fixture
def rig_file(rig, tmp_path):
    files.write_rig(tmp_path / "rig.npz", rig)
    return tmp_path / "rig.npz"


# --- register, segment and train from markers -----------------------------------------------------


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A coarse template with its landmarks, and two short takes of markers, as files."""
    folder = tmp_path_factory.mktemp("captured")
    face = facelab.load_template(4375)
    _, template = face.subsample(700, keep=list(face.landmarks.values()))
    files.write_obj(folder / "face.obj", template)
    files.write_landmarks(folder / "face.ljson", template.vertices, template.landmarks)
    capture = facelab.data.load_capture("M1", size="small", progress=False)
    (folder / "takes").mkdir()
    for name in capture.takes["train"][:2]:
        take = capture.markers(name)
        some = MarkerSequence(take.positions[:60], take.names, take.fps)
        files.write_c3d(folder / "takes" / f"{name}.c3d", some)
    return folder


@pytest.fixture
def template_options(captured):
    return ["--template", captured / "face.obj", "--landmarks", captured / "face.ljson"]


def test_takes_of_markers_become_motion_as_the_package_registers_them(
    captured, template_options, tmp_path
):
    takes = sorted((captured / "takes").iterdir())
    (captured / "takes" / "torn.c3d").write_bytes(takes[0].read_bytes()[:700])
    arguments = ["register", captured / "takes", "-o", tmp_path / "out", "--rest", takes[0]]
    arguments += [*template_options, "--report", tmp_path / "r.json"]
    assert main(list(map(str, arguments))) == 1
    (captured / "takes" / "torn.c3d").unlink()
    report = json.loads((tmp_path / "r.json").read_text())
    assert [f["input"] for f in report["failed"]] == [str(captured / "takes" / "torn.c3d")]

    mesh = facelab.read_mesh(captured / "face.obj")
    marks = files.read_landmarks(captured / "face.ljson", mesh)
    template = facelab.TriangleMesh(mesh.vertices, mesh.faces, marks)
    rest = facelab.registration.rest_markers([facelab.read_markers(takes[0])])
    fit = facelab.fit_markers(template, *rest)
    for path, said in zip(takes, report["done"], strict=True):
        registered = facelab.register_sequence(fit, facelab.read_markers(path), progress=False)
        motion = files.read_motion(tmp_path / "out" / f"{path.stem}.npz")
        np.testing.assert_array_equal(motion.positions, registered.motion().positions)
        assert said["rms_mm"] == pytest.approx(registered.rms)
        assert said["share_thrown_away"] == registered.share_rejected


def test_markers_become_a_glb_that_moves_as_the_face_did(captured, template_options, run, tmp_path):
    take = next((captured / "takes").glob("*.c3d"))
    both = [take, *template_options]
    said = run("register", *both, "-o", tmp_path / "take.glb", "--modes", 59)
    assert said["modes_rms_mm"] < 1e-6
    run("register", *both, "-o", tmp_path / "take.npz")
    rig = facelab.read_rig(tmp_path / "take.glb")
    motion = files.read_motion(tmp_path / "take.npz")
    assert rig.neutral.n_vertices == motion.mesh.n_vertices and len(rig.names) <= 60


def test_a_template_without_landmarks_is_wrong_usage(captured, tmp_path, capsys):
    take = next((captured / "takes").glob("*.c3d"))
    arguments = ["register", take, "-o", tmp_path / "x.npz", "--template", captured / "face.obj"]
    assert main(list(map(str, arguments))) == 2
    assert "--landmarks" in capsys.readouterr().err


def test_markers_train_a_model_that_poses(captured, template_options, run, tmp_path):
    out = tmp_path / "models" / "m.npz"
    said = run(
        "train", captured / "takes", *template_options, "-o", out, "--regions", 4,
        "--components", 5, "--control", 300,
    )  # fmt: skip
    assert (said["takes"], said["regions"], said["control_vertices"]) == (2, 4, 300)
    model = load_model(out)
    neutral, binding = files.read_face(tmp_path / "models" / "m.face.npz")
    session = PosingSession(model, neutral, binding=binding)
    session.drag(5, neutral.vertices[5] + [0, 2, 0])
    assert session.vertices.shape == (700, 3)


# --- train, pose ----------------------------------------------------------------------------------


@pytest.fixture
def motion_file(rng, tmp_path):
    mesh, labels = quarters(14, 12)
    motion = patch_motion(mesh, labels, rng)
    files.write_motion(tmp_path / "take.npz", motion)
    return tmp_path / "take.npz", motion, labels


@pytest.mark.parametrize("kind", ["region", "holistic"])
def test_motion_trains_the_model_that_one_call_trains(kind, motion_file, run, tmp_path):
    path, motion, _ = motion_file
    more = ["--holistic"] if kind == "holistic" else []
    said = run("train", path, "-o", tmp_path / "m.npz", "--regions", 4, "--components", 3, *more)
    face = facelab.model_from_take(motion, n_components=3, n_regions=4, progress=False)
    model, X = face.model, face.motion.displacements()
    if kind == "holistic":
        model = facelab.HolisticModel(3).fit(X)
    read = load_model(tmp_path / "m.npz")
    np.testing.assert_allclose(read.reconstruct(X), model.reconstruct(X), atol=1e-9)
    assert said["rms_mm"] == pytest.approx(facelab.rms_error(X, model.reconstruct(X)))
    assert said["coefficients"] == model.n_coefficients


def test_weights_and_a_rig_train_a_model_for_each_take(rig, rig_file, rng, tmp_path):
    (tmp_path / "takes").mkdir()
    for name in "ab":
        take = WeightSequence(rng.uniform(size=(80, 12)), rig.names, 30)
        files.write_weights_csv(tmp_path / "takes" / f"{name}.csv", take)
    out = tmp_path / "models"
    arguments = ["train", tmp_path / "takes", "--rig", rig_file, "-o", out, "--regions", 3]
    assert main([*map(str, arguments), "--components", "4"]) == 0
    both = {f"{n}{end}" for n in "ab" for end in (".npz", ".face.npz")}
    assert {p.name for p in out.iterdir()} == both
    assert load_model(out / "a.npz").n_vertices == 162


def test_motions_with_two_neutrals_make_no_model(motion_file, tmp_path, capsys):
    path, motion, _ = motion_file
    moved = motion.mesh.with_vertices(motion.mesh.vertices + [0, 0, 1])
    other = MotionSequence(motion.positions, motion.fps, moved)
    files.write_motion(tmp_path / "other.npz", other)
    arguments = ["train", path, tmp_path / "other.npz", "-o", tmp_path / "m.npz"]
    assert main(list(map(str, arguments))) == 1
    assert "another mesh" in capsys.readouterr().err and not (tmp_path / "m.npz").exists()


@pytest.fixture
def posed(motion_file, run, tmp_path):
    """A trained model's file, a pose and a clip made with it, and the posed vertices."""
    path, _, _ = motion_file
    model = tmp_path / "m.npz"
    run("train", path, "-o", model, "--regions", 4, "--components", 3, "--holistic")
    neutral, binding = files.read_face(tmp_path / "m.face.npz")
    session = PosingSession(load_model(model), neutral, binding=binding)
    session.drag(20, neutral.vertices[20] + [0, 0, 4])
    session.release()
    (tmp_path / "poses").mkdir()
    files.save_pose(tmp_path / "poses" / "up.json", session)
    rest = np.zeros(3)
    clip = Clip([0, 1], [rest, session.state.coefficients], names=["rest", "up"])
    files.save_clip(tmp_path / "clip.json", clip, session)
    return model, tmp_path, session.vertices


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
def test_a_pose_becomes_the_mesh_that_was_seen(kind, posed, run):
    model, folder, vertices = posed
    run("pose", folder / "poses", "--model", model, "-o", folder / "meshes", "--to", kind)
    mesh = facelab.read_mesh(folder / "meshes" / f"up.{kind}")
    np.testing.assert_allclose(mesh.vertices, vertices, atol=1e-4)


def test_a_clip_becomes_an_animated_glb_and_no_obj(posed, run, capsys):
    model, folder, vertices = posed
    clip = folder / "clip.json"
    assert run("pose", clip, "--model", model, "-o", folder / "clip.glb")["keys"] == 2
    rig = facelab.read_rig(folder / "clip.glb")
    np.testing.assert_allclose(rig.shape({"up": 1.0}), vertices, atol=1e-3)
    assert main(["pose", str(clip), "--model", str(model), "-o", str(folder / "c.obj")]) == 1
    assert "only GLB" in capsys.readouterr().err


def test_a_pose_of_another_model_is_refused(posed, rig_file, capsys):
    _, folder, _ = posed
    arguments = ["pose", folder / "poses", "--rig", rig_file, "-o", folder / "meshes"]
    assert main(list(map(str, arguments))) == 1
    assert "another face" in capsys.readouterr().err


def test_a_model_without_its_face_says_what_is_missing(posed, capsys):
    model, folder, _ = posed
    (folder / "m.face.npz").unlink()
    arguments = ["pose", folder / "poses", "--model", model, "-o", folder / "meshes"]
    assert main(list(map(str, arguments))) == 1
    assert "m.face.npz is not beside it" in capsys.readouterr().err


# --- segment --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["npz", "json"])
def test_planted_patches_are_found_and_coloured(ending, motion_file, run, tmp_path):
    path, _, labels = motion_file
    out = tmp_path / f"cut.{ending}"
    said = run("segment", path, "-o", out, "--regions", 4)
    if ending == "npz":
        found = load_npz(out, "regions", 1)["labels"]
    else:
        found = np.array(json.loads(out.read_text())["labels"])
    pairs = set(zip(labels.tolist(), found.tolist(), strict=True))
    assert len(pairs) == said["regions"] == 4  # each patch is one region
    colors = ply_colors(tmp_path / "cut.ply")
    assert len(np.unique(colors, axis=0)) == 4
    same = colors[:, None] == colors[None]
    np.testing.assert_array_equal(same.all(axis=2), found[:, None] == found[None])
    assert facelab.read_mesh(tmp_path / "cut.ply").n_vertices == len(labels)


def test_few_vertices_are_cut_and_all_get_labels(motion_file, run, tmp_path):
    path, _, labels = motion_file
    said = run("segment", path, "-o", tmp_path / "c.json", "--regions", 4, "--control", 90)
    found = json.loads((tmp_path / "c.json").read_text())
    assert said["control_vertices"] == 90 and len(found["labels"]) == len(labels)
    assert sorted({v for m in found["members"] for v in m}) == list(range(len(labels)))


def ply_colors(path):
    head, body = path.read_bytes().split(b"end_header\n", 1)
    n = int(head.split(b"element vertex ")[1].split()[0])
    point = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    return np.frombuffer(body[: n * point.itemsize], point)["rgb"]


# --- read-units -----------------------------------------------------------------------------------


def test_sketches_give_the_weights_that_made_them(rig, rig_file, tmp_path):
    (tmp_path / "sketches").mkdir()
    planted = {"smile": {"AU3": 0.5, "AU7": 0.25}, "frown": {"AU1": 1.0}}
    for name, kind in (("smile", files.write_obj), ("frown", files.write_ply)):
        mesh = rig.neutral.with_vertices(rig.shape(planted[name]))
        kind(tmp_path / "sketches" / f"{name}{'.obj' if name == 'smile' else '.ply'}", mesh)
    files.write_obj(tmp_path / "sketches" / "other.obj", quarters(12, 10)[0])
    arguments = ["read-units", tmp_path / "sketches", "--rig", rig_file, "-o", tmp_path / "out"]
    assert main([*map(str, arguments), "--report", str(tmp_path / "r.json")]) == 1
    for name, weights in planted.items():
        take = facelab.read_weights(tmp_path / "out" / f"{name}.csv")
        wanted = rig.weights_of(weights)
        np.testing.assert_allclose(take.weights, [wanted], atol=1e-4)
    report = json.loads((tmp_path / "r.json").read_text())
    assert "120 vertices, but the rig has 162" in report["failed"][0]["reason"]
    assert report["done"][1]["units"] == pytest.approx({"AU3": 0.5, "AU7": 0.25}, abs=1e-3)


def test_motion_gives_the_weights_over_time(rig, rig_file, rng, run, tmp_path):
    take = WeightSequence(rng.uniform(0.1, 0.9, size=(20, 12)), rig.names, 30)
    files.write_motion(tmp_path / "take.npz", rig.animate(take))
    out = tmp_path / "weights.csv"
    said = run("read-units", tmp_path / "take.npz", "--rig", rig_file, "-o", out, "--smooth", 0)
    assert said["rms_mm"] < 1e-3
    np.testing.assert_allclose(facelab.read_weights(out).weights, take.weights, atol=1e-3)


def test_a_sketch_in_the_order_of_the_rigs_own_file_finds_its_seams_closed(rig, run, tmp_path):
    """A GLB doubles vertices along seams; the rig joins them, a mesh of the file does not."""
    mesh = rig.neutral
    split = np.unique(mesh.faces[:40])  # these get a twin each, as a seam has it
    twin = np.arange(mesh.n_vertices)
    twin[split] = mesh.n_vertices + np.arange(len(split))
    F = mesh.faces.copy()
    F[:40] = twin[F[:40]]
    order = np.concatenate([np.arange(mesh.n_vertices), split])
    kept = np.unique(F)  # vertices that no triangle uses any more are left out
    F = np.searchsorted(kept, F)
    order = order[kept]
    torn = facelab.TriangleMesh(mesh.vertices[order], F)
    files.write_glb(tmp_path / "head.glb", torn, rig.deltas[:, order], rig.names)
    assert facelab.read_rig(tmp_path / "head.glb").neutral.n_vertices < len(order)
    weights = rig.weights_of({"AU3": 0.5})
    sketch = torn.with_vertices(torn.vertices + np.tensordot(weights, rig.deltas[:, order], 1))
    files.write_obj(tmp_path / "s.obj", sketch)
    out = tmp_path / "s.csv"
    said = run("read-units", tmp_path / "s.obj", "--rig", tmp_path / "head.glb", "-o", out)
    assert said["units"] == pytest.approx({"AU3": 0.5}, abs=1e-3)


def test_a_sketch_has_the_unit_of_the_shapes_that_it_was_made_from(rig, run, tmp_path, capsys):
    """Shapes in centimetres, known by their size; the sketch says as little as they do."""
    shapes, out = tmp_path / "shapes", tmp_path / "s.csv"
    shapes.mkdir()
    posed = {"neutral": {}, "AU3": {"AU3": 1}, "AU7": {"AU7": 1}}
    for name, weights in posed.items():
        in_cm = rig.neutral.with_vertices(rig.shape(weights) / 10)
        files.write_obj(shapes / f"{name}.obj", in_cm)
    sketch = rig.neutral.with_vertices(rig.shape({"AU3": 0.5}) / 10)
    files.write_obj(tmp_path / "s.obj", sketch)
    said = run("read-units", tmp_path / "s.obj", "--rig", shapes, "-o", out)
    assert said["units"] == pytest.approx({"AU3": 0.5}, abs=1e-3)
    assert capsys.readouterr().err.startswith("warning: read-units: ")  # of the unit it took


# --- translate ------------------------------------------------------------------------------------


def test_a_take_goes_to_another_rig_as_the_package_translates_it(rig, rig_file, rng, run, tmp_path):
    other = rig.renamed({name: f"shape {name}" for name in rig.names[:6]})
    files.write_rig(tmp_path / "other.npz", other)
    take = WeightSequence(rng.uniform(size=(30, 12)), rig.names, 30)
    files.write_weights_csv(tmp_path / "take.csv", take)
    rigs = ["--from", rig_file, "--into", tmp_path / "other.npz"]
    said = run("translate", tmp_path / "take.csv", *rigs, "-o", tmp_path / "to.csv", "--lam", 0)
    made = facelab.read_weights(tmp_path / "to.csv")
    wanted = facelab.expression.translate(take, rig, other, lam=0)
    assert made.names == other.names
    np.testing.assert_allclose(made.weights, wanted.weights, atol=1e-9)
    assert said["rms_mm"] == pytest.approx(np.sqrt((wanted.report.errors**2).mean()))
    assert said["rms_mm"] < 0.5 * said["size_of_motion_mm"]


# --- convert --------------------------------------------------------------------------------------


def test_weights_become_live_link_and_come_back(run, rng, tmp_path):
    names = ["jawOpen", "eyeBlinkLeft"]
    take = WeightSequence(rng.uniform(size=(10, 2)), names, 60)
    files.write_weights_csv(tmp_path / "take.csv", take)
    run("convert", tmp_path / "take.csv", "-o", tmp_path / "live.csv", "--live-link")
    read = files.read_live_link_csv(tmp_path / "live.csv")
    column = {n: read.weights[:, read.names.index(n)] for n in names}
    np.testing.assert_allclose(np.transpose([*column.values()]), take.weights, atol=1e-6)


def test_markers_become_c3d(run, tmp_path):
    path = tmp_path / "take.csv"
    path.write_text(
        "time,chin_x,chin_y,chin_z,nose_x,nose_y,nose_z\n0,1,2,3,1,40,3\n0.01,,,,1,41,3\n"
    )
    said = run("convert", path, "-o", tmp_path / "take.c3d")
    read = facelab.read_markers(tmp_path / "take.c3d")
    assert read.names == ("chin", "nose") and read.fps == 100
    assert said["share_hidden"] == 0.25 and read.visible.tolist() == [[True, True], [False, True]]


def test_a_rig_goes_from_npz_to_glb_and_back(rig, rig_file, run, tmp_path):
    run("convert", rig_file, "--rig", "-o", tmp_path / "rig.glb")
    run("convert", tmp_path / "rig.glb", "-o", tmp_path / "back.npz")
    back = facelab.read_rig(tmp_path / "back.npz")
    assert back.names == rig.names
    np.testing.assert_allclose(back.deltas, rig.deltas, atol=1e-4)


def test_a_folder_of_shapes_is_one_rig(rig, run, tmp_path):
    shapes = tmp_path / "shapes"
    shapes.mkdir()
    files.write_obj(shapes / "neutral.obj", rig.neutral)
    for name in rig.names[:3]:
        posed = rig.neutral.with_vertices(rig.shape({name: 1}))
        files.write_obj(shapes / f"{name}.obj", posed)
    assert run("convert", shapes, "--rig", "-o", tmp_path / "rig.glb")["shapes"] == 3


def test_motion_becomes_glb_and_nothing_else(motion_file, run, tmp_path, capsys):
    path, _, _ = motion_file
    assert run("convert", path, "-o", tmp_path / "take.glb", "--modes", 12)["modes_rms_mm"] < 0.1
    assert main(["convert", str(path), "-o", str(tmp_path / "take.obj")]) == 1
    assert "holds a motion" in capsys.readouterr().err


# --- what is read is not written over -------------------------------------------------------------


@pytest.mark.parametrize("report", [False, True])
def test_a_rig_that_is_read_is_never_written_over(rig, rig_file, rng, tmp_path, capsys, report):
    take = WeightSequence(rng.uniform(0, 1, (20, len(rig.names))), rig.names, 30.0)
    files.write_weights_csv(tmp_path / "take.csv", take)
    kept = rig_file.read_bytes()
    out = ["-o", tmp_path / "new.npz", "--report", rig_file] if report else ["-o", rig_file]
    arguments = ["train", tmp_path / "take.csv", "--rig", rig_file, "--again", *out]
    assert main(list(map(str, arguments))) == 2
    assert "would overwrite" in capsys.readouterr().err and rig_file.read_bytes() == kept


def test_no_mesh_is_put_among_the_shapes_of_a_rig(rig, tmp_path, capsys):
    (tmp_path / "shapes").mkdir()
    files.write_obj(tmp_path / "shapes" / "neutral.obj", rig.neutral)
    (tmp_path / "pose.json").write_text("{}")
    for name, words in (("neutral", "would overwrite"), ("new", "among the shapes of a rig")):
        out = tmp_path / "shapes" / f"{name}.obj"
        arguments = ["pose", tmp_path / "pose.json", "--rig", tmp_path / "shapes", "-o", out]
        assert main(list(map(str, arguments))) == 2
        assert words in capsys.readouterr().err


def test_the_coloured_face_of_regions_takes_no_other_mesh_its_place(motion_file, tmp_path, capsys):
    path, motion, _ = motion_file
    files.write_ply(tmp_path / "face.ply", motion.mesh)
    kept = (tmp_path / "face.ply").read_bytes()
    arguments = ["segment", path, "-o", tmp_path / "face.json", "--regions", 4]
    assert main(list(map(str, arguments))) == 1
    assert "face.ply is there" in capsys.readouterr().err
    assert (tmp_path / "face.ply").read_bytes() == kept
    named = [*arguments, "--template", tmp_path / "face.ply", "--again"]
    assert main(list(map(str, named))) == 2
    assert (tmp_path / "face.ply").read_bytes() == kept
    assert main(list(map(str, [*arguments, "--again"]))) == 0


def test_a_rig_that_cannot_be_read_stands_in_the_report_of_every_file(rig, tmp_path, capsys):
    for name in "ab":
        files.write_obj(tmp_path / f"{name}.obj", rig.neutral)
    (tmp_path / "rig.npz").write_text("no rig")
    paths = [tmp_path / name for name in ("a.obj", "b.obj", "rig.npz", "made", "report.json")]
    a, b, broken, made, report = map(str, paths)
    assert main(["read-units", a, b, "--rig", broken, "-o", made, "--report", report]) == 1
    assert capsys.readouterr().err.count("rig.npz") == 1
    failed = json.loads(paths[-1].read_text())["failed"]
    assert [entry["input"] for entry in failed] == [a, b] and "rig.npz" in failed[1]["reason"]


# --- options that would change nothing ------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["convert", "face.obj", "-o", "x.ply", "--unit", "cm"], "--unit: of no use"),
        (["convert", "take.csv", "-o", "x.csv", "--scale", "10"], "the result is CSV"),
        (["convert", "take.csv", "-o", "x.csv", "--mesh", "Head"], "--mesh"),
        (["convert", "rig.npz", "-o", "x.glb", "--rig", "--modes", "3"], "--modes"),
        (["convert", "face.obj", "-o", "x.glb", "--fps", "30"], "result is GLB"),
        (["train", "motion.npz", "-o", "x.npz", "--scale", "3"], "--scale: that is for a --rig"),
        (["segment", "take.csv", "--rig", "rig.npz", "-o", "x.npz", "--unit", "cm"], "--unit"),
        (
            ["pose", "p.json", "--model", "rig.npz", "-o", "x.obj", "--mesh", "Head"],
            "not for a --model",
        ),
        (["read-units", "face.obj", "--rig", "rig.npz", "-o", "x.csv", "--alpha", "3"], "--lam"),
    ],
)
def test_an_option_that_would_change_nothing_is_wrong_usage(
    rig_file, tmp_path, monkeypatch, capsys, arguments, words
):
    for name in ("face.obj", "take.csv", "motion.npz", "p.json"):
        (tmp_path / name).write_text("there")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert main(arguments) == 2
    assert words in capsys.readouterr().err and sorted(tmp_path.iterdir()) == before


def test_a_motion_is_neither_aligned_nor_scaled(rig, rig_file, motion_file, tmp_path, capsys):
    path = motion_file[0]
    units = ["read-units", path, "--rig", rig_file, "-o", tmp_path / "x.csv"]
    glb = ["convert", path, "-o", tmp_path / "x.glb"]
    for arguments in ([*units, "--align"], [*units, "--sketch-scale", 10], [*glb, "--scale", 10]):
        assert main(list(map(str, arguments))) == 1
        assert "is a motion" in capsys.readouterr().err


def test_a_folder_whose_name_ends_like_a_file_is_a_folder(rig, run, tmp_path):
    (tmp_path / "in").mkdir()
    files.write_obj(tmp_path / "in" / "face.obj", rig.neutral)
    (tmp_path / "made.csv").mkdir()
    run("convert", tmp_path / "in", "-o", tmp_path / "made.csv")
    assert [f.name for f in (tmp_path / "made.csv").iterdir()] == ["face.glb"]
