"""Case files: validated descriptions of a hand, an object, contacts and settings."""

from pinograsp.cases.case import Case, builtin_cases, load_case

__all__ = ["Case", "builtin_cases", "load_case"]
