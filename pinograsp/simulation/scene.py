"""Hand, motors and object as a MuJoCo model, without MuJoCo's contact forces: see :mod:`pinograsp.simulation.law`."""

from __future__ import annotations

import coal
import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.objects.body import Body
from pinograsp.simulation.geometry import convex_shapes, make_convex, object_shape
from pinograsp.simulation.settings import Servo
from pinograsp.simulation.surface import MeshSurface
from pinograsp.spatial import Array

_HAND, _OBJECT = {"contype": 1, "conaffinity": 2}, {"contype": 2, "conaffinity": 1}  # the hand does not touch itself
# Contacts are detected within 1 mm and exert no force: MuJoCo's soft contacts cannot judge a static grasp.
_FOUND_ONLY = {"margin": -0.5, "gap": 0.501, "density": 0.0}
_LEAST_MASS, _LEAST_INERTIA = 1e-5, 1e-9  # [kg], [kg m^2] of links without mass, as MuJoCo needs
# Smallest principal moment of a link (thin rods and point masses have some that are zero): share of its largest one,
# and absolute [kg m^2].
_LEAST_SHARE, _TINY_INERTIA = 1e-6, 1e-12
_ROUNDED = 1e-6  # share of the largest moment that the others may lack by rounding, and have more than it afterwards
COUPLED_STEPS = 2.0  # time constant of the couplings, in time steps
_STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # impedance of the couplings


def build(
    hand: HandModel,
    body: Body,
    *,
    time_step: float,
    gravity_o: Array,
    servo: Servo,
    mass_factor: float = 1.0,
    flat: bool = False,
) -> tuple[mujoco.MjModel, list[str]]:
    """A compiled model, and notes on what differs from the given geometry.

    The bodies are ``link j`` for Pinocchio's joints j, and the free ``object``; the motors are in the order of q.

    Args:
        hand: where it is placed.
        body: the object, where it is placed.
        time_step: [s].
        gravity_o: (3,) [m/s^2].
        servo: gains and rotor inertias of the motors.
        mass_factor: multiplies the object's mass and inertia.
        flat: whether links touch the object with flat areas, at several points.
    """
    spec, notes = outline(
        hand,
        body,
        time_step=time_step,
        gravity_o=gravity_o,
        rotor=servo.rotor,
        mass_factor=mass_factor,
        flat=flat,
    )
    for name, kp, kv in zip(hand.joint_names, servo.stiffness, servo.damping):
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        # A motor without stiffness takes torques as its control.
        motor.gainprm[0], motor.biasprm[1], motor.biasprm[2] = kp or 1.0, -kp, -kv
    return compile_model(spec), notes


