"""Objects to be grasped: shape, mass, inertia, surface projection and curvature, collision geometry."""

from pinograsp.objects.ellipsoid import Ellipsoid
from pinograsp.objects.load import load_object
from pinograsp.objects.mesh import Mesh
from pinograsp.objects.primitives import Box, Capsule, Cylinder, Sphere
from pinograsp.objects.scene import Scene
from pinograsp.objects.spec import object_from

__all__ = ["Box", "Capsule", "Cylinder", "Ellipsoid", "Mesh", "Scene", "Sphere", "load_object", "object_from"]
