"""Plans and simulations on disk: written whole or not at all, read without running anything, and checked."""

from pinograsp.storage.runs import newest_check, read_check, read_run, write_run
from pinograsp.storage.simulations import write_simulation

__all__ = ["newest_check", "read_check", "read_run", "write_run", "write_simulation"]
