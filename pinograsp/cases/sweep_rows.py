"""The rows of a sweep: the case of each, from the inputs that vary and what all rows share."""

from __future__ import annotations

import os
from typing import Any, Literal

from pydantic import Field

from pinograsp.cases.case import Case
from pinograsp.cases.object_case import ObjectCase
from pinograsp.cases.reading import change_values, validate
from pinograsp.cases.sections import CaseSection, Objective
from pinograsp.contacts import ContactSet
from pinograsp.errors import CaseRejected
from pinograsp.forces import ForceProblem
from pinograsp.hands import HandModel
from pinograsp.hands.file_reads import Kept

IMPACT_TIME = "impact_time"  # t_I of ``what: forces``, the only input that is not a key of a case


class SweepBase(CaseSection):
    """What the rows of a sweep share, as plain values for other processes; ``always``: the impact time, where fixed;
    ``files``: those that they are made of, ``{path: SHA-256}``.
    """

    kind: Literal["case", "object"]
    what: Literal["plan", "forces"]
    folder: str
    data: dict[str, Any]
    always: dict[str, Any]
    files: dict[str, str] = Field(default_factory=dict)

    def case(self, inputs: dict[str, Any]) -> CachedCase | ObjectCase:
        """The case of one row.

        Raises:
            CaseRejected: values that cannot be used; the message names all of them.
        """
        changes = {key: value for key, value in inputs.items() if key != IMPACT_TIME}
        kind: type[CachedCase | ObjectCase] = CachedCase if self.kind == "case" else ObjectCase
        try:
            case = validate(kind, {**change_values(self.data, changes), "folder": self.folder})
        except CaseRejected as error:
            raise CaseRejected(str(error).removeprefix("--set ")) from None
        asked = isinstance(case, ObjectCase) and "reserve" in case.model_fields_set and case.reserve is not None
        if asked and self.what == "forces":
            raise CaseRejected("reserve: expected none with what: forces, got one: set it to none, or plan")
        return case

    def look(self, inputs: dict[str, Any]) -> None:
        """Check a row without planning it; :class:`~pinograsp.errors.InvalidInput` where it cannot be used."""
        case = self.case(inputs)
        hand = case.load_hand()
        if isinstance(case, ObjectCase):
            case.make_object()
        elif self.what == "forces":
            case.problem().checked_impact_time(self.impact_time(inputs))
        else:
            case.make_problem(hand)

    def impact_time(self, inputs: dict[str, Any]) -> float:
        """t_I of a row with ``what: forces`` [s]."""
        at: float = {**self.always, **inputs}[IMPACT_TIME]
        return at


class CachedCase(Case):
    """A case that loads each hand, and finds where it touches, once for all rows that have these in common."""

    def load_hand(self) -> HandModel:
        """The hand, placed, with the case's limits."""
        return _HANDS.get((os.getcwd(), self.folder, self.hand.model_dump_json()), super().load_hand)

    def make_contacts(self, hand: HandModel) -> ContactSet:
        """The contacts of ``hand``, this case's own, on the object, whatever its mass."""
        touched = self.object.model_dump_json(exclude={"mass"})
        motion = self.motion.model_dump_json(include={"touch", "posture_deg"})
        contacts = tuple(contact.model_dump_json() for contact in self.contacts)
        key = (hand, touched, motion, contacts, self.gravity)
        return _CONTACTS.get(key, lambda: super(CachedCase, self).make_contacts(hand))

    def problem(self) -> ForceProblem:
        """The force problem, without torque limits.

        Raises:
            CaseRejected: the case has torque limits.
        """
        if self.limits.torque_limit is not None:
            raise CaseRejected("limits.torque_limit: expected none with what: forces, got one: set it to null, or plan")
        return self.make_problem(self.load_hand())

    @property
    def objective(self) -> Objective | dict[Objective, float] | None:
        """What the forces minimise; None: the case's measure."""
        return self.forces.objective


_HANDS: Kept[HandModel] = Kept(4)
_CONTACTS: Kept[ContactSet] = Kept(4)
