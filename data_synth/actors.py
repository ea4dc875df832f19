"""The four actors: how each is built, how the skin answers, how they move, what they wear.

All that makes an actor stands here: add one, and every capture, table and test has five. Two sexes
and two population averages; each is the average of its group with its own deviations, so that they
differ in proportion and not only in size.
"""

from dataclasses import dataclass

from data_synth.anatomy import Anatomy


@dataclass(frozen=True)
class Style:
    """How one person's skin answers to the muscles; factors without unit unless said otherwise.

    Attributes
    ----------
    spread : float
        Reach of every pull: low for firm, high for slack skin.
    bulge : float
        Thickness of the fat pads that swell where skin is pushed together.
    fold : float
        Depth of folds and wrinkles; grows with age.
    smile : float
        Obliquity of the smile, degrees: positive turns the pull of AU12 outward.
    canine : float
        Share of the lip levators in the smile (Rubin 1974, the "canine smile"), 0 to 1.
    glide : float
        Slide of the condyle along its groove while the jaw opens, mm at 20 degrees.
    lower_lid : float
        Share of the lower lid in closing the eye, 0 to 0.4.
    lip_give : float
        Share of the way that the upper lip gives when the lips press together, 0 to 1.
    variation : float
        How much the muscles themselves differ from the average, in strength, direction and
        extent (standard deviation as a share).
    variant : int
        Which draw of that variation.
    """

    spread: float = 1.0
    bulge: float = 1.0
    fold: float = 1.0
    smile: float = 0.0
    canine: float = 0.15
    glide: float = 5.0
    lower_lid: float = 0.15
    lip_give: float = 0.55
    variation: float = 0.0
    variant: int = 0


@dataclass(frozen=True)
class Manner:
    """How one actor moves, the same in every take and for every `random_state`.

    Parameters
    ----------
    gains : dict of str to float
        Strength of a unit, 0 to 1; the others have `strength`.
    strength : float
        Strength of units in general, 0 to 1.
    couplings : dict of (str, str) to float
        How much of the first unit the second one brings along with it, 0 to 1.
    weak_side : str
        "L" or "R": the side of the face that lags behind.
    asymmetry : float
        Share by which it does.
    speech, tempo : float
        Size of the mouth's movements in speech, and its pace (1 is average).
    blinks : float
        Blinks a minute.
    sneer : str
        "L" or "R": the side of contempt.
    head : float
        Size of the head's movements (1 is average).
    """

    strength: float
    gains: dict
    couplings: dict
    weak_side: str
    asymmetry: float
    speech: float
    tempo: float
    blinks: float
    sneer: str
    head: float


@dataclass(frozen=True)
class Markers:
    """How an actor is captured.

    Parameters
    ----------
    spacing : float
        Millimetres between neighbours on average.
    noise : tuple of float
        Standard deviation in width, height and depth, millimetres.
    occluded : float
        Share of all positions that no camera sees.
    """

    spacing: float
    noise: tuple
    occluded: float


@dataclass(frozen=True)
class Actor:
    """One of the actors.

    Parameters
    ----------
    anatomy : Anatomy
        Measurements of the face.
    style : Style
    manner : Manner
    markers : Markers
    all_units : bool, default=False
        Whether a range of motion and the FACS combinations are captured too.
    """

    anatomy: Anatomy
    style: Style
    manner: Manner
    markers: Markers
    all_units: bool = False


