"""The case study end to end: published figures, the records, storage, report, figures."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

import pinograsp
from pinograsp.cases import load_case
from pinograsp.cases.published import compare
from pinograsp.errors import ContactNotReached, GraspInfeasible, InvalidInput, ResultsNotWritten, Status
from pinograsp.planner import load_run, save_run
from pinograsp.report import list_comparison, report_plan
from pinograsp.storage import runs
from pinograsp.viz.figures import contact_forces, joint_angles, joint_torques, save_figures
from pinograsp.words import format_number
from pinograsp.writing import folders


@pytest.fixture(scope="module")
def plan(paper_plan):
    return paper_plan


@pytest.fixture(scope="module")
def rows(paper_case):
    return {row.quantity: row for row in compare(paper_case)}


def test_case_study_plan(plan):
    assert plan.status is Status.OK
    summary = plan.summary()
    assert summary["impact_time_s"] == 0.90
    assert sum(summary["normal_forces_N"].values()) == pytest.approx(20.216, abs=0.005)
    assert summary["residual_N"] < 1e-9
    assert summary["impulse_Ns"] == pytest.approx(2.977, abs=1e-3)
    assert set(summary["joint_torque_max_Nm"]) == {"thumb", "index", "middle", "ring", "little"}
    assert len(summary["joint_torque_max_Nm"]["thumb"]["grasp"]) == 4
    json.dumps(summary, allow_nan=False)


def test_the_shipped_case_balances_forces_and_moments():
    case = load_case("paper")
    assert case.forces.balance == "wrench"
    summary = case.plan().summary()
    assert summary["residual_N"] < 1e-9 and summary["residual_Nm"] < 1e-9


@pytest.mark.slow
def test_table_against_the_paper(rows):
    """Every figure of the results section, at the value the independent convex solution gives it."""
    expected = {
        "impact time t_I": (0.90, 0),
        "sum of normal forces": (20.216, 0.005),
        "remaining net force": (0, 1e-9),
        "hybrid, force balance, least work: work": (55.78, 0.56),
        "hybrid, wrench balance, least work: work": (57.09, 1.72),
        "hybrid, force balance, least impulse: impulse": (2.977, 0.002),
        "work at the published forces": (59.24, 0.005),
        "impulse at the published forces": (3.081, 0.0005),
        "QP at the published forces, mu = 0.7": (0.0801, 5e-5),
        "QP at the published forces, mu = 0.693": (0.089, 5e-4),
        "QP at the published forces, mu = 0.8": (0, 1e-9),
        "latest feasible t_I (1 ms grid), force balance": (0.91877, 0.0015),
        "latest feasible t_I (1 ms grid), wrench balance": (0.91674, 0.003),
        "thumb: in-plane force of the published torques": (0.28 * 9.873, 0.06),
        "index: in-plane force of the published torques": (0.29 * 6.35, 0.12),
        "middle: in-plane force of the published torques": (0.21 * 4.7, 0.06),
    }
    for quantity, (value, within) in expected.items():
        assert rows[quantity].ours == pytest.approx(value, abs=within), quantity
    assert rows["the paper's grid search: net force"].ours <= 0.1
    # Gravity and inertia alone: the published order of magnitude.
    for joint in ("thumb_abduction", "thumb_cmc", "thumb_mcp", "thumb_ip", "index_abduction", "index_mcp"):
        row = rows[f"approach torque {joint}"]
        assert 0.5 < row.ours / row.published < 2
    assert rows["energy, not optimised (MSC.Adams)"].difference is None
    assert rows["normal force thumb"].difference == pytest.approx(rows["normal force thumb"].ours - 9.873)


@pytest.mark.slow
def test_comparison_says_so_where_there_is_no_grasp(paper_case):
    coarse = load_case("paper", {"grid.accelerations": [0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7]})
    table = {row.quantity: row for row in compare(coarse)}
    assert table["hybrid, wrench balance, least work"].note == "no grasp on this grid"


def test_public_names_plan_a_grasp_in_ten_lines(paper_case):
    hand = pinograsp.load_hand("humanoid", pose=paper_case.load_hand().pose, limits={"thumb_abduction": (-0.3, 2.3)})
    pen = pinograsp.Cylinder(radius=0.01, height=0.12, mass=0.5, pose=paper_case.make_object().pose)
    points = {"thumb": [-2.6e-3, -9.6e-3, 61.5e-3], "index": [4.7e-3, 8.8e-3, 71e-3], "middle": [1.7e-3, 9.7e-3, 50e-3]}
    problem = pinograsp.ForceProblem.holding(
        pen, pinograsp.contacts_at(hand, pen, points), mu=0.7, friction=pinograsp.Friction(), max_depth=5e-3
    )
    plan = pinograsp.plan_grasp(hand, problem)
    assert plan.status is Status.OK and plan.forces.residual_moment < 1e-9


def test_infeasible_loads_raise_with_the_histogram(paper_case):
    with pytest.raises(GraspInfeasible, match="closest to balance") as caught:
        load_case("paper", {"object.mass": 50.0}).plan()
    assert caught.value.solution.status is Status.INFEASIBLE
    with pytest.raises(ContactNotReached):
        load_case("paper", {"hand.limits_deg": {}}).plan()


def test_status_remedies():
    for status in Status:
        assert bool(status.remedy) == (status not in (Status.OK, Status.HELD))
        assert str(status) == status.value and status.words
        assert status.code < 0 or Status.from_code(status.code) is status


# -- storage -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(plan):
    return plan.with_margins().with_reach()


@pytest.mark.slow
def test_fresh_and_stored_plans_do_the_same(plan, tmp_path, no_rendering):
    """Files for controllers, figures and pages; a stored plan is saved again as it was."""
    back = pinograsp.load_run(pinograsp.save_run(plan, tmp_path / "run"))
    assert back.summary() == plan.summary() and back.hand.n == 20
    written = []
    for name, one in (("fresh", plan), ("stored", back)):
        folder = tmp_path / name
        folder.mkdir()
        one.to_csv(folder / "a.csv", rate=100.0)
        one.to_ros2(folder / "a.json", rate=100.0)
        one.to_mujoco(folder / "a.xml", rate=100.0)
        written.append({path.name: path.read_bytes() for path in folder.iterdir() if path.suffix != ".npz"})
    assert written[0] == written[1] and len(written[0]) == 3
    assert [path.name for path in back.save_figures(tmp_path / "stored")][-1] == "wrench_margin.png"
    # What is computed from its forces comes out the same.
    bands = [one.force_band(5.0) for one in (plan, back)]
    np.testing.assert_allclose(bands[1].lowest, bands[0].lowest, rtol=1e-9)
    assert back.object_stiffness(5.0).margin == pytest.approx(plan.object_stiffness(5.0).margin, rel=1e-9)
    loops = [pinograsp.OnlineForces(one.problem, hand=one.hand, q=one.motion.q[-1]) for one in (plan, back)]
    told = [loop.step(1.05 * plan.load) for loop in loops]
    np.testing.assert_allclose(told[1][0], told[0][0], atol=1e-9)
    assert told[0][2] is told[1][2] is Status.OK
    assert back.to_core(tmp_path / "grasp.hpp").is_file()


def test_only_plans_are_saved(run, tmp_path):
    for other in (3, "runs/paper", None, GraspInfeasible("none", None)):
        with pytest.raises(InvalidInput, match="plan: expected a GraspPlan or PlanFailure, got"):
            save_run(other, tmp_path / "other")
    for settings in ({"a": object()}, {"a": float("nan")}):
        with pytest.raises(InvalidInput, match="expected plain, finite values"):
            save_run(replace(run, settings=settings), tmp_path / "other")
    assert os.listdir(tmp_path) == []


def test_what_is_read_is_of_one_run(run, tmp_path, monkeypatch):
    """Another run takes the folder's place after its first files were read."""
    folder = save_run(run, tmp_path / "run")
    other = replace(run, settings={"name": "other"}, body=None)
    plain = runs.read_arrays

    def replaced(*args):
        monkeypatch.setattr(runs, "read_arrays", plain)
        found = plain(*args)
        save_run(other, folder, force=True)
        return found

    monkeypatch.setattr(runs, "read_arrays", replaced)
    back = load_run(folder)
    assert back.settings == {"name": "other"} and back.body is None


