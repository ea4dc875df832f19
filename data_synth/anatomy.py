"""Measurements of a face, under the names anthropometry gives them.

Lengths are millimetres, angles degrees.  Where the defaults come from differs:

- breadths and heights of the face, eyes, nose and mouth are rounded adult averages as they
  are commonly quoted after Farkas, between the sexes and populations; they were not checked
  against his tables, so do not cite them as data;
- depths, and everything of soft tissue, were set by hand, beside pictures of the generic
  neutral of ICT-FaceKit, all 68 of its landmark positions, and depths read off its skin on
  the forehead, temples, orbits, nose and jaw.  No number was fitted by a program, but
  because of this the agreement with that scan is not independent evidence of anything.

Depths are measured forward (+) or backward (-) from the coronal plane through the centres of
the eyeballs; heights upward from the line that joins those centres.
"""

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Anatomy:
    """Named measurements from which `build_template` makes a face.

    All values are plain floats; `dataclasses.replace` makes variants.  `Anatomy` refuses
    values outside wide human limits, and combinations that cannot be built.

    Raises
    ------
    TypeError
        If a measurement is not a real number.
    ValueError
        If measurements are impossible; all of them are listed at once.
    """

    # --- whole face: breadths and heights -------------------------------------------------
    bizygomatic_width: float = 139.0  # zy-zy, across the cheekbones
    bigonial_width: float = 107.0  # go-go, across the angles of the jaw
    frontal_width: float = 112.0  # ft-ft, across the forehead above the brow tails
    bitemporal_width: float = 147.0  # between the hairlines in front of the ears
    chin_width: float = 44.0  # across the mental tubercles
    forehead_height: float = 56.0  # tr-n, hairline to nasion
    nose_height: float = 51.0  # n-sn
    philtrum_length: float = 14.5  # sn-ls
    upper_vermilion_height: float = 7.6  # ls-sto
    lower_vermilion_height: float = 9.6  # sto-li
    labiomental_height: float = 7.3  # li-sl, lower lip to the fold above the chin
    chin_height: float = 27.0  # sl-gn
    face_depth: float = 52.0  # coronal plane of the eyes back to the front of the ear

    # --- midline profile: depths before the coronal plane of the eyeball centres ----------
    trichion_depth: float = 10.5
    metopion_depth: float = 21.8  # mid forehead
    glabella_depth: float = 24.5
    nasion_depth: float = 20.5
    subnasale_depth: float = 32.5
    labrale_superius_depth: float = 35.6
    stomion_depth: float = 30.5
    labrale_inferius_depth: float = 31.8
    sublabiale_depth: float = 26.5
    pogonion_depth: float = 28.5
    menton_depth: float = 17.0
    glabella_height: float = 19.5  # above the eyeball centres
    nasion_height: float = 5.5  # above the eyeball centres
    upper_lip_fullness: float = 1.6  # how far the red of the lip swells before ls
    lower_lip_fullness: float = 2.6  # the same before li

    # --- eyes -----------------------------------------------------------------------------
    interpupillary_distance: float = 62.5
    eyeball_radius: float = 12.3
    intercanthal_width: float = 32.5  # en-en
    biocular_width: float = 89.0  # ex-ex
    palpebral_height_upper: float = 5.2  # upper lid margin over the line between the canthi
    palpebral_height_lower: float = 4.6  # lower lid margin under that line
    canthal_tilt: float = 3.0  # outer canthus over the inner one, degrees
    endocanthion_depth: float = 7.6
    exocanthion_depth: float = 2.2
    lid_thickness: float = 1.9
    lid_crease_height: float = 4.6  # upper lid margin to crease, along the lid
    lid_crease_depth: float = 1.0  # how far the crease is cut in
    lid_fold: float = 0.0  # skin hanging over the upper lid
    epicanthus: float = 0.0  # 0 none to 1 a full fold over the inner canthus
    eye_bag: float = 0.0  # bulge under the lower lid
    tear_trough: float = 0.6  # groove from the inner canthus down the cheek
    orbit_depth: float = 0.0  # how much deeper set the skin between brow and lid is

    # --- brow -----------------------------------------------------------------------------
    brow_height: float = 21.5  # brow above the eyeball centres, over the pupil
    brow_tail_drop: float = 6.5  # tail of the brow below its peak
    brow_hair: float = 0.9  # how far the hair of the brow stands out
    brow_ridge: float = 0.0  # extra bony prominence of the supraorbital ridge

    # --- nose -----------------------------------------------------------------------------
    nasal_protrusion: float = 19.7  # sn-prn, the direct distance
    nose_width: float = 35.0  # al-al
    nose_bridge_width: float = 15.0  # across the dorsum at the rhinion
    nose_root_width: float = 19.0  # mf-mf, across the root between the inner canthi
    nose_tip_width: float = 16.5  # across the domes
    nose_tip_height: float = 12.0  # sn up to prn
    rhinion_convexity: float = 1.0  # dorsum before the straight line n-prn
    columella_show: float = 2.0  # columella below the alar rim
    alar_length: float = 13.5  # alar crease to the front of the ala
    alar_bulge: float = 1.0  # roundness of the wings
    nostril_depth: float = 7.0

    # --- mouth ----------------------------------------------------------------------------
    mouth_width: float = 51.0  # ch-ch
    cheilion_depth: float = 17.5
    cheilion_drop: float = 0.6  # corners of the mouth below the stomion
    philtrum_width: float = 11.0  # cph-cph, between the peaks of Cupid's bow
    cupids_bow: float = 1.3  # peaks over labrale superius
    philtrum_depth: float = 1.0
    lip_gap: float = 0.2  # between the lips at rest

    # --- soft tissue ----------------------------------------------------------------------
    malar_prominence: float = 0.0  # cheekbone, extra
    cheek_fullness: float = 0.0  # below the cheekbone, extra
    temple_hollow: float = 0.0
    nasolabial_fold: float = 0.8
    marionette_fold: float = 0.3  # from the mouth corner down
    jowl: float = 0.0  # sagging over the jaw beside the chin
    gonial_flare: float = 0.0  # angle of the jaw, extra
    submental_fullness: float = 0.0  # under the chin
    chin_cleft: float = 0.0

    def __post_init__(self):
        problems = []
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise TypeError(
                    f"{field.name} must be a number in millimetres or degrees, "
                    f"got {value!r} of type {type(value).__name__}"
                )
            low, high = _limits(field.name, field.default)
            if not low <= value <= high:  # also catches NaN
                problems.append(f"{field.name}={value!r} is outside [{low:g}, {high:g}]")
        if not problems:
            problems = list(self._contradictions())
        if problems:
            raise ValueError(
                "impossible anatomy: "
                + "; ".join(problems)
                + ". Stay near the defaults of Anatomy(), which are an average adult."
            )

    def _contradictions(self):
        """What cannot be built together, in words."""
        fissure = 0.5 * (self.biocular_width - self.intercanthal_width)
        outer = 0.5 * (self.biocular_width - self.interpupillary_distance)
        inner = 0.5 * (self.interpupillary_distance - self.intercanthal_width)
        if not 22.0 <= fissure <= 36.0:
            yield (
                f"palpebral fissure of {fissure:g} mm from biocular_width={self.biocular_width!r} "
                f"and intercanthal_width={self.intercanthal_width!r} is outside [22, 36]"
            )
        if min(outer, inner) < 0.75 * self.eyeball_radius:
            yield (
                f"interpupillary_distance={self.interpupillary_distance!r} puts the eyeball "
                "outside its lids; keep it near the mean of biocular_width and intercanthal_width"
            )
        for name, share, other in _AT_MOST:
            value, limit = getattr(self, name), getattr(self, other)
            if value > share * limit:
                yield f"{name}={value!r} must stay below {share:g} * {other}={limit!r}"
        if self.brow_height < self.palpebral_height_upper + self.lid_crease_height + 6.0:
            yield (
                f"brow_height={self.brow_height!r} leaves no room for the upper lid; raise it or "
                f"lower lid_crease_height={self.lid_crease_height!r}"
            )


