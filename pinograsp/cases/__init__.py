"""Case files: validated descriptions of a hand, an object, contacts and settings."""

from pinograsp.cases.case import Case, builtin_cases, load_case
from pinograsp.cases.changes import CaseChanges

__all__ = ["Case", "CaseChanges", "builtin_cases", "load_case"]
