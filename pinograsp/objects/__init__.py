"""Objects to be grasped: shape, mass, inertia, surface projection."""

from pinograsp.objects.shapes import Cylinder, Sphere

__all__ = ["Cylinder", "Sphere"]