def test_forces_and_motion_agree(plan):
    forces, motion, contacts = plan.forces, plan.motion, plan.contacts
    normal = np.einsum("mkx,kx->mk", motion.forces_o, contacts.rotations_oc[:, :, 2])
    assert np.allclose(normal, forces.normal_history)
    assert np.linalg.norm(plan.residual_force_o[-1]) < 1e-9
    assert np.allclose(forces.final_depths, forces.depths.max(axis=0))


def test_settings_are_echoed_and_make_the_same_plan(run, tmp_path):
    import yaml

    path = tmp_path / "again.yaml"
    with path.open("w") as stream:
        yaml.safe_dump(run.settings, stream)
    again = load_case(path).plan().summary()
    for key in ("normal_forces_N", "multipliers", "work_J", "joint_torque_max_Nm"):
        assert again[key] == run.summary()[key]


def test_existing_folders_are_kept(run, tmp_path):
    folder = save_run(run, tmp_path / "run")
    before = (folder / "plan.json").read_bytes()
    with pytest.raises(ResultsNotWritten, match="--force"):
        save_run(run, folder)
    assert (folder / "plan.json").read_bytes() == before
    save_run(replace(run, motion=replace(run.motion, status=Status.JOINT_LIMIT)), folder, force=True)
    assert load_run(folder).status is Status.JOINT_LIMIT


