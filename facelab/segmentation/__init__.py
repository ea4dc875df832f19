"""The face cut into regions by how it moves (Tena et al. 2011, section 4.2)."""

from facelab.segmentation.affinity import affinity, motion_correlation, nearness
from facelab.segmentation.clusters import Compactness, compactness, renumbered, spectral_embedding
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import Likeness, segment_face, stability

__all__ = [
    "Compactness",
    "Likeness",
    "Regions",
    "affinity",
    "compactness",
    "motion_correlation",
    "nearness",
    "renumbered",
    "segment_face",
    "spectral_embedding",
    "stability",
]
