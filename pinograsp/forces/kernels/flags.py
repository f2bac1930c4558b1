"""How the compiled functions are compiled.

Most of them count no references to arrays: counting those of a named tuple at every call costs more than a contact.
Functions that make arrays count (``COUNTED``, ``NEWTON_COUNTED``), since what they make must be given back. Where a
function returns arrays, it and its callers must be of the same kind.
"""

from __future__ import annotations

from pinograsp.forces.jit import Flags

COUNTED: Flags = {"fastmath": {"contract", "arcp", "nsz"}, "error_model": "numpy"}
NEWTON_COUNTED: Flags = {**COUNTED, "fastmath": {"contract", "arcp", "nsz", "reassoc"}}
FLAGS: Flags = {**COUNTED, "counted": False}
NEWTON: Flags = {**NEWTON_COUNTED, "counted": False}  # sums over contacts are vectorised
# A piece of its only caller: compiled as its part, with its flags. Handing large named tuples over would take longer.
PIECE: Flags = {**FLAGS, "inline": "always"}
UNLOCKED: Flags = {**COUNTED, "nogil": True}
