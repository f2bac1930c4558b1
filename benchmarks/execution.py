"""Controllers that hold a grasp, against each other on the same trials, in the simulation.

    python benchmarks/execution.py --seed 7 --trials 60 [--controllers constant reflex ...] [--jobs 2] [--json]
    python benchmarks/execution.py --seed 7 --trials 60 --controllers reflex --films lost

Hands: an Allegro, a Psyonic with five fingers, a Panda's jaws; objects: can, box, ball, bottle, bar, as far as a grasp
of each is planned, with friction 0.6 and the told mass. Each trial draws friction (0.25 to 1), mass (0.4 to 2.5 of the
told one), an event 1 s after the object is let go (its weight doubles, it is pushed by its weight for 0.15 s, the arm
accelerates with 4 m/s^2 and brakes, or nothing), contacts 1/5 to 20 times as stiff as planned, drives that make 0.7 to
1.3 of what they are told, commands that take 5 or 66 ms. Sensors: 20 ms late, 10 % noise, 5 % of the measurements lost.

Kept: the object is still held at rest at the end, less than 40 mm from where it was. Travel: its largest way, of what
was kept (median). Squeeze over least: sum of the normal forces in the last 0.3 s over that of the forces of least
squares for the true load and friction, of what was kept (median). Over cap: share of trials in which a normal force
exceeds three times the largest planned one.

What the package's own controller believed, of what was kept, 0.1 s after the event or later: share of the ticks in
which the true load is inside its bound; largest lower bound of friction over the true friction (99th percentile);
upper bounds at the end over it, of contacts that had slipped (median, 5th and 95th percentile). ``--quiet MINUTES``
holds on with as much friction as planned or more, the told mass or less, and no event, for so long in all, and counts
reflexes from 0.1 s after the hand holds the object alone.

A controller of your own: a function of a plan, what happens (``Happening``, which only an oracle looks into) and the
cap [N], that returns a :class:`pinograsp.reflex.Controller`, and an entry in ``CONTROLLERS``. Writes execution.csv
beside this file; the last line is JSON with ``--json``. With ``--films FOLDER`` the first three trials that each
controller lost become pages that move, beside the plan. Some 4 s for each trial of each controller. The same trials as
an environment of Gymnasium, for learning: ``execution_env.py``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import joblib
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.objects.body import Body
from pinograsp.planner import GraspPlan
from pinograsp.reflex import Command, Controller, Felt, GripController
from pinograsp.simulation import BaseMotion, Disturbance, Push, Sensors
from pinograsp.spatial import Array

HERE = Path(__file__).resolve().parent
HANDS = ("allegro_right", "psyonic_right", "panda")
MU, SEARCHED = 0.6, 32  # planned friction; samples of a search
EVENTS = ("none", "double", "push", "arm")
EVENT, HOLD, GONE, LAST = 1.0, 2.2, 0.04, 0.3  # [s] after the object is let go; [s]; [m]; [s]
LETTING_GO, PUSHED, DELAY = 0.2, 0.15, 0.02  # [s]
SETTLED, QUIET = 0.1, 20.0  # [s] in which a new load is felt; [s] of one quiet trial
FILMS = 3  # of each controller
CAP = 3.0  # times the largest planned normal force
ARM = 4.0 * np.array([0.0, 1.0, 1.0, 0.0, -1.0, -1.0, 0.0])  # [m/s^2]
ARM_TIMES = EVENT + LETTING_GO + np.array([0.0, 0.05, 0.25, 0.3, 0.35, 0.55, 0.6])  # [s] after t_F


@dataclass(frozen=True)
class Happening:
    """What happens in a trial; ``direction`` (3,) of a push or of the arm's acceleration; ``drives``: what they make of
    what they are told, by joint.
    """

    mu: float
    mass: float
    event: str
    stiffness: float
    delay: float
    drives: Array
    direction: Array
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Happening:
        """One at random."""
        direction = rng.normal(size=3)
        return cls(
            mu=rng.uniform(0.25, 1.0),
            mass=math.exp(rng.uniform(math.log(0.4), math.log(2.5))),
            event=str(rng.choice(EVENTS)),
            stiffness=math.exp(rng.uniform(math.log(0.2), math.log(20.0))),
            delay=float(rng.choice([0.005, 0.066])),
            drives=rng.uniform(0.7, 1.3, 64),
            direction=direction / np.linalg.norm(direction),
            seed=int(rng.integers(1_000_000)),
        )

    @classmethod
    def draw_quiet(cls, rng: np.random.Generator) -> Happening:
        """One at random in which the plan's squeeze is enough: no less friction, no more mass than planned."""
        return replace(cls.draw(rng), mu=rng.uniform(MU, 1.0), mass=rng.uniform(0.4, 1.0), event="none")

    def disturb(self, plan: GraspPlan) -> Disturbance:
        """The same for the simulation."""
        weight = self._weight(plan)
        pushes: tuple[Push, ...] = ()
        motion = None
        if self.event == "double":
            pushes = (Push(wrench_o=[*weight, 0.0, 0.0, 0.0], start=EVENT, duration=HOLD - EVENT),)
        elif self.event == "push":
            push = np.linalg.norm(weight) * self.direction
            pushes = (Push(wrench_o=[*push, 0.0, 0.0, 0.0], start=EVENT, duration=PUSHED),)
        elif self.event == "arm":
            motion = BaseMotion(times=ARM_TIMES, accelerations=np.outer(ARM, self.direction))
        return Disturbance(
            pushes=pushes,
            base_motion=motion,
            mu=self.mu,
            mass_factor=self.mass,
            stiffness=self.stiffness,
            drive_gain=self.drives[: plan.hand.n],
            command_delay=self.delay,
        )

    def load(self, plan: GraspPlan, since: float) -> Array:
        """The true load (6,) at a time after t_F [s]."""
        load, weight, after = np.zeros(6), self._weight(plan), since - LETTING_GO - EVENT
        load[:3] = weight
        if self.event == "double" and after >= 0.0:
            load[:3] += weight
        elif self.event == "push" and 0.0 <= after < PUSHED:
            load[:3] += np.linalg.norm(weight) * self.direction
        elif self.event == "arm":
            load[:3] -= self.mass * plan.body_mass * np.interp(since, ARM_TIMES, ARM) * self.direction
        return load

    def is_changing(self, since: float) -> bool:
        """Whether the load has just changed, a time after t_F [s], and is not yet felt as it is."""
        after = since - LETTING_GO - EVENT
        ends = {"none": (), "double": (0.0,), "push": (0.0, PUSHED), "arm": tuple(ARM_TIMES - EVENT - LETTING_GO)}
        return any(0.0 <= after - end < SETTLED for end in ends[self.event])

    def _weight(self, plan: GraspPlan) -> Array:
        return self.mass * plan.body_mass * plan.gravity_o


