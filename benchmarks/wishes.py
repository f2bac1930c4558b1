"""Twenty requests on three hands and three objects: which are met, and which an exhaustive search can meet.

    python benchmarks/wishes.py --seed 7 [--hands NAME ...] [--samples 2000] [--jobs 2]

The objects are the mug of ``pinograsp plan mug`` (300 g), a jar with a lid (60 x 110 mm, 350 g) and a box (50 x 50 x
120 mm, 300 g); friction is 0.6, all else as the package chooses it. For each hand and object the exhaustive search
draws its samples without any wish, half of them power grasps, and keeps those of its grasps that are as wished and
withstand the reserve. A request is met where ``find_grasps`` with the wish finds a grasp that withstands the reserve;
whether that is as wished is looked at again from the grasp's contacts alone. Writes wishes.csv beside this file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.contacts import PALM
from pinograsp.contacts.edges import on_edges
from pinograsp.forces import Reserve, Task
from pinograsp.synthesis import Approach, FoundGrasp, GraspSearch, Wishes

HERE = Path(__file__).resolve().parent
MU = 0.6
HANDS = ("allegro_right", "psyonic_right", "panda")


def make_objects() -> dict[str, pg.Mesh]:
    """By name; each has named parts."""
    jar = trimesh.creation.cylinder(radius=0.03, height=0.11, sections=48)
    box = trimesh.creation.box((0.05, 0.05, 0.12))
    mug = Path(pg.__file__).parent / "cases" / "mug.obj"
    return {
        "mug": pg.Mesh.load(mug, scale=0.001, mass=0.3),
        "jar": pg.Mesh(
            vertices=jar.vertices,
            faces=jar.faces,
            mass=0.35,
            regions={
                "lid": [[-0.031, -0.031, 0.03], [0.031, 0.031, 0.056]],
                "bottom": [[-0.031, -0.031, -0.056], [0.031, 0.031, -0.03]],
            },
        ),
        "box": pg.Mesh(
            vertices=box.vertices,
            faces=box.faces,
            mass=0.3,
            regions={
                "lid": [[-0.026, -0.026, 0.03], [0.026, 0.026, 0.061]],
                "bottom": [[-0.026, -0.026, -0.061], [0.026, 0.026, -0.03]],
            },
        ),
    }


@dataclass(frozen=True)
class Request:
    """What is asked for, and tasks."""

    text: str
    wishes: Wishes
    tasks: tuple[Task, ...] = ()


def requests_for(hand: pg.HandModel, name: str) -> list[Request]:
    """The twenty requests that make sense for a hand and an object."""
    fingers = [finger.name for finger in hand.fingers]
    many, top = len(fingers) > 2, "rim" if name == "mug" else "lid"
    low = "base" if name == "mug" else "bottom"
    upper = [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.2]] if name != "mug" else [[-0.1, -0.1, 0.0475], [0.1, 0.1, 0.2]]
    asked = [
        Request("from above", Wishes(approach="above")),
        Request("from the side", Wishes(approach="side")),
        Request("from above, 20 deg", Wishes(approach=Approach(direction=np.array([0, 0, -1.0]), cone=np.radians(20)))),
        Request("along the object's y", Wishes(approach=Approach(direction=np.array([0, 1.0, 0]), frame="object"))),
        Request("no edges", Wishes(edges=False)),
        Request("no palm", Wishes(palm=False)),
        Request("not the top", Wishes(forbidden=(top,))),
        Request("not the bottom", Wishes(forbidden=(low,))),
        Request("touching the top", Wishes(touching=(top,))),
        Request("the upper half alone", Wishes(within=np.array(upper))),
        Request("10 mm of room", Wishes(opening=0.01)),
        Request("side, no edges", Wishes(approach="side", edges=False)),
        Request("above, not the bottom", Wishes(approach="above", forbidden=(low,))),
        Request("turned with 0.05 N m", Wishes(), (Task.screw(torque=0.05),)),
        Request("tilted by 60 deg, from the side", Wishes(approach="side"), (Task.pour(tilt=np.radians(60)),)),
        Request("shaken with 4 m/s^2", Wishes(), (Task.shake(acceleration=4.0),)),
    ]
    if many:
        thumb = next((one for one in fingers if "thumb" in one), fingers[0])
        index = next((one for one in fingers if "index" in one), fingers[1])
        asked += [
            Request("thumb and index", Wishes(fingers=(thumb, index))),
            Request("all fingers", Wishes(least_fingers=len(fingers))),
            Request("four fingers from above", Wishes(least_fingers=min(4, len(fingers)), approach="above")),
            Request("palm and fingers", Wishes(palm=True)),
        ]
    return asked


def is_as_wished(grasp: FoundGrasp, body: pg.Mesh, request: Request) -> bool:
    """From the contacts alone, written apart from what the search does."""
    wishes, touches = request.wishes, grasp.closure.touches
    names = {touch.finger for touch in touches if touch.finger}
    fingers = names - {PALM}
    turn, at = np.array(body.pose)[:3, :3], np.array(body.pose)[:3, 3]

    def points(some: set[str] | None = None) -> np.ndarray:
        chosen = [touch.patch_o for touch in touches if some is None or touch.finger in some]
        return (np.concatenate(chosen) - at) @ turn

    def inside(part: object, where: np.ndarray) -> np.ndarray:
        lower, upper = body.regions[part] if isinstance(part, str) else np.asarray(part)
        return ((where >= lower - 1e-6) & (where <= upper + 1e-6)).all(axis=1)

    looks = grasp.look_o / np.linalg.norm(grasp.look_o)

    def before(along: np.ndarray) -> bool:
        """Whether the fingers start before the object, seen along a direction."""
        hand, data = grasp.closure.hand, grasp.closure.hand.model.createData()
        pin.forwardKinematics(hand.model, data, np.array(grasp.closure.q))
        starts = np.mean([data.oMi[finger.joint_ids[0]].translation for finger in hand.fingers], axis=0)
        return bool(starts @ along <= ((body.vertices @ turn.T + at) @ along).min() + 1e-3)

    checks: list[Callable[[], bool]] = []
    if wishes.fingers is not None:
        checks.append(lambda: fingers <= set(wishes.fingers or ()))
    if wishes.least_fingers is not None:
        checks.append(lambda: len(fingers) >= (wishes.least_fingers or 0))
    if wishes.palm is not None:
        checks.append(lambda: (PALM in names) is wishes.palm)
    if wishes.within is not None:
        checks.append(lambda: bool(inside(wishes.within, points()).all()))
    checks += [lambda part=part: bool(inside(part, points(fingers)).any()) for part in wishes.touching]
    checks += [lambda part=part: not _deep(body, part, points()) for part in wishes.forbidden]
    if isinstance(wishes.approach, Approach):
        along = wishes.approach.direction
        checks.append(lambda: bool(looks @ along >= np.cos(wishes.approach.cone) - 1e-6) and before(along))
    elif wishes.approach == "above":
        checks.append(lambda: bool(-looks[2] >= np.cos(np.radians(40)) - 1e-6) and before(np.array([0, 0, -1.0])))
    elif wishes.approach == "side":
        checks.append(lambda: bool(abs(looks[2]) <= np.sin(np.radians(40)) + 1e-6))
    if not wishes.edges:
        checks.append(lambda: not on_edges(grasp.closure.object, grasp.closure.contacts()).any())
    if wishes.opening:
        checks.append(lambda: grasp.room >= wishes.opening)
    return all(check() for check in checks)


def _deep(body: pg.Mesh, part: object, where: np.ndarray) -> bool:
    """Whether any point lies inside a part by more than rounding."""
    lower, upper = body.regions[part]
    return bool(((where > lower + 1e-6) & (where < upper - 1e-6)).all(axis=1).any())


def search(hand: pg.HandModel, body: pg.Mesh, tasks: tuple[Task, ...], **options: object) -> GraspSearch:
    """Under the conditions of this benchmark."""
    conditions = pg.GraspConditions(mu=MU, reserve=Reserve(tasks=tasks))
    return pg.find_grasps(hand, body, conditions, progress=False, **options)


def withstands(grasp: FoundGrasp, tasks: tuple[Task, ...]) -> bool:
    """Whether a squeeze does, with these tasks, too."""
    if not tasks or not grasp.withstands:
        return grasp.withstands
    conditions = pg.GraspConditions(mu=MU, reserve=Reserve(tasks=tasks))
    _, judged = pg.synthesis.hold(grasp.closure, conditions)
    return judged is not None and judged.withstands


def _summarize(text: str, rows: list[dict[str, object]]) -> dict[str, object]:
    """One line of the table."""
    of_it = [row for row in rows if row["request"] == text]
    can = [row for row in of_it if row["can"]]
    met = [sum(bool(row["met"]) for row in some) for some in (can, of_it)]
    return {"request": text, "asked": len(of_it), "can be met": len(can), "of these met": met[0], "met": met[1]}


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--hands", nargs="+", default=list(HANDS))
    parser.add_argument("--objects", nargs="+", default=["mug", "jar", "box"])
    parser.add_argument("--samples", type=int, default=2000)
    parser.add_argument("--jobs", type=int, default=-1)
    args = parser.parse_args()
    rows: list[dict[str, object]] = []
    for hand_name in args.hands:
        hand = pg.load_hand(hand_name)
        for name, body in make_objects().items():
            if name not in args.objects:
                continue
            started, grasps = time.perf_counter(), list[FoundGrasp]()
            for wrap in (False, True):
                # Rounds of many samples, so that none ends the search early.
                found = search(
                    hand, body, (), seed=args.seed + 1000, count=args.samples // 2, wrap=wrap, jobs=args.jobs
                )
                grasps += found.grasps
            exhaustive = time.perf_counter() - started
            for request in requests_for(hand, name):
                started = time.perf_counter()
                found = search(hand, body, request.tasks, wishes=request.wishes, seed=args.seed, jobs=args.jobs)
                took = time.perf_counter() - started
                good = [one for one in found.grasps if one.withstands]
                rows.append(
                    {
                        "hand": hand_name,
                        "object": name,
                        "request": request.text,
                        "can": any(
                            is_as_wished(one, body, request) and withstands(one, request.tasks) for one in grasps
                        ),
                        "met": bool(good),
                        "as_wished": all(is_as_wished(one, body, request) for one in good),
                        "time_s": round(took, 1),
                        "exhaustive_s": round(exhaustive),
                        "unmet": " / ".join(found.unmet),
                    }
                )
                print(*(f"{value}" for value in list(rows[-1].values())), sep="; ", flush=True)
    first = header(["pin", "coal", "numpy", "pinograsp"], f"seed {args.seed}", f"{args.samples} samples")
    write_rows(HERE / "wishes.csv", first, rows)
    print(first)
    print(table([_summarize(text, rows) for text in dict.fromkeys(str(row["request"]) for row in rows)]))
    can = [row for row in rows if row["can"]]
    met = sum(bool(row["met"]) for row in can)
    print(f"met: {met} of {len(can)} that can be; {sum(bool(row['met']) for row in rows)} of {len(rows)} in all")
    print(f"not as wished: {sum(not row['as_wished'] for row in rows)}")


if __name__ == "__main__":
    main()
