"""Plans and simulations on disk: written completely or not at all, read without executing anything, and checked."""

from pinograsp.storage.runs import newest_check, read_check, read_run, write_run
from pinograsp.storage.simulations import write_simulation

__all__ = ["newest_check", "read_check", "read_run", "write_run", "write_simulation"]
