"""Models from files."""

from facelab.checks import check_choice
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import ARRAYS, FILE, RegionModel
from facelab.storage import open_npz

_KINDS = {kind.__name__: kind for kind in (GlobalLocalModel, HolisticModel, RegionModel)}


def load_model(path):
    """The model that `RegionModel.save` wrote, ready to use.

    Returns
    -------
    RegionModel, HolisticModel or GlobalLocalModel

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, incomplete, of another kind or of another version.
    """
    with open_npz(path, *FILE) as stored:
        stored.refuse_others(ARRAYS)
        kind = check_choice(str(stored.read("model", (), "U")), "model", _KINDS)
        return _KINDS[kind].unpacked(stored)
