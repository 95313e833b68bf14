"""The kinds of places that are sampled, by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .indoors import chapel, gallery, room
from .outdoors import courtyard, plaza, pond, tabletop, vehicle
from .place import Place

PLACES: dict[str, Callable[[np.random.Generator], Place]] = {
    place.__name__: place for place in (room, gallery, chapel, tabletop, courtyard, plaza, vehicle, pond)
}
