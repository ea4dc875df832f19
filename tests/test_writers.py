"""Every kind of file is there whole, old or new, when its writer is killed or has no room."""

import os

import pytest
from writers import Written, kills, resource, starvation

from facelab.files.obj import write_obj

pytestmark = pytest.mark.skipif(os.name != "posix" or resource is None, reason="asks POSIX")


@pytest.fixture
def written(tmp_path):
    return Written(tmp_path)


def test_killed_writers_leave_the_old_file_or_the_new_one(written):
    found = kills(written, 60)
    assert found["the old file"] + found["the new file"] == 60


def test_on_a_full_disk_every_writer_says_so_and_the_old_file_stands(written):
    assert len(starvation(written, 20)) == 10


def test_a_writer_that_replaces_before_it_has_written_is_found_out(written):
    def careless(path):
        mesh = written.writers[0]["mesh.obj"].keywords["mesh"]
        path.write_bytes(b"")
        write_obj(path, mesh.with_vertices(mesh.vertices + 1))

    written.writers[1]["mesh.obj"] = careless
    with pytest.raises(AssertionError, match=r"mesh\.obj"):
        starvation(written, 10)