# Limits for measurements whose default is small or zero, where a share of it says nothing.
_SPECIAL_LIMITS = {
    "upper_vermilion_height": (3.5, 13.0), "lower_vermilion_height": (4.5, 15.0),
    "labiomental_height": (4.0, 13.0), "trichion_depth": (0.0, 28.0), "menton_depth": (5.0, 30.0),
    "upper_lip_fullness": (0.0, 4.0), "lower_lip_fullness": (0.0, 5.0),
    "palpebral_height_upper": (2.5, 7.0), "palpebral_height_lower": (2.5, 7.0),
    "canthal_tilt": (-4.0, 12.0), "nasion_height": (0.0, 11.0), "endocanthion_depth": (4.0, 12.0),
    "exocanthion_depth": (-3.0, 7.0), "lid_thickness": (1.2, 3.0), "lid_crease_height": (2.0, 7.5),
    "lid_crease_depth": (0.0, 2.0), "lid_fold": (0.0, 3.0), "epicanthus": (0.0, 1.0),
    "eye_bag": (0.0, 4.0), "tear_trough": (-1.0, 3.0), "orbit_depth": (-4.0, 4.0),
    "brow_tail_drop": (0.0, 11.0), "brow_hair": (0.0, 2.0), "brow_ridge": (-3.0, 4.0),
    "nose_tip_height": (5.0, 16.0),
    "rhinion_convexity": (-3.0, 4.0), "columella_show": (0.0, 5.0), "alar_bulge": (0.0, 2.5),
    "nostril_depth": (2.0, 9.0), "cheilion_depth": (10.0, 26.0), "cheilion_drop": (-2.0, 4.0),
    "cupids_bow": (0.0, 3.0), "philtrum_depth": (0.0, 2.5), "lip_gap": (0.1, 3.0),
    "malar_prominence": (-5.0, 5.0), "cheek_fullness": (-7.0, 7.0), "temple_hollow": (-4.0, 6.0),
    "nasolabial_fold": (-0.5, 3.0), "marionette_fold": (-0.5, 2.5), "jowl": (-2.0, 6.0),
    "gonial_flare": (-5.0, 6.0), "submental_fullness": (-4.0, 8.0), "chin_cleft": (0.0, 2.0),
}  # fmt: skip

# One measurement, and the share of another that it may not exceed.
_AT_MOST = (
    ("bigonial_width", 0.97, "bizygomatic_width"), ("bizygomatic_width", 1.0, "bitemporal_width"),
    ("nose_width", 0.9, "mouth_width"), ("nose_tip_width", 0.62, "nose_width"),
    ("nose_tip_height", 0.8, "nasal_protrusion"),
)  # fmt: skip


def _limits(name, default):
    """Lowest and highest value accepted for one measurement."""
    return _SPECIAL_LIMITS.get(name, (0.65 * default, 1.4 * default))
