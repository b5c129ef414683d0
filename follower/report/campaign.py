"""The report of a campaign: one HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from string import Template
from typing import Any

from follower.campaign.campaign_config import CampaignConfig
from follower.campaign.summary import Summary, share_text
from follower.report import html, style
from follower.report.campaign_plots import (
    distributions,
    failures_by_parameter,
    heat_map,
    parallel_coordinates,
)
from follower.report.campaign_tables import goals_table, missed_table, worst_table
from follower.sight import Sight
from follower_sim.stand_in import LABEL


def render(
    config: CampaignConfig,
    rows: Sequence[dict[str, Any]],
    summary: Summary,
    seen: Mapping[int, str],
    remarks: Sequence[str] = (),
) -> str:
    """Return the page.

    Args:
        config: what was asked for.
        rows: the judged rows, one a run.
        summary: what they come to.
        seen: the folders of the runs that were flown again with video, by the runs' numbers.
        remarks: what the reader has to know.
    """
    page = resources.files("follower.report").joinpath("page.html").read_text("utf-8")
    with style.plot_style():
        body = "\n".join(part for part in _parts(config, rows, summary, seen, remarks) if part)
    return Template(page).substitute(
        title=escape(config.title),
        subtitle=escape(_subtitle(config, summary)),
        light=style.css_variables(dark=False),
        dark=style.css_variables(dark=True),
        body=body,
    )


def _subtitle(config: CampaignConfig, summary: Summary) -> str:
    said = f"campaign {config.name} · {summary.runs} runs · seed {config.seed} · lockstep"
    return f"{said} · {LABEL}" if config.vision is Sight.TRUTH else f"{said} · full pixels"


def _parts(
    config: CampaignConfig,
    rows: Sequence[dict[str, Any]],
    summary: Summary,
    seen: Mapping[int, str],
    remarks: Sequence[str],
) -> tuple[str, ...]:
    flown = [row for row in rows if not row["error"]]
    return (
        _headline(config, summary, remarks),
        html.section("Goals", goals_table(summary), html.paragraph(_HOW_SURE)),
        html.section("What was missed", missed_table(summary)),
        html.section("Distributions", distributions(flown, config.goals)),
        html.section("Who fails where", heat_map(rows)),
        html.section("Passing by parameter", failures_by_parameter(rows)),
        html.section("All runs at once", parallel_coordinates(flown)),
        html.section("The worst runs", worst_table(summary, seen)),
        html.section("This campaign", _about(config, rows)),
    )


def _headline(config: CampaignConfig, summary: Summary, remarks: Sequence[str]) -> str:
    lines = [f"{line.name}: {line.value}, wanted {line.wanted}"
             for line in summary.goals if not line.met]  # fmt: skip
    if config.vision is Sight.TRUTH:
        lines.insert(0, f"{LABEL[0].upper()}{LABEL[1:]}: this says nothing about trackers.")
    if summary.errors:
        lines.append(f"{summary.errors} runs could not be flown.")
    items = "".join(f"<li>{escape(line)}</li>" for line in [*lines, *remarks])
    kind = "passed" if summary.reached else "failed"
    met = sum(line.met for line in summary.goals)
    headline = f"{met} of {len(summary.goals)} goals met"
    passed = share_text(summary.passed, summary.runs)
    tiles = html.tiles((("Runs that reached every goal of their own", passed),))
    return (
        f'<div class="verdict {kind}"><strong>{escape(headline)}</strong><ul>{items}</ul></div>\n'
        + tiles
    )


def _about(config: CampaignConfig, rows: Sequence[dict[str, Any]]) -> str:
    import yaml

    text = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    versions = sorted({str(row["version"]) for row in rows})
    facts = [("Version", ", ".join(versions)), ("Time in flights", f"{_wall_s(rows):.0f} s")]
    return html.table(("Fact", "Value"), facts) + html.folded(
        "The campaign as resolved", html.preformatted(text)
    )


def _wall_s(rows: Sequence[dict[str, Any]]) -> float:
    return sum(float(row.get("wall_s", 0.0)) for row in rows)


_HOW_SURE = (
    "In brackets: the 95 % score interval (Wilson, 1927) of the counted share. Each run flies its "
    "own draw of the parameters; a goal over all runs can be met although single runs miss theirs."
)
