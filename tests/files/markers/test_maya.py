import numpy as np
import pytest
from mutants import COUNT, tally

from facelab.files import read_markers

NAMES = ["Chin", "NoseHead", "Mouth_Up", "Brow_L", "Brow_R", "Jaw_L"]


@pytest.fixture
def P(rng):
    """12 frames of 6 markers in millimetres."""
    return (rng.normal(scale=50, size=(6, 3)) + rng.normal(scale=2, size=(12, 6, 3))).round(4)


def scene(P, names=NAMES, unit="centimeter", time="film", step=0.4, size=10.0, parent="", more=""):
    """A scene as Maya writes it: keys in two runs, curves called otherwise than their nodes."""
    lines = ["//Maya ASCII 2017 scene", "//Name: take.ma", 'requires maya "2017";']
    lines += [f"currentUnit -l {unit} -a degree -t {time};", 'fileInfo "application" "maya";']
    lines += ['createNode transform -s -n "persp";', '\tsetAttr ".t" -type "double3" 9 76 40 ;']
    lines += ['createNode transform -n "MoCapData";', *parent.splitlines()]
    for name in names:
        lines += [f'createNode transform -n "{name}" -p "MoCapData";']
        lines += [f'createNode mesh -n "{name}Shape" -p "{name}";', '\tsetAttr -k off ".v";']
    for i in range(len(names)):
        for axis, track in zip("XYZ", (P[:, i] / size).T, strict=True):
            lines += [
                f'createNode animCurveTL -n "curve{i}_translate{axis}";',
                '\tsetAttr ".tan" 18;',
            ]
            lines += [f'\tsetAttr -s {len(track)} ".ktv";']
            half = len(track) // 2
            for a, b in ((0, half), (half, len(track))):
                keys = [f"{step * k:.12g} {track[k]:.17g}" for k in range(a, b)]
                lines += [f'\tsetAttr ".ktv[{a}:{b - 1}]"  {" ".join(keys[:3])}']
                lines += [f"\t\t {' '.join(keys[3:])};"]
    lines += ['createNode script -n "ui";', '\tsetAttr ".b" -type "string" (', '\t\t"a; b\\n"']
    lines += ['\t\t+ "}\\n");', *more.splitlines()]
    for i, name in enumerate(names):
        for axis in "XYZ":
            end = f'"{name}.t{axis.lower()}"'
            lines.append(f'connectAttr "curve{i}_translate{axis}.o" {end};')
        lines.append(f'connectAttr "{name}Shape.iog" ":initialShadingGroup.dsm" -na;')
    return "\n".join([*lines, "// End of take.ma", ""])


def read(tmp_path, text, **options):
    (tmp_path / "take.ma").write_text(text)
    return read_markers(tmp_path / "take.ma", **options)


def test_the_curves_of_markers_come_back_in_millimetres(tmp_path, P):
    take = read(tmp_path, scene(P))
    np.testing.assert_allclose(take.positions, P, rtol=1e-12)
    assert (take.names, take.fps) == (tuple(NAMES), 60.0)


@pytest.mark.parametrize(
    "time, step, fps",
    [("film", 0.2, 120), ("ntscf", 1, 60), ("pal", 0.5, 50), ("120fps", 1, 120),
     ("29.97fps", 1, 29.97), ("game", 1, 15)],
)  # fmt: skip
def test_the_rate_is_the_spacing_of_the_keys(tmp_path, P, time, step, fps):
    assert read(tmp_path, scene(P, time=time, step=step)).fps == fps
    assert read(tmp_path, scene(P, time=time, step=step), fps=33).fps == 33


@pytest.mark.parametrize("unit, size", [("millimeter", 1), ("meter", 1000), ("inch", 25.4)])
def test_units_of_the_scene_are_known(tmp_path, P, unit, size):
    take = read(tmp_path, scene(P, unit=unit, size=size))
    np.testing.assert_allclose(take.positions, P, rtol=1e-12)
    assert read(tmp_path, scene(P, unit="parsec"), unit="cm").n_frames == 12
    with pytest.raises(ValueError, match="currentUnit -l is 'parsec'"):
        read(tmp_path, scene(P, unit="parsec"))