Maker = Callable[[GraspPlan, Happening, float], Controller]


def squeeze_constantly(factor: float) -> Maker:
    """The plan's squeeze, so many times."""

    def make(plan: GraspPlan, happening: Happening, cap: float) -> Controller:
        bias, joint_map, planned, _ = _maps_of(plan)
        torques = bias + factor * (joint_map @ planned.ravel())
        return lambda felt: Command(torques)

    return make


def raise_on_slip(plan: GraspPlan, happening: Happening, cap: float) -> Controller:
    """3 % more squeeze every 2 ms while anything slips, a tenth of a per cent less every 2 ms else."""
    bias, joint_map, planned, _ = _maps_of(plan)
    squeezed, factor, told = joint_map @ planned.ravel(), 1.0, -math.inf

    def control(felt: Felt) -> Command:
        nonlocal factor, told
        if felt.slips is not None and felt.slips.time >= told + 2e-3:
            told = felt.slips.time
            factor *= 1.03 if felt.slips.value.any() else 0.999
            factor = min(max(factor, 0.5), cap / planned[:, 2].max())
        return Command(bias + factor * squeezed)

    return control


def keep_ratio(plan: GraspPlan, happening: Happening, cap: float) -> Controller:
    """Normal forces of 1.25 times what the felt tangential ones ask for with the planned friction, smoothed for 20 ms,
    and no less than half of the planned.
    """
    bias, joint_map, planned, _ = _maps_of(plan)
    felt_forces = planned.copy()

    def control(felt: Felt) -> Command:
        nonlocal felt_forces
        if felt.forces is not None:
            felt_forces = felt_forces + 0.05 * (felt.forces.value - felt_forces)
        wanted = planned.copy()
        asked = 1.25 * np.linalg.norm(felt_forces[:, :2], axis=1) / MU
        wanted[:, 2] = np.clip(asked, 0.5 * planned[:, 2], cap)
        return Command(bias + joint_map @ wanted.ravel())

    return control


