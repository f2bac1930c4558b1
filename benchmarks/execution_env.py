"""The trials of execution.py as an environment of Gymnasium: from what the hand feels to torques, friction and mass
unknown. It needs gymnasium.

    python benchmarks/execution_env.py --seed 7 --trials 4     # the package's own controller as the policy

An episode begins when the grasp is complete. A step is a tick of the sensors, 1 ms. It ends after 2.4 s or when the
object is lost, with the reward 1 if the object is kept as in execution.py and no normal force exceeds the cap, else 0;
then ``info["row"]`` has the scores. Every episode draws another ``Happening``, or takes ``options={"happening": ...}``.
"""

from __future__ import annotations

import argparse
import copy
import queue
import threading
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from execution import DELAY, Happening, Reflex, cap_of, plan_grasps, try_controller
from results import table

from pinograsp.planner import GraspPlan
from pinograsp.reflex import Command, Felt
from pinograsp.spatial import Array


class _Abandoned(Exception):
    """Another episode has begun, or the environment is closed."""


class ExecutionEnv(gym.Env[dict[str, Array], Array]):
    """A plan that is held with the torques that a policy sends.

    Observations are the newest measurements: those of ``quantities`` as in :class:`pinograsp.reflex.Felt`, and ``age``,
    the time since they were taken [s]; zeros before the first. Actions are torques of the joints (n,) [N m or N], added
    to those of the servos, which stay at the plan's references. The ``info`` has ``felt``, what the package's own
    controllers take; ``happening`` is what only an oracle looks into.
    """

    def __init__(self, plan: GraspPlan, *, quantities: Sequence[str] = ("forces", "slips")):
        k, n = len(plan.contacts.names), plan.hand.n
        shapes = {"forces": (k, 3), "normal_forces": (k,), "slips": (k,), "torques": (n,)}
        self.plan = plan
        self.shapes = {name: shapes[name] for name in quantities} | {"age": (1,)}
        self.observation_space = gym.spaces.Dict(
            {name: gym.spaces.Box(-np.inf, np.inf, shape, np.float64) for name, shape in self.shapes.items()}
        )
        self.action_space = gym.spaces.Box(-plan.torque_limit, plan.torque_limit, dtype=np.float64)
        self.thread: threading.Thread | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin an episode: the hand has closed when this returns."""
        super().reset(seed=seed)
        self.close()
        self.happening = (options or {}).get("happening") or Happening.draw(self.np_random)
        self.newest, self.measured = {name: np.zeros(shape) for name, shape in self.shapes.items()}, None
        # The simulation calls its controller, so it runs in a thread that waits there for the next action.
        self.felt = queue.SimpleQueue[Felt | dict[str, object] | Exception]()
        self.actions = queue.SimpleQueue[Array | None]()
        self.thread = threading.Thread(target=self._simulate, args=(self.felt, self.actions), daemon=True)
        self.thread.start()
        observation, _, _, _, info = self._wait()
        return observation, info

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Send torques, and wait for the next tick."""
        self.actions.put(np.array(action, dtype=float))
        return self._wait()

    def close(self) -> None:
        """Abandon the episode."""
        if self.thread is not None and self.thread.is_alive():
            self.actions.put(None)
            self.thread.join()

    def _simulate(self, felt: queue.SimpleQueue, actions: queue.SimpleQueue) -> None:
        def control(told: Felt) -> Command:
            felt.put(told)
            if (action := actions.get()) is None:
                raise _Abandoned
            return Command(action)

        try:
            felt.put(try_controller(self.plan, self.happening, control))
        except _Abandoned:
            pass
        except Exception as error:
            felt.put(error)

    def _wait(self) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        told = self.felt.get()
        if isinstance(told, Exception):
            raise told
        if isinstance(told, dict):
            kept = bool(told["kept"]) and not told.get("over_cap")
            return copy.deepcopy(self.newest), float(kept), True, False, {"row": told}
        arrived = {name: getattr(told, name) for name in self.shapes if name != "age"}
        fresh = {name: np.array(one.value, dtype=float) for name, one in arrived.items() if one is not None}
        self.measured = next((one.time for one in arrived.values() if one is not None), self.measured)
        age = 0.0 if self.measured is None else told.time - self.measured
        self.newest = self.newest | fresh | {"age": np.array([age])}
        return copy.deepcopy(self.newest), 0.0, False, False, {"felt": told}


def main() -> None:
    """Hold with the package's own controller."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--trials", type=int, default=4)
    args = parser.parse_args()
    rows, plans = list[dict[str, object]](), plan_grasps(-1)
    for i in range(args.trials):
        what, plan = plans[i % len(plans)]
        env = ExecutionEnv(plan)
        _, info = env.reset(seed=args.seed + i)
        grip = plan.grip_controller(latency=DELAY + env.happening.delay, max_normal_force=cap_of(plan))
        policy, ended, reward = Reflex(grip, ("forces", "slips")), False, 0.0
        while not ended:
            _, reward, ended, _, info = env.step(policy(info["felt"]).torques)
        rows.append({"hand": plan.hand.name, "object": what, "reward": reward, **info["row"]})
    print(table(rows))


if __name__ == "__main__":
    main()
