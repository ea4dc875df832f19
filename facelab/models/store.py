"""Models from files."""

import numpy as np

from facelab.checks import as_finite
from facelab.models.holistic import HolisticModel
from facelab.models.region import FILE, RegionModel
from facelab.segmentation.regions import unpacked_regions
from facelab.storage import load_npz


def load_model(path):
    """The model that `RegionModel.save` wrote, ready to use.

    Returns
    -------
    RegionModel or HolisticModel

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, incomplete, of another kind or of another version.
    """
    stored = load_npz(path, *FILE)
    try:
        n = stored["n_components"].item()
        if str(stored["model"]) == "HolisticModel":
            model = HolisticModel(n)
        else:
            regions = unpacked_regions(stored) if "labels" in stored else None
            beta, spread, blending = (stored[k].item() for k in ("beta", "spread", "blending"))
            model = RegionModel(regions, n, beta, spread, blending)
        model._check_settings()
        model.mean_, model.n_features_in_ = stored["mean"], len(stored["mean"])
        columns = model._columns(len(model.mean_))
        counts = stored["counts"]
        sizes = counts * [len(c) for c in columns]
        flat = np.split(
            as_finite(stored["components"], "components", (sizes.sum(),)), sizes.cumsum()
        )
        components = [x.reshape(p, -1) for x, p in zip(flat[:-1], counts, strict=True)]
        variances = None
        if "variances" in stored:
            variances = np.split(stored["variances"], counts.cumsum())[:-1]
        return model._set_bases(columns, components, variances)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise ValueError(
            f"{path}: parts of the model are missing or do not fit together ({error}); save the "
            "model again."
        ) from error