def test_a_crash_leaves_nothing_behind(run, tmp_path):
    def crash(path):
        (path / "half.png").write_text("half")
        raise RuntimeError("no space")

    with pytest.raises(RuntimeError):
        save_run(run, tmp_path / "run", extras=crash)
    assert list(tmp_path.iterdir()) == []
    folder = save_run(run, tmp_path / "kept")
    with pytest.raises(RuntimeError):
        save_run(run, folder, force=True, extras=crash)
    assert load_run(folder).summary() == run.summary()
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]


def test_an_earlier_run_survives_a_failed_rename(run, tmp_path, monkeypatch):
    folder = save_run(run, tmp_path / "run")

    def failing(one, other):
        raise OSError("disk full")

    monkeypatch.setattr(folders, "_exchange", failing)
    with pytest.raises(ResultsNotWritten, match="disk full"):
        save_run(run, folder, force=True)
    monkeypatch.undo()
    assert load_run(folder).summary() == run.summary()


def test_unwritable_places_and_foreign_folders(run, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsNotWritten):
        save_run(run, tmp_path / "file" / "run")
    with pytest.raises(InvalidInput, match="no readable run"):
        load_run(tmp_path)


# -- report and figures ------------------------------------------------------------------------------------------------


def test_report_reads_well(run, rows):
    assert all(isinstance(cell, str) for row in list_comparison(list(rows.values())) for cell in row)
    compared = replace(run, comparison=tuple(rows.values()))
    text = report_plan(compared, ["joint_angles.png"]).to_markdown()
    for expected in (
        "| status | ok |",
        "thumb 9.803",
        "## Notes",
        "limits of thumb_abduction set to -15..130",
        "moments are not",
        "55.90",
        "<summary>Assumed inputs</summary>",
        "| friction.mu |",
        "](joint_angles.png)",
        "Eq. 13a",
    ):
        assert expected in text, expected
    assert "nan" not in text.lower().replace("finance", "")
    widths = {}
    for line in text.splitlines():
        if line.startswith("|"):
            widths.setdefault(line.count("|"), line)
    assert set(widths) <= {3, 6, 7, 8}
    unbalanced = replace(run, forces=replace(run.forces, status=Status.UNBALANCED), cautions=())
    told = report_plan(unbalanced).to_markdown()
    assert "\nunbalanced: These normal forces" in told and "moments are not" not in told


def test_numbers_for_people():
    assert [format_number(v) for v in (None, 0, 0.9, 20.2156, 8.45e-14, 123456.7, 1e9, -0.0695)] == [
        "-",
        "0",
        "0.9000",
        "20.22",
        "8.45e-14",
        "123457",
        "1.00e+09",
        "-0.06950",
    ]


@pytest.mark.slow
def test_figures_show_what_was_planned(run, tmp_path):
    figure = joint_angles(run)
    assert [axes.get_legend().get_title().get_text() for axes in figure.axes] == ["thumb", "index", "middle"]
    drawn = figure.axes[0].lines[0].get_ydata()
    assert drawn[-1] == pytest.approx(130) and len(figure.axes[0].lines) == 5  # four joints and the impact
    torques = joint_torques(run, "index")
    assert torques.axes[1].get_xlim()[1] == pytest.approx(0.9)
    forces = contact_forces(run)
    labels = [line.get_label() for line in forces.axes[0].lines]
    assert labels[:3] == ["thumb", "index", "middle"] and "net force, load included" in labels
    assert forces.axes[0].lines[0].get_ydata()[-1] == pytest.approx(run.forces.normal_forces[0])
    assert forces.axes[1].lines[0].get_ydata()[-1] == pytest.approx(1e3 * run.forces.final_depths.max())
    paths = save_figures(run, tmp_path)
    assert [path.name for path in paths] == [
        "grasp.png",
        "joint_angles.png",
        "joint_rates.png",
        "torques_thumb.png",
        "torques_index.png",
        "torques_middle.png",
        "contact_forces.png",
        "grasp_energy.png",
        "friction_use.png",
        "wrench_margin.png",
    ]
    for path in paths:
        assert np.std(imread(path)[:, :, :3]) > 0.02, path.name  # not blank
