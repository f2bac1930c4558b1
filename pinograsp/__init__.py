"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio.

The public names are those of ``__init__.pyi``, loaded on first use, so that ``import pinograsp`` stays quick.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
