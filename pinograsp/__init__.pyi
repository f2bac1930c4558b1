"""What ``pinograsp`` offers by name; each is loaded on first use, for which this file is read."""

from . import spatial as spatial
from .cases import (
    load_case as load_case,
)
from .certification import (
    certify as certify,
)
from .contacts import (
    Friction as Friction,
    MarhefkaOrin as MarhefkaOrin,
    close_hand as close_hand,
    contacts_at as contacts_at,
)
from .errors import (
    PinograspError as PinograspError,
    Status as Status,
)
from .forces import (
    ForceBatch as ForceBatch,
    ForceProblem as ForceProblem,
    ForceSolver as ForceSolver,
    GraspConditions as GraspConditions,
    GridSpec as GridSpec,
    LoadSet as LoadSet,
    Reserve as Reserve,
    Task as Task,
    TorqueLimits as TorqueLimits,
    diagnose as diagnose,
    force_closure as force_closure,
    grasp_margins as grasp_margins,
    grid_search as grid_search,
    optimize_forces as optimize_forces,
    optimize_grasp as optimize_grasp,
    optimize_robust as optimize_robust,
    solve_batch as solve_batch,
)
from .hands import (
    HandModel as HandModel,
    attach as attach,
    load_hand as load_hand,
)
from .motion import (
    MotionSpec as MotionSpec,
    OnlineForces as OnlineForces,
    torque_limits as torque_limits,
)
from .objects import (
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Ellipsoid as Ellipsoid,
    Mesh as Mesh,
    Scene as Scene,
    Sphere as Sphere,
    object_from as object_from,
)
from .pick import (
    plan_pick as plan_pick,
)
from .planner import (
    GraspPlan as GraspPlan,
    PlanOptions as PlanOptions,
    load_run as load_run,
    plan_best as plan_best,
    plan_grasp as plan_grasp,
    plan_grasp_on as plan_grasp_on,
    save_run as save_run,
)
from .simulation import (
    simulate as simulate,
)
from .synthesis import (
    Wishes as Wishes,
    find_grasps as find_grasps,
)

__version__: str