def compile_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The model of a description; :class:`InvalidInput` says what MuJoCo refuses."""
    try:
        with without_callbacks():  # compiling calls them
            return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"MuJoCo rejects this hand or object: {error}") from error


def outline(
    hand: HandModel,
    body: Body,
    *,
    time_step: float,
    gravity_o: Array,
    rotor: Array,
    mass_factor: float = 1.0,
    flat: bool = False,
    presses: bool = False,
) -> tuple[mujoco.MjSpec, list[str]]:
    """Hand and object without motors, as :func:`build`, and notes on what differs from the given geometry.

    Args:
        hand, body, time_step, gravity_o, mass_factor, flat: as for :func:`build`.
        rotor: inertias of the motors at the joints (n,) [kg m^2 or kg].
        presses: whether MuJoCo's own contacts exert forces; an object that is not convex is then convex parts. The
            frame of the object's body is then its own, that of its file; else it is in the centre of mass.
    """
    spec = mujoco.MjSpec()
    _set_options(spec, time_step, gravity_o, coupled=bool(hand.couplings), flat=flat)
    notes: list[str] = []
    bodies = _links(spec, hand, notes)
    for name, inertia in zip(hand.joint_names, rotor):
        spec.joint(name).armature = inertia
    found = {"density": 0.0} if presses else _FOUND_ONLY
    for joint, coupling in hand.couplings.items():
        tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=joint, name2=coupling.followed)
        tie.data[:2] = coupling.offset, coupling.factor
        tie.solref, tie.solimp = (COUPLED_STEPS * time_step, 1.0), _STIFF
    for one in hand.geometry.geometryObjects:
        shape = make_convex(one.geometry, one.name, notes)
        if shape is not None:
            _add_geom(spec, bodies[one.parentJoint], shape, one.placement, one.name, found | _HAND)
    # MuJoCo integrates the velocity of a body's origin: in the centre of mass, far from it turns would lose digits.
    pose = body.pose if presses else body.shape_pose
    placement = pin.SE3(np.linalg.inv(pose) @ body.shape_pose)
    free = spec.worldbody.add_body(name="object", pos=pose[:3, 3], quat=_quaternion(pose[:3, :3]))
    free.add_freejoint()
    inertia = body.inertia_b if presses else body.inertia_s
    changed = _set_inertia(free, mass_factor * body.mass, placement.translation, mass_factor * inertia)
    notes += [f"the object has {text}" for text in changed]
    shapes = convex_shapes(body, notes) if presses else [object_shape(body, notes)]
    for number, shape in enumerate(shapes, 1):
        if not isinstance(shape, MeshSurface):  # MuJoCo would take its convex hull
            name = "object" if len(shapes) == 1 else f"object {number}"
            _add_geom(spec, free, shape, placement, name, found | _OBJECT)
    return spec, notes


def _set_options(spec: mujoco.MjSpec, time_step: float, gravity_o: Array, *, coupled: bool, flat: bool) -> None:
    spec.compiler.balanceinertia, spec.compiler.degree = True, False
    option = spec.option
    option.timestep, option.gravity = time_step, gravity_o
    # Implicit damping would slow coupled joints down but not those that they follow: energy would be lost.
    kinds = mujoco.mjtIntegrator
    option.integrator = kinds.mjINT_EULER if coupled else kinds.mjINT_IMPLICITFAST
    option.ccd_tolerance, option.ccd_iterations = 1e-10, 200
    # An instability must not reset the state, which would look like an object that stays in place.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    if not flat:
        # MuJoCo's search for several points turns the normals of hulls and cylinders by up to tens of degrees (4.0.0).
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD


def _links(spec: mujoco.MjSpec, hand: HandModel, notes: list[str]) -> dict[int, mujoco.MjsBody]:
    """The hand's bodies and joints; the bodies by Pinocchio's joints."""
    model, bodies = hand.model, {0: spec.worldbody}
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j in range(1, model.njoints):
        placement, inertia = model.jointPlacements[j], model.inertias[j]
        body = bodies[j] = bodies[model.parents[j]].add_body(
            name=f"link {j}", pos=placement.translation, quat=_quaternion(placement.rotation)
        )
        changed = _set_inertia(body, inertia.mass, inertia.lever, inertia.inertia)
        notes += [f"the link at joint '{model.names[j]}' has {text}" for text in changed]
        motion = np.array(data.joints[j].S).ravel()
        slides = hand.is_prismatic(j)
        axis = motion[:3] if slides else motion[3:]
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        # Pinocchio scales a follower's axis by its ratio to the joint that it follows; here only the sign counts.
        body.add_joint(name=model.names[j], type=kind, axis=axis / np.linalg.norm(axis) * np.sign(hand.ratio(j)))
    return bodies


def _set_inertia(body: mujoco.MjsBody, mass: float, lever: Array, inertia: Array) -> list[str]:
    """Set a body's mass and inertia, as near to the given ones as MuJoCo takes them; returns what was changed."""
    changed: list[str] = []
    if mass < _LEAST_MASS:
        changed.append(f"next to no mass: {_LEAST_MASS:g} kg is used, with {_LEAST_INERTIA:g} kg m^2 added")
        mass, inertia = _LEAST_MASS, inertia + _LEAST_INERTIA * np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    least = max(_LEAST_SHARE * float(moments[-1]), _TINY_INERTIA)
    if moments[0] < least:
        changed.append(f"no inertia about some axis: {least:.2g} kg m^2 is used")
        moments = np.maximum(moments, least)
        inertia = axes @ np.diag(moments) @ axes.T
    lacking = float(moments[2] * (1 + _ROUNDED) - moments[0] - moments[1])
    if lacking > 0:  # MuJoCo's own remedy would make all three the same
        if lacking > 2 * _ROUNDED * moments[2]:
            changed.append(
                f"impossible moments of inertia ({', '.join(f'{one:.3g}' for one in moments)} kg m^2): "
                f"{lacking / 2:.2g} kg m^2 is added to the smaller two"
            )
        inertia = axes @ np.diag(moments + lacking / 2 * np.array([1.0, 1.0, 0.0])) @ axes.T
    body.mass, body.ipos, body.explicitinertial = mass, lever, True
    body.fullinertia = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return changed


def _quaternion(rotation: Array) -> Array:
    """w, x, y, z of a rotation (3, 3)."""
    coefficients: Array = pin.Quaternion(np.array(rotation)).coeffs()
    return coefficients[[3, 0, 1, 2]]


def _add_geom(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    shape: coal.ShapeBase,
    placement: pin.SE3,
    name: str,
    settings: dict[str, float],
) -> None:
    kinds = mujoco.mjtGeom
    common = {
        "pos": placement.translation,
        "quat": _quaternion(placement.rotation),
        **settings,
    }
    if isinstance(shape, coal.Sphere):
        body.add_geom(type=kinds.mjGEOM_SPHERE, size=[shape.radius, 0, 0], **common)
    elif isinstance(shape, coal.Ellipsoid):
        body.add_geom(type=kinds.mjGEOM_ELLIPSOID, size=np.array(shape.radii).ravel(), **common)
    elif isinstance(shape, coal.Box):
        body.add_geom(type=kinds.mjGEOM_BOX, size=np.array(shape.halfSide).ravel(), **common)
    elif isinstance(shape, coal.Cylinder | coal.Capsule):
        kind = kinds.mjGEOM_CYLINDER if isinstance(shape, coal.Cylinder) else kinds.mjGEOM_CAPSULE
        body.add_geom(type=kind, size=[shape.radius, shape.halfLength, 0], **common)
    else:
        spec.add_mesh(name=name, uservert=np.array(shape.points()).ravel())
        body.add_geom(type=kinds.mjGEOM_MESH, meshname=name, **common)
