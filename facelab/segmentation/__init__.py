"""The face cut into regions by how it moves (Tena et al. 2011, section 4.2)."""

from facelab.segmentation.clusters import Compactness, compactness, renumbered, spectral_embedding
from facelab.segmentation.dense import Correlations, Distances, sparse_affinity
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import Affinity, segment_face, stability
from facelab.segmentation.similarity import affinity, motion_correlation, nearness

__all__ = [
    "Affinity",
    "Compactness",
    "Correlations",
    "Distances",
    "Regions",
    "affinity",
    "compactness",
    "motion_correlation",
    "nearness",
    "renumbered",
    "segment_face",
    "sparse_affinity",
    "spectral_embedding",
    "stability",
]