class Reflex:
    """The package's own controller, and what it believed."""

    def __init__(self, controller: GripController, quantities: Sequence[str]):
        self.controller, self.quantities = controller, quantities
        self.believed = list[tuple[float, Array, float, Array, int]]()  # time, load, bound, mu_low, reflexes

    def __call__(self, felt: Felt) -> Command:
        grip = self.controller
        command = grip.step(Felt(felt.time, **{name: getattr(felt, name) for name in self.quantities}))
        self.believed.append((felt.time, grip.load[:3].copy(), grip.load_bound, grip.mu_low.copy(), grip.reflexes))
        return command

    def judge(self, plan: GraspPlan, happening: Happening) -> dict[str, object]:
        """How true it was, by the numbers of a row."""
        start = float(plan.motion.times[-1])
        late = [one for one in self.believed if one[0] - start > LETTING_GO + EVENT + SETTLED and np.isfinite(one[2])]
        inside = [
            bool(np.linalg.norm(load - happening.load(plan, time - start)[:3]) <= bound)
            for time, load, bound, *_ in late
            if not happening.is_changing(time - start)
        ]
        high = self.controller.mu_high[np.isfinite(self.controller.mu_high)] / happening.mu
        return {
            "load_inside": round(float(np.mean(inside)), 4) if inside else "",
            "mu_low": round(float(self.believed[-1][3].max()) / happening.mu, 4),
            "mu_high": " ".join(f"{one:.3f}" for one in high),
            "reflexes": sum(
                after[4] - before[4]
                for before, after in itertools.pairwise(self.believed)
                if after[0] - start > LETTING_GO + SETTLED
            ),
        }


def reflex(*quantities: str) -> Maker:
    """The package's own, which feels these."""

    def make(plan: GraspPlan, happening: Happening, cap: float) -> Controller:
        return Reflex(plan.grip_controller(latency=DELAY + happening.delay, max_normal_force=cap), quantities)

    return make


def oracle(plan: GraspPlan, happening: Happening, cap: float) -> Controller:
    """Knows load and friction at once; its commands take as long as others'."""
    bias, joint_map, planned, internal = _maps_of(plan)
    start, loop = float(plan.motion.times[-1]), _loop_of(plan, cap)
    told = float(np.linalg.norm(plan.load[:3]))

    def control(felt: Felt) -> Command:
        load = happening.load(plan, felt.time - start)
        more = min(4.0, float(np.linalg.norm(load[:3])) / told * MU / happening.mu)
        loop.least[:] = np.minimum(0.6 * more * planned[:, 2], cap)
        forces, _, _ = loop.step(load, mu=happening.mu / 1.25)
        return Command(bias + joint_map @ (planned.ravel() + internal @ (forces - planned).ravel()))

    return control


CONTROLLERS: dict[str, tuple[str, Maker]] = {
    "constant": ("nothing", squeeze_constantly(1.0)),
    "constant 1.5": ("nothing", squeeze_constantly(1.5)),
    "constant 3": ("nothing", squeeze_constantly(3.0)),
    "raise on slip": ("slip", raise_on_slip),
    "ratio": ("force vectors", keep_ratio),
    "reflex": ("force vectors, slip", reflex("forces", "slips")),
    "reflex normal forces": ("normal forces, slip", reflex("normal_forces", "slips")),
    "reflex currents": ("joint torques", reflex("torques")),
    "oracle": ("load, friction", oracle),
}


def _maps_of(plan: GraspPlan) -> tuple[Array, Array, Array, Array]:
    """Torques without a squeeze (n,), torques by forces (n, 3k), planned forces (k, 3), projection on internal ones."""
    grip = plan.grip_controller().constants()
    names = ("bias", "joint_map", "planned", "internal")
    bias, joint_map, planned, internal = (np.array(grip[name]) for name in names)
    return bias, joint_map, planned, internal


def _loop_of(plan: GraspPlan, cap: float) -> pg.OnlineForces:
    problem = replace(plan.problem, torques=None, friction=replace(plan.problem.friction, safety=1.0))
    return pg.OnlineForces(problem, normal_forces=(0.0, cap))


