"""Ready data: faces, takes, captures and actors, made or fetched on first use."""

from facelab.data.actors import ACTORS, load_capture, load_template
from facelab.data.aura import AURA_LANDMARKS, AURA_UNITS, load_aura, load_aura_take
from facelab.data.cache import DataUnavailable
from facelab.data.examples import Example, load_example, synthetic_props
from facelab.data.ict import ICT_AREAS, load_ict_facekit, load_ict_props
from facelab.data.markers import ANIMFACE_LANDMARKS, MARKERS, load_markers
from facelab.data.registered import RegisteredActor, load_registered
from facelab.data.takes import TAKES, load_take
from facelab.keeping import cache_dir, keep_arrays, source_stamp

__all__ = [
    "ACTORS",
    "ANIMFACE_LANDMARKS",
    "AURA_LANDMARKS",
    "AURA_UNITS",
    "ICT_AREAS",
    "MARKERS",
    "TAKES",
    "DataUnavailable",
    "Example",
    "RegisteredActor",
    "cache_dir",
    "keep_arrays",
    "load_aura",
    "load_aura_take",
    "load_capture",
    "load_example",
    "load_ict_facekit",
    "load_ict_props",
    "load_markers",
    "load_registered",
    "load_take",
    "load_template",
    "source_stamp",
    "synthetic_props",
]
