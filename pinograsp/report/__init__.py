"""Readable reports of plans and simulations, and the tables of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pinograsp.checks import instance_of, items_of, path_of
from pinograsp.plan import PlanFailure, PlanRecord, Simulation
from pinograsp.report.checks import report_check
from pinograsp.report.document import Finding, Picture, Report, Section, list_section
from pinograsp.report.plans import report_failure, report_plan
from pinograsp.report.results import (
    answer_questions,
    answer_simulated,
    list_comparison,
    list_details,
    list_results,
    summarize,
)
from pinograsp.writing import place_of, write_errors

__all__ = [
    "Finding",
    "Picture",
    "Report",
    "Section",
    "answer_questions",
    "answer_simulated",
    "list_comparison",
    "list_details",
    "list_results",
    "list_section",
    "report_check",
    "report_failure",
    "report_plan",
    "summarize",
    "write_report",
]


def write_report(
    run: PlanRecord | PlanFailure,
    folder: str | Path,
    figures: Sequence[str | Path] = (),
    simulation: Simulation | None = None,
) -> None:
    """Write ``report.md`` and ``report.html`` into a folder that already holds the figures.

    Args:
        run: a plan, or a search that found none.
        folder: to write to.
        figures: names of the image files there, as from :func:`~pinograsp.viz.figures.save_figures`.
        simulation: of the plan.
    """
    instance_of("run", run, PlanRecord, PlanFailure)
    folder = path_of("folder", folder)
    names = [Path(str(name)).name for name in items_of("figures", figures, str, Path)]
    report = report_plan(run, names, simulation) if isinstance(run, PlanRecord) else report_failure(run)
    with write_errors(folder):
        place_of(folder)  # refuses names that no file system takes
        report.write(folder)
