"""Other people than the actors, drawn at random around them."""

from dataclasses import fields, replace

import numpy as np

from data_synth.actors import ACTORS
from data_synth.anatomy import Anatomy

# Measurements that age, in mm between about 25 and 65.
_AGEING = {
    "jowl": 3.0, "nasolabial_fold": 1.3, "marionette_fold": 1.0, "eye_bag": 1.6,
    "tear_trough": 1.2, "lid_fold": 1.2, "submental_fullness": 2.5, "temple_hollow": 1.0,
    "upper_vermilion_height": -1.6, "lower_vermilion_height": -1.4, "philtrum_length": 1.6,
    "palpebral_height_upper": -0.6, "upper_lip_fullness": -0.6,
}  # fmt: skip


def random_identity(random_state=None):
    """Draw a plausible anatomy.

    A random mixture of the actors gives sex and origin, individual deviation is added to
    every measurement (about 4 % of it, or 0.5 mm for small ones), and age on top.

    Parameters
    ----------
    random_state : int, numpy.random.Generator or None
        Seed; equal seeds give equal faces.

    Returns
    -------
    Anatomy
    """
    rng = np.random.default_rng(random_state)
    for _ in range(100):
        share = rng.dirichlet(np.full(len(ACTORS), 0.8))
        own = {}
        for field in fields(Anatomy):
            each = [getattr(actor.anatomy, field.name) for actor in ACTORS.values()]
            mean = sum(w * value for w, value in zip(share, each, strict=True))
            spread = 0.5 if abs(field.default) < 12.0 else 0.035 * abs(field.default)
            if field.name in _STIFF:
                spread = _STIFF[field.name]
            own[field.name] = mean + spread * np.clip(rng.normal(), -2.0, 2.0)
        # an eyeball sits between its canthi, a little outward of the middle
        lids = 0.5 * (own["biocular_width"] + own["intercanthal_width"])
        own["interpupillary_distance"] = lids + 1.75 + 0.3 * np.clip(rng.normal(), -2.0, 2.0)
        age = rng.uniform(-0.3, 0.7)
        for name, change in _AGEING.items():
            own[name] += age * change
        own = {name: float(value) for name, value in own.items()}
        for name in _NOT_NEGATIVE:
            own[name] = max(own[name], 0.0)
        own["epicanthus"] = min(own["epicanthus"], 1.0)
        try:
            return replace(Anatomy(), **own)
        except ValueError:  # a rare impossible combination: draw again
            continue
    raise RuntimeError("no plausible anatomy in 100 draws; report the random_state")


# Measurements that vary less than the general rule.
_STIFF = {
    "eyeball_radius": 0.25, "lid_thickness": 0.12, "lip_gap": 0.0, "epicanthus": 0.08,
    "lid_crease_depth": 0.2, "chin_cleft": 0.15, "nostril_depth": 0.3,
    "intercanthal_width": 1.0, "biocular_width": 1.4,
    "lower_lip_fullness": 0.3, "upper_lip_fullness": 0.25, "philtrum_depth": 0.25,
    "brow_hair": 0.15, "glabella_depth": 0.7, "metopion_depth": 0.8, "subnasale_depth": 0.9,
    "labrale_superius_depth": 0.5, "stomion_depth": 0.4, "labrale_inferius_depth": 0.5,
    "sublabiale_depth": 0.6, "canthal_tilt": 1.2,
}  # fmt: skip
_NOT_NEGATIVE = ("epicanthus", "lid_fold", "eye_bag", "chin_cleft", "lid_crease_depth",
                 "cupids_bow", "alar_bulge", "philtrum_depth", "brow_hair")  # fmt: skip
