"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio.

The public names below are loaded on first use, so that ``import pinograsp`` stays quick.
"""

from importlib import import_module

_HOMES = {
    "pinograsp.hands": ("HandModel", "load_hand"),
    "pinograsp.objects": ("Box", "Capsule", "Cylinder", "Ellipsoid", "Mesh", "Sphere", "object_from"),
    "pinograsp.contacts": (
        "Compliance",
        "Contact",
        "ContactSet",
        "DecelerationShape",
        "Friction",
        "PenetrationProfile",
        "close_hand",
        "contacts_at",
    ),
    "pinograsp.forces": (
        "ForceProblem",
        "ForceSolution",
        "GridSpec",
        "TorqueLimits",
        "diagnose",
        "grid_search",
        "optimize_forces",
        "optimize_grasp",
        "LoadSet",
        "optimize_robust",
        "grasp_margins",
        "load_margin",
        "force_closure",
        "min_weight",
        "refine_multipliers",
        "warm_up",
        "ForceBatch",
        "solve_batch",
    ),
    "pinograsp.motion": ("MotionSpec", "OnlineForces", "contact_postures", "plan_motion", "torque_limits"),
    "pinograsp.plan": ("GraspPlan", "plan_grasp"),
    "pinograsp.referee": ("simulate",),
    "pinograsp.cases": ("load_case",),
    "pinograsp.storage": ("load_run", "run_of", "save_run"),
    "pinograsp.errors": ("PinograspError", "Status"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)


def __getattr__(name: str):
    if name not in _HOME_OF:
        raise AttributeError(f"module 'pinograsp' has no attribute '{name}'")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