def plan_grasps(jobs: int) -> list[tuple[str, GraspPlan]]:
    """Of all hands and objects."""
    objects: dict[str, Body] = {
        "can": pg.Cylinder(radius=0.033, height=0.12, mass=0.25),
        "box": pg.Box(size=(0.05, 0.06, 0.1), mass=0.25),
        "ball": pg.Sphere(radius=0.035, mass=0.15),
        "bottle": pg.Cylinder(radius=0.028, height=0.18, mass=0.3),
        "bar": pg.Box(size=(0.04, 0.04, 0.14), mass=0.2),
    }
    conditions, plans = pg.GraspConditions(mu=MU), list[tuple[str, GraspPlan]]()
    for hand in tqdm([pg.load_hand(name) for name in HANDS], desc="grasps"):
        for name, body in objects.items():
            found = pg.find_grasps(hand, body, conditions, count=SEARCHED, seed=1, jobs=jobs, progress=False)
            plan = pg.plan_best(found, conditions, progress=False)
            if plan.status is pg.Status.OK:
                plans.append((name, plan))
    return plans


def run_trial(
    plan: GraspPlan, happening: Happening, name: str, page: Path | None = None, hold: float = HOLD
) -> dict[str, object]:
    """One trial of one controller; ``page``: where it is shown."""
    controller = CONTROLLERS[name][1](plan, happening, cap_of(plan))
    row = {"controller": name} | try_controller(plan, happening, controller, page, hold)
    believed = isinstance(controller, Reflex) and "travel_mm" in row  # it did not diverge
    return row | (controller.judge(plan, happening) if believed else {})


def cap_of(plan: GraspPlan) -> float:
    """The normal force that no controller should exceed [N]."""
    return CAP * float(plan.forces.normal_forces.max())


def try_controller(
    plan: GraspPlan, happening: Happening, controller: Controller, page: Path | None = None, hold: float = HOLD
) -> dict[str, object]:
    """The same for a controller that is made: what came of it."""
    cap = cap_of(plan)
    sensors = Sensors(
        quantities=("forces", "normal_forces", "slips", "torques"),
        noise=0.1,
        delay=DELAY,
        loss=0.05,
        seed=happening.seed,
    )
    try:
        seen = pg.simulate(
            plan,
            disturbance=happening.disturb(plan),
            controller=controller,
            sensors=sensors,
            hold=hold,
            letting_go=LETTING_GO,
            support="fixed",
            sample=4e-3,
        )
    except pg.errors.SimulationDiverged as error:
        return {"kept": False, "why": str(error).splitlines()[0]}
    if page is not None:
        plan.save_html(page, simulation=seen)
    times, places = seen.times, seen.object_poses[:, :3, 3]
    away = np.linalg.norm(places - places[seen.complete], axis=1)
    last = times >= times[-1] - LAST
    rests = float(np.linalg.norm(np.ptp(places[last], axis=0))) < 5e-3
    whole = times[-1] >= plan.motion.times[-1] + LETTING_GO + hold - 0.01
    kept = bool(whole and rests and away.max() < GONE and (seen.normal_forces[-1] > 0).sum() > 1)
    loop = _loop_of(plan, 1e4)
    least, _, _ = loop.step(happening.load(plan, 10.0), mu=happening.mu)
    return {
        "kept": kept,
        "travel_mm": round(1e3 * float(away.max()), 3),
        "squeeze_over_least": round(float(seen.normal_forces[last].sum(axis=1).mean() / least[:, 2].sum()), 3),
        "over_cap": bool(seen.normal_forces[seen.complete :].max() > cap),
        "why": "" if kept else seen.verdict.reason,
    }


def summarize(rows: list[dict[str, object]]) -> dict[str, float]:
    """Scores of one controller."""
    kept = [row for row in rows if row["kept"]]
    return {
        "kept": round(len(kept) / len(rows), 4),
        "travel_mm": _percentile(kept, "travel_mm"),
        "squeeze_over_least": _percentile(kept, "squeeze_over_least"),
        "over_cap": round(sum(bool(row.get("over_cap")) for row in rows) / len(rows), 4),
    }


def judge_beliefs(rows: list[dict[str, object]]) -> dict[str, float]:
    """How true what one of the package's own controllers believed was."""
    kept = [row for row in rows if row["kept"]]
    inside = _read_column(kept, "load_inside")
    return {
        "load_inside": round(float(np.mean(inside)), 3) if inside else math.nan,
        "mu_low_99": _percentile(kept, "mu_low", 99),
        "mu_high": _percentile(kept, "mu_high"),
        "mu_high_5": _percentile(kept, "mu_high", 5),
        "mu_high_95": _percentile(kept, "mu_high", 95),
    }


