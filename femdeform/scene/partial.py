"""The sound part of a scene with faults, so that one wrong number does not hide what is wrong elsewhere.

Faults of the schema (types, unknown keys, ranges) are found block by block; references to bodies, groups and files can
only be judged on a whole scene. Where the bodies themselves are sound, the faulty blocks are put aside for that.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from femdeform.scene.document import read_document
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, Source, scene_hash
from femdeform.scene.overrides import apply_overrides

# Stands for a time block with faults: nothing else in a scene can be at odds with it.
_SOME_TIME = {"scheme": "backward_euler", "dt": 1.0e30, "end": 1.0e30}


def sound_part(path: Path, overrides: Sequence[str] = ()) -> LoadedScene | None:
    """Return a scene without its faulty blocks, for checks only; None if too little is left to be judged.

    Keys keep their places: a faulty condition is replaced by one that says nothing.
    """
    from pydantic import TypeAdapter

    from femdeform.scene.kinds import Scene
    from femdeform.scene.validation import find_faults

    document = read_document(path)
    if document.faults or not document.readable:
        return None
    data, origins, problems = apply_overrides(document.data, overrides)
    if problems:
        return None
    data = copy.deepcopy(data)
    for finding in find_faults(Scene, data):
        if not _put_aside(data, finding.path):
            return None
    if find_faults(Scene, data):
        return None
    scene = TypeAdapter(Scene).validate_python(data)
    source = Source(str(path), document.lines, origins)
    return LoadedScene(scene, path, path.parent, data, scene_hash(data), source)


def _put_aside(data: Any, path: KeyPath) -> bool:
    """Take the block that holds a fault out of the data, in place; False if the rest cannot be judged without it."""
    if not isinstance(data, dict) or not path or path[0] == "bodies":
        return False
    bodies = data.get("bodies")
    if path[0] == "simulation":
        data["simulation"] = "deformable"
    elif data.get("simulation") != "deformable":
        return False
    elif path[0] == "time":
        data["time"] = _SOME_TIME
        data.pop("on_failure", None)
    elif path[0] == "conditions" and len(path) > 1 and isinstance(bodies, dict) and bodies:
        number = path[1]
        if not isinstance(number, int):
            return False
        data["conditions"][number] = {"kind": "fixed", "on": next(iter(bodies))}
    elif path[0] == "links" and len(path) > 1 and isinstance(bodies, dict) and bodies:
        if not isinstance(path[1], str):
            return False
        # Quantities may name it.
        data["links"][path[1]] = {"kind": "attachment", "on": next(iter(bodies)), "stiffness": 1.0}
    else:
        data.pop(path[0], None)
    return True
