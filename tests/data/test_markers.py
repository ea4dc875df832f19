import os
from pathlib import Path

import numpy as np
import pooch
import pytest

from facelab.data import ANIMFACE_LANDMARKS, MARKERS, DataUnavailable, load_markers, load_template
from facelab.data import cache as cache_module
from facelab.geometry import MULTI_PIE, procrustes

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "captures" / "animface"
FRAMES = {"jaw": 1590, "eyebrows": 902}


@pytest.fixture
def animface():
    root = os.environ.get("FACELAB_ANIMFACE") or (BESIDE if BESIDE.is_dir() else None)
    if root is None:
        pytest.skip("FACELAB_ANIMFACE is not set: no AnimFace capture on this machine")
    return Path(root)


@pytest.fixture
def empty_machine(tmp_path, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    monkeypatch.delenv("FACELAB_ANIMFACE", raising=False)
    return tmp_path


# --- the mapping ----------------------------------------------------------------------------------


def test_the_mapping_leads_to_landmarks_each_once_and_left_to_left():
    assert set(ANIMFACE_LANDMARKS.values()) <= set(MULTI_PIE)
    assert len(set(ANIMFACE_LANDMARKS.values())) == len(ANIMFACE_LANDMARKS)
    sided = {"L": "left", "R": "right"}
    for marker, landmark in ANIMFACE_LANDMARKS.items():
        side = sided.get(marker[0]) if "ey" in marker[:4] else None
        side = side or next((sided[c] for c in marker.partition("_")[2] if c in sided), None)
        assert (side is None) == ("left" not in landmark and "right" not in landmark), marker
        assert side is None or side in landmark


@pytest.mark.parametrize("name", FRAMES)
def test_markers_lie_where_their_landmarks_say(animface, name):
    """Left is +x, brows are above eyes, and the template's landmarks lie near: one similarity."""
    take = load_markers(name, animface).renamed(ANIMFACE_LANDMARKS)
    at = dict(zip(take.names, np.median(take.positions[:60], axis=0), strict=True))
    for landmark in ANIMFACE_LANDMARKS.values():
        if "left" in landmark:
            assert at[landmark][0] > at["nose_tip"][0] > at[landmark.replace("left", "right")][0]
    for side in ("left", "right"):
        brow, lid, lip = (at[f"{n}"][1] for n in (f"brow_{side}_3", f"eye_{side}_upper_outer",
                                                  "lip_upper"))  # fmt: skip
        assert brow > lid > at["nose_tip"][1] > lip > at["lip_lower"][1] > at["chin"][1]
    assert at["nose_tip"][2] == max(p[2] for p in at.values())
    template = load_template(4375)
    marks = list(ANIMFACE_LANDMARKS.values())
    known = template.vertices[[template.landmarks[n] for n in marks]]
    there = np.array([at[n] for n in marks])
    fit = procrustes(known, there, scale=True)
    off = np.linalg.norm(fit.apply(known) - there, axis=1)
    assert off.max() < 16 and np.median(off) < 9
    assert 1 < fit.scale < 1.15


# --- the capture ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FRAMES)
def test_the_capture_is_what_is_known_of_it(animface, name):
    """41 markers, 60 frames a second, no gaps, jitter of at most 0.02 mm, the size of a face."""
    assert pooch.file_hash(str(animface / MARKERS[name][0])) == MARKERS[name][1]
    take = load_markers(name, animface)
    assert take.positions.shape == (FRAMES[name], 41, 3)
    assert take.fps == 60
    assert take.visible.all()
    assert take.report.notes == ()
    jitter = np.median(np.abs(np.diff(take.positions, 3, axis=0))) / np.sqrt(20)
    assert jitter < 0.02
    box = np.ptp(take.positions[0], axis=0)
    assert (box > [120, 170, 80]).all() and (box < [150, 210, 120]).all()


def test_the_first_key_of_the_first_marker_is_the_one_in_the_file(animface):
    first = load_markers("jaw", animface).positions[0, 0]
    np.testing.assert_allclose(first[0], 10 * 14.12384, atol=1e-9)


# --- where it comes from --------------------------------------------------------------------------


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match="name='nose' is unknown; choose one of 'eyebrows', 'jaw'"):
        load_markers("nose")


def test_the_environment_names_the_folder(animface, monkeypatch):
    monkeypatch.setenv("FACELAB_ANIMFACE", str(animface))
    assert load_markers("eyebrows").n_frames == 902


def test_offline_nothing_is_asked_of_the_network(empty_machine, monkeypatch):
    monkeypatch.setenv("FACELAB_OFFLINE", "1")
    monkeypatch.setattr(cache_module.pooch, "retrieve", lambda *_, **__: pytest.fail("asked"))
    with pytest.raises(DataUnavailable, match=r"FACELAB_OFFLINE=1 forbids .* FACELAB_ANIMFACE"):
        load_markers("jaw")


def test_offline_what_was_fetched_before_is_used_if_it_is_whole(
    empty_machine, animface, monkeypatch
):
    monkeypatch.setenv("FACELAB_OFFLINE", "1")
    kept = empty_machine / "animface" / "JawMoCap.ma"
    kept.parent.mkdir()
    kept.write_bytes((animface / "JawMoCap.ma").read_bytes())
    assert load_markers("jaw").n_frames == 1590
    kept.write_bytes(kept.read_bytes().replace(b"14.1", b"15.1", 1))
    with pytest.raises(DataUnavailable, match=r"JawMoCap\.ma is damaged in the cache"):
        load_markers("jaw")


def test_a_download_is_pinned(empty_machine, monkeypatch):
    asked = []
    monkeypatch.delenv("FACELAB_OFFLINE", raising=False)

    def retrieve(url, known_hash, **_):
        asked.append((url, known_hash))
        raise ConnectionError

    monkeypatch.setattr(cache_module.pooch, "retrieve", retrieve)
    with pytest.raises(DataUnavailable, match="ConnectionError"):
        load_markers("jaw")
    ((url, known_hash),) = asked
    assert url.endswith("/6b5063b8b5e7a5a10473647081b07d03b07042e7/MoCapData/JawMoCap.ma")
    assert known_hash == f"sha256:{MARKERS['jaw'][1]}"