ACTORS = {
    # European man of about 35: long face, high narrow nose, strong brow and jaw;
    # a stage actor, large in all, brows and nose move together, left corner strong
    "M1": Actor(
        Anatomy(
            bizygomatic_width=140.0, bigonial_width=114.0, chin_width=49.0, forehead_height=58.0,
            nose_height=54.0, nasal_protrusion=21.5, rhinion_convexity=1.8, brow_ridge=1.5,
            brow_height=19.5, lid_crease_height=3.9, chin_height=30.0, pogonion_depth=30.0,
            gonial_flare=1.5, cheek_fullness=-1.5, mouth_width=54.0, upper_vermilion_height=6.6,
            nasolabial_fold=0.9, brow_hair=1.3,
        ),
        Style(spread=0.93, bulge=0.9, fold=1.1, smile=6.0, canine=0.1, glide=6.0,
              lower_lid=0.12, variation=0.2, variant=1),
        Manner(gains={"AU11": 0.8, "AU34": 0.9},
               couplings={("AU4", "AU9"): 0.16, ("AU9", "AU10"): 0.14,
                          ("AU1", "AU2"): 0.12, ("AU12", "AU6"): 0.14},
               strength=0.96, weak_side="R", asymmetry=0.12, speech=1.0, tempo=1.0, blinks=17,
               sneer="L", head=1.0),
        Markers(spacing=11.1, noise=(0.12, 0.12, 0.20), occluded=0.030),
        all_units=True,
    ),
    # European woman of about 25: short lower face, fine nose, full lips, open eyes;
    # lively brows, quick, smiles reach the eyes
    "F1": Actor(
        Anatomy(
            bizygomatic_width=131.0, bigonial_width=94.0, bitemporal_width=139.0,
            frontal_width=108.0, chin_width=36.0, forehead_height=55.0, nose_height=47.0,
            nose_width=30.5, nose_tip_width=13.0, nasal_protrusion=17.6, rhinion_convexity=-0.5,
            nose_bridge_width=14.0, glabella_depth=24.8, nasion_depth=20.2, brow_ridge=-2.6,
            brow_height=23.5, chin_height=23.0, palpebral_height_upper=6.2,
            upper_vermilion_height=9.4, lower_vermilion_height=11.4, upper_lip_fullness=2.4,
            lower_lip_fullness=3.4, philtrum_length=12.5, mouth_width=48.5, malar_prominence=1.8,
            gonial_flare=-2.5, lid_crease_height=4.4, nose_root_width=19.0, brow_hair=0.7,
            palpebral_height_lower=5.2, biocular_width=90.0, interpupillary_distance=63.0,
            cheek_fullness=1.5, metopion_depth=22.4, nasolabial_fold=0.3, marionette_fold=0.0,
            tear_trough=0.2, orbit_depth=-1.0, alar_length=12.5, brow_tail_drop=5.5,
            trichion_depth=11.0, cheilion_drop=-0.2,
        ),
        Style(spread=0.85, bulge=1.0, fold=0.6, smile=-6.0, canine=0.3, glide=4.0,
              lower_lid=0.2, lip_give=0.45, variation=0.2, variant=2),
        Manner(gains={"AU1": 1.0, "AU2": 1.0, "AU9": 0.7, "AU15": 0.8, "AU27": 0.85},
               couplings={("AU1", "AU2"): 0.32, ("AU12", "AU6"): 0.34,
                          ("AU5", "AU1"): 0.18, ("AU20", "AU12"): 0.12},
               strength=0.92, weak_side="L", asymmetry=0.07, speech=0.92, tempo=1.12, blinks=21,
               sneer="R", head=1.25),
        Markers(spacing=10.7, noise=(0.10, 0.11, 0.17), occluded=0.026),
    ),
    # East Asian man of about 60: broad cheekbones and jaw, low bridge, heavy lids, jowls;
    # restrained, the upper lip hardly moves, the chin works instead
    "M2": Actor(
        Anatomy(
            bizygomatic_width=147.0, bigonial_width=117.0, bitemporal_width=153.0,
            frontal_width=115.0, chin_width=49.0, forehead_height=57.0, nose_height=53.0,
            nose_width=39.5, nose_bridge_width=17.5, nasal_protrusion=18.4, nasion_depth=18.0,
            glabella_depth=24.2, nose_tip_width=18.0, rhinion_convexity=0.2,
            intercanthal_width=36.5, biocular_width=93.0, interpupillary_distance=65.5,
            palpebral_height_upper=3.7, palpebral_height_lower=4.1, canthal_tilt=4.5,
            lid_crease_height=3.2, lid_crease_depth=0.4, lid_fold=2.0, epicanthus=0.9,
            orbit_depth=-1.2, eye_bag=1.7, tear_trough=0.9, mouth_width=53.0,
            upper_vermilion_height=5.8, lower_vermilion_height=8.6, malar_prominence=1.0, jowl=2.8,
            nasolabial_fold=2.1, marionette_fold=1.3, submental_fullness=3.0, philtrum_length=16.8,
            exocanthion_depth=4.0, temple_hollow=1.2, cheek_fullness=-1.0, nasion_height=4.5,
            brow_hair=1.1,
        ),
        Style(spread=1.17, bulge=1.25, fold=1.6, smile=10.0, canine=0.0, glide=5.0,
              lower_lid=0.1, lip_give=0.6, variation=0.2, variant=3),
        Manner(gains={"AU10": 0.55, "AU4": 0.95, "AU17": 0.95, "AU2": 0.55, "AU6": 0.6},
               couplings={("AU4", "AU7"): 0.30, ("AU15", "AU17"): 0.30,
                          ("AU12", "AU14"): 0.24, ("AU10", "AU17"): 0.14},
               strength=0.76, weak_side="R", asymmetry=0.05, speech=0.74, tempo=0.94, blinks=12,
               sneer="L", head=0.7),
        Markers(spacing=12.8, noise=(0.14, 0.13, 0.24), occluded=0.040),
    ),
    # East Asian woman of about 40: round face, gentle profile, short nose, full lips;
    # a mobile mouth, clearly lopsided, the forehead moves as one
    "F2": Actor(
        Anatomy(
            bizygomatic_width=139.0, bigonial_width=102.0, bitemporal_width=145.0,
            frontal_width=110.0, chin_width=37.0, forehead_height=57.0, nose_height=48.5,
            nose_width=34.0, nose_bridge_width=16.0, nasal_protrusion=17.0, nose_tip_height=11.0,
            nasion_depth=18.0, glabella_depth=24.4, nose_tip_width=15.0, rhinion_convexity=-0.6,
            intercanthal_width=35.5, biocular_width=89.5, interpupillary_distance=62.5,
            palpebral_height_upper=5.2, canthal_tilt=5.5, lid_crease_height=3.0,
            lid_crease_depth=0.3, lid_fold=0.5, epicanthus=0.6, orbit_depth=-1.4, brow_ridge=-2.6,
            brow_height=23.5, upper_vermilion_height=9.0, lower_vermilion_height=11.2,
            upper_lip_fullness=2.3, lower_lip_fullness=3.4, mouth_width=48.0, cheek_fullness=2.6,
            malar_prominence=1.0, chin_height=24.0, pogonion_depth=26.5, exocanthion_depth=4.0,
            tear_trough=0.2, alar_bulge=1.2, nasion_height=4.5, brow_hair=0.7,
            palpebral_height_lower=5.0, nasolabial_fold=0.4, marionette_fold=0.1, gonial_flare=-1.5,
            metopion_depth=22.4, brow_tail_drop=5.5, cheilion_drop=0.0,
        ),
        Style(spread=1.05, bulge=1.3, fold=0.85, smile=-2.0, canine=0.2, glide=3.5,
              lower_lid=0.22, variation=0.2, variant=4),
        Manner(gains={"AU12": 1.0, "AU20": 1.0, "AU22": 1.0, "AU26": 1.0, "AU9": 0.6},
               couplings={("AU1", "AU4"): 0.16, ("AU12", "AU10"): 0.18,
                          ("AU14", "AU12"): 0.26, ("AU17", "AU15"): 0.26},
               strength=0.86, weak_side="L", asymmetry=0.20, speech=1.0, tempo=1.03, blinks=15,
               sneer="R", head=0.9),
        Markers(spacing=11.7, noise=(0.13, 0.12, 0.22), occluded=0.034),
    ),
}  # fmt: skip
"""The actors by name, in the order in which Fig. 5 of Tena et al. adds them to the training set."""


def actor_number(name):
    """Place of an actor among `ACTORS`, from 0: what the random streams of each are drawn from."""
    return list(ACTORS).index(name)
