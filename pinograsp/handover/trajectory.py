"""The record of a hand-over, and its files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, items_of, mapping_of, number, one_of, path_of, read_only, text_of
from pinograsp.errors import InvalidInput
from pinograsp.handover.actuators import Controls, write_keyframes
from pinograsp.handover.quintic import between, interpolate
from pinograsp.handover.samples import JointSamples
from pinograsp.handover.yaml_text import write_yaml
from pinograsp.hands.coupling import Coupling
from pinograsp.spatial import Array
from pinograsp.words import no_formula
from pinograsp.writing import write_file

FIELDS = {"position": "q", "velocity": "dq", "acceleration": "ddq", "effort": "effort"}
GAINS = ("stiffness", "damping")
SUFFIXES = (".yaml", ".yml", ".json")  # of messages
MESSAGE = {"positions": "q", "velocities": "dq", "accelerations": "ddq", "effort": "effort"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointTrajectory(JointSamples):
    """A joint trajectory at a controller's rate; it starts and ends at rest.

    Attributes:
        names: of the actuated joints (n,), in the order of the hand's q.
        times: (m,) [s], from 0 in equal steps.
        q, dq, ddq: (m, n) [rad, rad/s, rad/s^2; m where joints slide].
        effort: feed-forward torques (m, n) [N m or N]: inverse dynamics of exactly this path with the plan's contact
            forces; they end with the plan's holding torques.
        contact_effort: the part of ``effort`` for the contact forces (m, n) [N m or N]; None: not known.
        joints: all joints of the hand, coupled ones included.
        couplings: for each coupled joint, the joint that it follows, and how.
        begin, impact_time, final_time: t = 0, t_I and t_F of the plan on this clock [s].
        blends: intervals in which the path differs from the plan's (start, end) [s].
        deviation: largest distance of the joints from the plan, with a controller's quintic interpolation between
            samples (n,) [rad or m].
        contact_deviation: resulting displacement of each contact point, by contact [m].
        stiffness, damping: gains for which the commands are made (n,); None: none, or those of the controller.
        notes: remarks for the receiver.

    Trajectories that were read from a file have names, times and samples; the rest is None or empty.

    Raises:
        InvalidInput: fields of other kinds or sizes, times that do not increase, or couplings to unknown joints.
    """

    joints: tuple[str, ...] = ()
    begin: float | None = None
    impact_time: float | None = None
    final_time: float | None = None
    blends: tuple[tuple[float, float], ...] = ()
    deviation: np.ndarray | None = None
    contact_deviation: Mapping[str, float] = field(default_factory=dict)
    stiffness: np.ndarray | None = None
    damping: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    __repr__ = brief()

    def __str__(self) -> str:
        return self.describe()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        for name in ("names", "joints", "notes"):
            put(name, items_of(name, getattr(self, name), str))
        for name in ("begin", "impact_time", "final_time"):
            if getattr(self, name) is not None or self.begin is not None:
                put(name, number(name, getattr(self, name), unit="s"))
        put("times", array_of("times", self.times, (None,)))
        if self.times.size < 1 or self.times[0] < 0 or np.any(np.diff(self.times) <= 0):
            raise InvalidInput("times: expected at least one, from 0 s on, each later than the one before")
        shape = (self.times.size, len(self.names))
        for name in FIELDS.values():
            put(name, array_of(name, getattr(self, name), shape))
        sizes = {"contact_effort": shape, **dict.fromkeys(("deviation", *GAINS), (len(self.names),))}
        for name, size in sizes.items():
            if getattr(self, name) is not None:
                put(name, array_of(name, getattr(self, name), size))
        couplings = mapping_of("couplings", self.couplings)
        items_of("couplings", list(couplings.values()), Coupling)
        strangers = [coupling.followed for coupling in couplings.values() if coupling.followed not in self.names]
        if strangers:
            raise InvalidInput(f"couplings: expected to follow joints of names, got {', '.join(strangers)}")
        deviations = mapping_of("contact_deviation", self.contact_deviation)
        put("contact_deviation", {name: number("contact_deviation", by, unit="m") for name, by in deviations.items()})
        blends = array_of("blends", self.blends, (None, 2)) if len(items_of("blends", self.blends, tuple, list)) else ()
        put("blends", tuple((float(start), float(end)) for start, end in blends))

    def at(self, times: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Return q, dq, ddq, effort (s, n) at ``times`` (s,) [s]: quintic between samples, effort linear, as
        controllers interpolate.
        """
        at = np.clip(array_of("times", times, (None,)), self.times[0], self.times[-1])
        return *between(self.times, (self.q, self.dq, self.ddq), at), interpolate(at, self.times, self.effort)

    def with_followers(self) -> JointTrajectory:
        """Return the same trajectory with a column for every joint. Coupled joints have an effort of 0, because the
        motors of the joints that they follow move them.
        """
        missing = [name for name in self.couplings if name not in self.names]
        if not missing:
            return self
        efforts = ("effort",) if self.contact_effort is None else ("effort", "contact_effort")
        columns = {name: dict(zip(self.names, getattr(self, name).T)) for name in ("q", "dq", "ddq", *efforts)}
        off = {} if self.deviation is None else dict(zip(self.names, self.deviation))
        for name in missing:
            coupling = self.couplings[name]
            for attribute in ("q", "dq", "ddq"):
                columns[attribute][name] = coupling.factor * columns[attribute][coupling.followed]
            columns["q"][name] = columns["q"][name] + coupling.offset
            for attribute in efforts:
                columns[attribute][name] = np.zeros(self.times.size)
            off[name] = abs(coupling.factor) * off.get(coupling.followed, 0.0)
        order = [name for name in self.joints if name in columns["q"]]
        stacked: dict[str, Any] = {
            attribute: np.column_stack([values[name] for name in order]) for attribute, values in columns.items()
        }
        return replace(
            self,
            names=tuple(order),
            deviation=None if self.deviation is None else read_only(np.array([off[name] for name in order])),
            **stacked,
        )

    def describe(self) -> str:
        """Length, deviations and notes, as readable text."""
        step = self.times[1] - self.times[0] if self.times.size > 1 else 0.0
        lines = [
            f"trajectory of {len(self.names)} joints: {self.times.size} samples, {1e3 * step:g} ms apart, "
            f"{self.times[-1]:.4g} s"
        ]
        if self.begin is not None:
            lines.append(
                f"  the plan begins at {self.begin:.4g} s, impact at {self.impact_time:.4g} s, t_F at "
                f"{self.final_time:.4g} s"
            )
        lines += [f"  blended from {start:.4g} to {end:.4g} s" for start, end in self.blends]
        if self.deviation is not None:
            worst = int(np.argmax(self.deviation))
            lines.append(f"  off the plan by {self.deviation[worst]:.2g} rad or m at most ({self.names[worst]})")
        lines += [f"  {contact}: off by {1e3 * by:.2g} mm at most" for contact, by in self.contact_deviation.items()]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def to_csv(self, path: str | Path, *, followers: bool = False) -> JointTrajectory:
        """Write a table: ``time`` [s] and, by joint, ``JOINT/position``, ``/velocity``, ``/acceleration``, ``/effort``;
        ``/stiffness`` and ``/damping`` if there are gains.

        ``followers`` adds coupled joints. An existing file is replaced. Returns what was written. Names that a
        spreadsheet would read as a formula get an apostrophe in front, which :func:`~pinograsp.handover.read_csv`
        removes.

        Raises:
            ResultsNotWritten: the place cannot be written.
        """
        path = path_of("path", path)
        own = self.with_followers() if flag("followers", followers) else self
        written = io.StringIO()
        table = csv.writer(written, lineterminator="\n")
        # csv itself overlooks a carriage return
        odd = any("\r" in name for name in own.names)
        head = csv.writer(written, lineterminator="\n", quoting=csv.QUOTE_ALL if odd else csv.QUOTE_MINIMAL)
        gains = [name for name in GAINS if getattr(own, name) is not None]
        head.writerow(["time", *(f"{no_formula(name)}/{kind}" for kind in (*FIELDS, *gains) for name in own.names)])
        constant = [np.tile(getattr(own, name), (own.times.size, 1)) for name in gains]
        rows = np.column_stack([own.times, *(getattr(own, attribute) for attribute in FIELDS.values()), *constant])
        table.writerows([repr(value) for value in row] for row in rows.tolist())
        write_file(path, written.getvalue().encode())
        return own

    def to_ros2(
        self,
        path: str | Path | None = None,
        *,
        followers: bool = False,
        effort: bool = True,
        goal: bool = False,
        frame: str = "",
    ) -> dict[str, Any]:
        """Return the message ``trajectory_msgs/JointTrajectory`` as plain values, and write it to ``path`` if you give
        one.

        Send it with ``ros2 topic pub --once TOPIC trajectory_msgs/msg/JointTrajectory --yaml-file FILE``. Its stamp is
        zero, which starts it on arrival; so the robot must be at the first point, or ``start`` must be its posture.

        Args:
            path: ``.yaml``, ``.yml`` or ``.json``; an existing file is replaced.
            effort: fill the field of efforts: JointTrajectoryController accepts efforts if it has an effort interface,
                and some releases reject any message with efforts.
            goal: as ``trajectory`` of a ``control_msgs/action/FollowJointTrajectory`` goal.
            frame: ``header.frame_id``.

        Raises:
            InvalidInput: another suffix.
            ResultsNotWritten: the place cannot be written.
        """
        if path is not None:
            path = path_of("path", path)
            one_of("suffix of a ROS 2 message", path.suffix, SUFFIXES)
        frame = text_of("frame", frame)
        own = self.with_followers() if flag("followers", followers) else self
        columns = {name: getattr(own, attribute).tolist() for name, attribute in MESSAGE.items()}
        if not flag("effort", effort):
            columns["effort"] = [[] for _ in own.times]
        points = []
        for i, t in enumerate(own.times):
            sec, nanosec = divmod(round(float(t) * 10**9), 10**9)
            points.append(
                {name: rows[i] for name, rows in columns.items()}
                | {"time_from_start": {"sec": sec, "nanosec": nanosec}}
            )
        header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
        message: dict[str, Any] = {"header": header, "joint_names": list(own.names), "points": points}
        message = {"trajectory": message} if flag("goal", goal) else message
        if path is not None:
            content = json.dumps(message, allow_nan=False) + "\n" if path.suffix == ".json" else write_yaml(message)
            write_file(path, content.encode())
        return message

    def to_mujoco(
        self,
        path: str | Path,
        *,
        model: Any = None,
        qpos: ArrayLike | None = None,
        feed_forward: bool = True,
        prefix: str = "",
    ) -> JointTrajectory:
        """Write keyframes ``start``, ``impact`` and ``final``, and next to them an ``.npz`` of the controls over time.

        This is for trajectories of joints; ``plan.to_mujoco(command=)`` writes those of drives.

        ``<include file="PATH"/>`` in the hand's MJCF file adds the keyframes. The archive holds ``times`` (m,),
        ``ctrl`` (m, nu), ``qpos`` (m, nq), ``qvel`` (m, nv), the names in ``joints`` and ``actuators``, and ``act`` (m,
        na) of a model whose actuators have activations, which begin as in its first row. Each row of ``ctrl`` applies
        until the next one.

        Args:
            path: ``.xml``; existing files are replaced.
            model: a ``mujoco.MjModel`` that has the hand's joints by their names, with ``prefix`` before them, and
                anything else, which is assumed at rest. The controls make the hand in that model move along the
                trajectory and press with its contact forces. MuJoCo's inverse dynamics give the efforts for this, with
                the model's masses, gravity and its compensation, springs, dampers and dry friction, and MuJoCo gives
                the effort of each actuator by its control and activation, whatever its type. The efforts of the
                controls in the model are compared with these, and a note says if they differ. Default: a hand alone,
                joints in the order of ``joints``, one position servo per actuated joint in the order of ``names``,
                whose control is the joint's position.
            qpos: positions of everything except the hand (nq,); default: the model's own ``qpos0``.
            feed_forward: False: actuators produce only the effort of their own gains and an error, for a hand that
                moves without the object; feed-forward for the contact forces would displace it.

        Returns:
            The trajectory; its notes name joints that nothing moves, controls that leave their range or act late,
            how much the model's actuators miss the efforts, and couplings of the model that differ.

        Raises:
            InvalidInput: another suffix, not a model, one without the hand's joints, or one whose dynamics are not
                finite. ResultsNotWritten.
        """
        path = path_of("path", path)
        check_model_options(model, qpos, feed_forward, prefix)
        one_of("suffix of MuJoCo keyframes", path.suffix, (".xml",))
        own = self.with_followers()
        if model is None:
            driven = [i for i, name in enumerate(self.names) if name not in self.couplings]
            found = Controls(
                qpos=own.q,
                qvel=own.dq,
                ctrl=self.q[:, driven],
                joints=own.names,
                actuators=tuple(self.names[i] for i in driven),
            )
        else:
            from pinograsp.handover.model_controls import controls

            found = controls(model, self, own, qpos, feed_forward, prefix)
        write_keyframes(path, own.times, self.impact_time, found)
        return replace(self, notes=(*self.notes, *found.notes))


def check_model_options(model: Any, qpos: ArrayLike | None, feed_forward: bool, prefix: str) -> None:
    """Refuse what is said of a MuJoCo model where there is none, which would change nothing.

    Raises:
        InvalidInput.
    """
    given = {
        "qpos": qpos is not None,
        "feed_forward": not flag("feed_forward", feed_forward),
        "prefix": text_of("prefix", prefix),
    }
    alone = [name for name, is_given in given.items() if is_given and model is None]
    if alone:
        raise InvalidInput(f"{', '.join(alone)}: expected with model=, of which it is said; got it alone")
