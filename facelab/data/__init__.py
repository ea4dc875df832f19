"""Ready data: faces, takes, captures and actors, made or fetched on first use."""

from facelab.data.actors import load_capture, load_template
from facelab.data.cache import DataUnavailable, cache_dir
from facelab.data.examples import Example, load_example, synthetic_props
from facelab.data.ict import ICT_AREAS, load_ict_facekit, load_ict_props
from facelab.data.markers import ANIMFACE_LANDMARKS, MARKERS, load_markers
from facelab.data.registered import RegisteredActor, load_registered
from facelab.data.takes import TAKES, load_take

__all__ = [
    "ANIMFACE_LANDMARKS",
    "ICT_AREAS",
    "MARKERS",
    "TAKES",
    "DataUnavailable",
    "Example",
    "RegisteredActor",
    "cache_dir",
    "load_capture",
    "load_example",
    "load_ict_facekit",
    "load_ict_props",
    "load_markers",
    "load_registered",
    "load_take",
    "load_template",
    "synthetic_props",
]
