"""The four actors, and others drawn at random around them.

Two sexes and two population averages; each actor is the average of its group with its own
deviations, so that they differ in proportion and not only in size.
"""

from dataclasses import fields, replace

import numpy as np

from data_synth.anatomy import Anatomy

ACTORS = {
    # European man of about 35: long face, high narrow nose, strong brow and jaw
    "M1": Anatomy(
        bizygomatic_width=140.0, bigonial_width=112.0, chin_width=48.0, forehead_height=58.0,
        nose_height=54.0, nasal_protrusion=21.5, rhinion_convexity=1.8, brow_ridge=1.2,
        brow_height=19.5, lid_crease_height=3.9, chin_height=30.0, pogonion_depth=30.0,
        gonial_flare=1.5, cheek_fullness=-1.5, mouth_width=54.0, upper_vermilion_height=6.6,
        nasolabial_fold=0.9,
    ),
    # European woman of about 25: short lower face, fine nose, full lips, open eyes
    "F1": Anatomy(
        bizygomatic_width=131.0, bigonial_width=97.0, bitemporal_width=139.0,
        frontal_width=108.0, chin_width=39.0, forehead_height=55.0, nose_height=48.0,
        nose_width=31.5, nose_tip_width=13.5, nasal_protrusion=18.8, rhinion_convexity=0.2,
        nose_bridge_width=13.5, glabella_depth=23.5, nasion_depth=19.5, brow_ridge=-1.2,
        brow_height=23.0, chin_height=24.5, palpebral_height_upper=5.3,
        upper_vermilion_height=8.8, lower_vermilion_height=10.8, upper_lip_fullness=2.1,
        lower_lip_fullness=3.0, philtrum_length=13.0, mouth_width=48.5, malar_prominence=1.2,
        gonial_flare=-1.0, lid_crease_height=4.4,
    ),
    # East Asian man of about 60: broad cheekbones and jaw, low bridge, heavy lids, jowls
    "M2": Anatomy(
        bizygomatic_width=147.0, bigonial_width=117.0, bitemporal_width=153.0,
        frontal_width=115.0, chin_width=49.0, forehead_height=57.0, nose_height=53.0,
        nose_width=39.5, nose_bridge_width=17.5, nasal_protrusion=18.4, nasion_depth=18.0,
        glabella_depth=24.2, nose_tip_width=18.0, rhinion_convexity=0.2,
        intercanthal_width=36.5, biocular_width=93.0, interpupillary_distance=65.5,
        palpebral_height_upper=3.7, palpebral_height_lower=4.1, canthal_tilt=4.5,
        lid_crease_height=3.2, lid_crease_depth=0.4, lid_fold=2.0, epicanthus=0.9,
        orbit_depth=-1.2, eye_bag=1.7, tear_trough=0.9, mouth_width=53.0,
        upper_vermilion_height=5.8, lower_vermilion_height=8.6, malar_prominence=1.0,
        jowl=2.8, nasolabial_fold=2.1, marionette_fold=1.3, submental_fullness=3.0,
        philtrum_length=16.8, exocanthion_depth=4.0, temple_hollow=1.2, cheek_fullness=-1.0,
        nasion_height=4.5,
    ),
    # East Asian woman of about 40: round face, gentle profile, short nose, full lips
    "F2": Anatomy(
        bizygomatic_width=139.0, bigonial_width=106.0, bitemporal_width=145.0,
        frontal_width=110.0, chin_width=40.0, forehead_height=57.0, nose_height=48.5,
        nose_width=36.0, nose_bridge_width=16.0, nasal_protrusion=17.8,
        nose_tip_height=11.0, nasion_depth=17.0,
        glabella_depth=22.6, nose_tip_width=16.5, rhinion_convexity=-0.6,
        intercanthal_width=35.5, biocular_width=89.5, interpupillary_distance=62.5,
        palpebral_height_upper=4.3, canthal_tilt=5.5, lid_crease_height=3.0,
        lid_crease_depth=0.3, lid_fold=0.8, epicanthus=0.9, orbit_depth=-1.2, brow_ridge=-0.5,
        brow_height=23.0, upper_vermilion_height=8.4, lower_vermilion_height=10.4,
        upper_lip_fullness=2.0, lower_lip_fullness=3.0, mouth_width=48.0, cheek_fullness=2.6,
        malar_prominence=1.0, chin_height=25.0, pogonion_depth=26.5, exocanthion_depth=4.0,
        tear_trough=0.2, alar_bulge=1.5, nasion_height=4.5,
    ),
}  # fmt: skip

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
            mean = sum(w * getattr(a, field.name) for w, a in zip(share, ACTORS.values(),
                                                                   strict=True))  # fmt: skip
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
    "glabella_depth": 0.7, "metopion_depth": 0.8, "subnasale_depth": 0.9,
    "labrale_superius_depth": 0.5, "stomion_depth": 0.4, "labrale_inferius_depth": 0.5,
    "sublabiale_depth": 0.6, "canthal_tilt": 1.2,
}  # fmt: skip
_NOT_NEGATIVE = ("epicanthus", "lid_fold", "eye_bag", "chin_cleft", "lid_crease_depth",
                 "cupids_bow", "alar_bulge", "philtrum_depth")  # fmt: skip
