"""The hand, the object and their motors as a MuJoCo model. MuJoCo's own contact forces stay off: see
:mod:`pinograsp.referee.law`.
"""

from __future__ import annotations

import coal
import mujoco
import numpy as np
import pinocchio as pin

from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.referee.geometry import convex, convex_object

_HAND, _OBJECT = {"contype": 1, "conaffinity": 2}, {"contype": 2, "conaffinity": 1}  # the hand does not touch itself
# Contacts are found from 1 mm off and make no force: MuJoCo's soft contacts cannot judge a static grasp.
_FOUND_ONLY = {"margin": -0.5, "gap": 0.501, "density": 0.0}
_LEAST_MASS, _LEAST_INERTIA = 1e-5, 1e-9  # [kg], [kg m^2] of links that have none, as MuJoCo needs
# Of links with a direction about which they have none (thin rods, point masses): part of their largest, and at least
# [kg m^2].
_LEAST_SHARE, _TINY_INERTIA = 1e-6, 1e-12
_STIFF = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # impedance of the couplings


def build(hand: HandModel, body, *, time_step: float, gravity_o, servo, mass_factor: float = 1.0, flat: bool = False):
    """A compiled model and notes: bodies ``link j`` for Pinocchio's joints j, motors in the order of q, ``object``
    free.

    Args:
        servo: gains and rotors of the motors (:class:`~pinograsp.referee.settings.Servo`).
        mass_factor: the object's mass and inertia times this.
        flat: whether links touch with flat areas, at several points.
    """
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia, spec.compiler.degree = True, False
    option = spec.option
    option.timestep, option.gravity = time_step, gravity_o
    # Implicit damping would slow coupled joints down without those that they follow: energy is lost.
    kinds = mujoco.mjtIntegrator
    option.integrator = kinds.mjINT_EULER if hand.couplings else kinds.mjINT_IMPLICITFAST
    option.ccd_tolerance, option.ccd_iterations = 1e-10, 200
    # An instability must not reset the state, which reads as no drift.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    if not flat:
        # Its search for several points turns the normals of hulls and cylinders, by up to tens of degrees (MuJoCo
        # 4.0.0).
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    notes: list[str] = []
    bodies = _links(spec, hand, notes)
    for name, kp, kv, rotor in zip(hand.joint_names, servo.stiffness, servo.damping, servo.rotor):
        spec.joint(name).armature = rotor
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        motor.gainprm[0], motor.biasprm[1], motor.biasprm[2] = kp, -kp, -kv
    for joint, coupling in hand.couplings.items():
        tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=joint, name2=coupling.followed)
        tie.data[:2] = coupling.offset, coupling.factor
        tie.solref, tie.solimp = (2 * time_step, 1.0), _STIFF
    for one in hand.geometry.geometryObjects:
        shape = convex(one.geometry, one.name, notes)
        if shape is not None:
            _add_geom(spec, bodies[one.parentJoint], shape, one.placement, one.name, **_HAND)
    thing = spec.worldbody.add_body(name="object", pos=body.pose[:3, 3], quat=_quaternion(body.pose[:3, :3]))
    thing.add_freejoint()
    _set_inertia(thing, mass_factor * body.mass, np.zeros(3), mass_factor * body.inertia_b)
    _add_geom(spec, thing, convex_object(body, notes), pin.SE3.Identity(), "object", **_OBJECT)
    try:
        return spec.compile(), notes
    except ValueError as error:
        raise InvalidInput(f"MuJoCo refuses this hand or object: {error}") from error


def _links(spec, hand: HandModel, notes: list[str]) -> dict:
    model, bodies = hand.model, {0: spec.worldbody}
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for j in range(1, model.njoints):
        placement, inertia = model.jointPlacements[j], model.inertias[j]
        body = bodies[j] = bodies[model.parents[j]].add_body(
            name=f"link {j}", pos=placement.translation, quat=_quaternion(placement.rotation)
        )
        raised = _set_inertia(body, inertia.mass, inertia.lever, inertia.inertia)
        if raised:
            notes.append(
                f"what joint '{model.names[j]}' moves has no inertia about some axis: {raised:.2g} kg m^2 is taken"
            )
        motion = np.array(data.joints[j].S).ravel()
        slides = hand.is_prismatic(j)
        axis = motion[:3] if slides else motion[3:]
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        # A follower's motion is that of the joint it follows, scaled: here it has its own.
        body.add_joint(name=model.names[j], type=kind, axis=axis / np.linalg.norm(axis) * np.sign(hand.ratio(j)))
    return bodies


def _set_inertia(body, mass: float, lever, inertia) -> float:
    """Give a body mass and inertia; the least moment that had to be put in place of a smaller one [kg m^2], or 0."""
    if mass < _LEAST_MASS:
        mass, inertia = _LEAST_MASS, inertia + _LEAST_INERTIA * np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    least = max(_LEAST_SHARE * moments[-1], _TINY_INERTIA)
    raised = least if moments[0] < least else 0.0
    if raised:
        inertia = axes @ np.diag(np.maximum(moments, least)) @ axes.T
    body.mass, body.ipos, body.explicitinertial = mass, lever, True
    body.fullinertia = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return raised


def _quaternion(rotation) -> np.ndarray:
    return pin.Quaternion(np.array(rotation)).coeffs()[[3, 0, 1, 2]]


def _add_geom(spec, body, shape, placement, name: str, **bits) -> None:
    kinds = mujoco.mjtGeom
    common = {
        "pos": placement.translation,
        "quat": _quaternion(placement.rotation),
        **_FOUND_ONLY,
        **bits,
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