def _percentile(rows: list[dict[str, object]], name: str, share: float = 50.0) -> float:
    """Of the numbers of a column, several in a cell or none."""
    values = _read_column(rows, name)
    return round(float(np.percentile(values, share)), 3) if values else math.nan


def _read_column(rows: list[dict[str, object]], name: str) -> list[float]:
    return [float(one) for row in rows for one in str(row.get(name, "")).split()]


def count_reflexes(plans: list[tuple[str, GraspPlan]], name: str, args: argparse.Namespace) -> dict[str, float]:
    """Of a controller that holds on, where nothing asks for any."""
    rng, count = np.random.default_rng(args.seed), math.ceil(60.0 * args.quiet / QUIET)
    trials = [(plans[i % len(plans)][1], Happening.draw_quiet(rng)) for i in range(count)]
    calls = (joblib.delayed(run_trial)(plan, happening, name, hold=QUIET) for plan, happening in trials)
    rows = list(tqdm(joblib.Parallel(n_jobs=args.jobs, return_as="generator")(calls), total=count, desc=name))
    return {
        "quiet_kept": round(float(np.mean([bool(row["kept"]) for row in rows])), 4),
        "minutes": round(count * QUIET / 60.0, 2),
        "reflexes": sum(int(str(row.get("reflexes", 0))) for row in rows),
    }


def film_lost(
    folder: Path, work: list[tuple[str, GraspPlan, Happening, str]], rows: list[dict[str, object]]
) -> list[Path]:
    """Pages of the first trials that each controller lost, simulated again; returns those that there are."""
    folder.mkdir(parents=True, exist_ok=True)
    pages = list[Path]()
    controllers = list(dict.fromkeys(name for *_, name in work))
    for controller in controllers:
        lost = [i for i, row in enumerate(rows) if row["controller"] == controller and not row["kept"]]
        for i in lost[:FILMS]:
            what, plan, happening, _ = work[i]
            named = f"{controller}-{i // len(controllers)}-{plan.hand.name}-{what}-{happening.event}.html"
            pages.append(folder / named.replace(" ", "-"))
            run_trial(plan, happening, controller, pages[-1])
    return [page for page in pages if page.exists()]  # none of a simulation that diverged


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--trials", type=int, default=60)
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), choices=list(CONTROLLERS))
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--films", type=Path, metavar="FOLDER", help=f"pages of up to {FILMS} lost trials of each")
    parser.add_argument("--quiet", type=float, default=0.0, metavar="MINUTES", help="in which reflexes are counted")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rng, plans = np.random.default_rng(args.seed), plan_grasps(args.jobs)
    trials = [(*plans[i % len(plans)], Happening.draw(rng)) for i in range(args.trials)]
    work = [(what, plan, happening, name) for what, plan, happening in trials for name in args.controllers]
    calls = (joblib.delayed(run_trial)(plan, happening, name) for _, plan, happening, name in work)
    first = header(["mujoco-core", "numpy", "pinograsp"], f"seed {args.seed}", f"{args.trials} trials")
    rows = list[dict[str, object]]()
    for (what, plan, happening, _), row in zip(
        work, tqdm(joblib.Parallel(n_jobs=args.jobs, return_as="generator")(calls), total=len(work))
    ):
        drawn = {name: getattr(happening, name) for name in ("mu", "mass", "event", "stiffness", "delay", "seed")}
        drawn = {name: round(value, 4) if isinstance(value, float) else value for name, value in drawn.items()}
        rows.append({"hand": plan.hand.name, "object": what, **drawn, **row})
        write_rows(HERE / "execution.csv", first, rows)
    scores = {name: summarize([row for row in rows if row["controller"] == name]) for name in args.controllers}
    print(first)
    print(table([{"controller": name, "feels": CONTROLLERS[name][0], **score} for name, score in scores.items()]))
    own = [name for name in args.controllers if name.startswith("reflex")]
    beliefs = {name: judge_beliefs([row for row in rows if row["controller"] == name]) for name in own}
    if args.quiet:
        beliefs = {name: beliefs[name] | count_reflexes(plans, name, args) for name in own}
    if own:
        print(table([{"controller": name, **belief} for name, belief in beliefs.items()]))
    for page in film_lost(args.films, work, rows) if args.films is not None else ():
        print(page)
    if args.json:
        print(json.dumps({"controllers": scores, "beliefs": beliefs}))


if __name__ == "__main__":
    main()