@pytest.mark.parametrize(
    "parent", ['\tsetAttr ".t" -type "double3" 0 5 0 ;', '\tsetAttr ".s" -type "double3" 1 1 2 ;',
               '\tsetAttr ".rx" 90;']
)  # fmt: skip
def test_markers_below_a_node_that_is_moved_are_refused(tmp_path, P, parent):
    with pytest.raises(ValueError, match="Chin stands below MoCapData, which is itself moved"):
        read(tmp_path, scene(P, parent=parent))


def test_a_parent_that_rests_is_no_matter(tmp_path, P):
    rest = '\tsetAttr ".t" -type "double3" 0 0 0 ;\n\tsetAttr ".s" -type "double3" 1 1 1 ;'
    np.testing.assert_allclose(read(tmp_path, scene(P, parent=rest)).positions, P, rtol=1e-12)


def test_a_marker_without_a_curve_for_each_axis_is_left_out_with_a_warning(tmp_path, P):
    text = scene(P).replace('connectAttr "curve2_translateY.o" "Mouth_Up.ty";\n', "")
    with pytest.warns(
        UserWarning, match=r"1 node.s. without curves .* left out: MoCapData.Mouth_Up"
    ):
        take = read(tmp_path, text)
    assert take.names == tuple(n for n in NAMES if n != "Mouth_Up")
    assert "3 curve(s) of nothing that is a marker left out: curve2_" in str(take.report)


def test_a_key_that_is_not_there_is_a_hidden_marker(tmp_path, P):
    text = scene(P)
    for axis in "XYZ":  # the last key of one marker
        a = text.index(f'"curve3_translate{axis}"')
        b = text.index(";\n", text.index(".ktv[6:11]", a))
        shorter = text[a:b].rsplit(" ", 2)[0]
        shorter = shorter.replace("-s 12", "-s 11").replace(".ktv[6:11]", ".ktv[6:10]")
        text = text[:a] + shorter + text[b:]
    take = read(tmp_path, text)
    assert np.argwhere(~take.visible).tolist() == [[11, 3]]
    assert "1 position(s) without a key taken for hidden" in take.report.notes


@pytest.mark.parametrize(
    "old, new, words",
    [
        (" 1.2 ", " 1.3 ", "keys do not lie on one beat"),
        ('-s 12 ".ktv"', '-s 13 ".ktv"', "has 12 keys, but says 13"),
        (".ktv[6:11]", ".ktv[6:12]", "not 14 numbers that follow the 6 before"),
        (".ktv[6:11]", ".ktv[7:12]", "not 12 numbers that follow the 6 before"),
        ("  0 ", "  1_0 ", "the keys 0 to 5 of the curve curve0_translateX are not"),
        (" 0.8 ", " 0.2 ", "keys of curve0_translateX do not run forwards"),
        ("// End of", "", "cut short"),
        ("//Maya ASCII", "//Maya BINARY", "not a Maya ASCII scene"),
        ("-t film", "-t moon", "its unit of time, 'moon', is unknown"),
        ('"NoseHead.tx"', '"Chin.tx"', "two things move Chin.tx"),
        ("animCurveTL", "animCurveTA", "no node in it is moved by curves"),
    ],
)  # fmt: skip
def test_what_does_not_fit_together_is_refused(tmp_path, P, old, new, words):
    count = -1 if old in ("animCurveTL",) else 1
    with pytest.raises(ValueError, match=words):
        read(tmp_path, scene(P).replace(old, new, count))


def test_what_a_mutant_says_does_not_contradict_itself(tmp_path, P, rng):
    def contradicts(take, data, said):
        if not np.isfinite(take.positions[take.visible]).all():
            return "positions that are not finite"
        keys = data.decode("utf-8", "replace").count('12 ".ktv"')
        whole = take.positions.shape == P.shape or keys < 18
        return (
            "" if whole or said or "hidden" in str(take.report.notes) else "frames or markers lost"
        )

    found = tally(read_markers, scene(P).encode(), "m.ma", tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found
    assert found.slowest < 10
