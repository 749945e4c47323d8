"""Makes figures for Prometheus: aggregates of probes, and how an array that stays is. No label grows with the array.

All are worked out when they are asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from raygrid.host.client.facts import JOB_STATES, SERVICE_STATES, StatusFacts
from raygrid.host.probes.sums import Gauges

if TYPE_CHECKING:
    from prometheus_client import Metric
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    LabelledFamily = type[CounterMetricFamily | GaugeMetricFamily]

TOTALS = {
    "nodes": "Processors that have told how they stand",
    "busy": "Processors of this computer that the nodes keep busy, by wall time",
    "rate": "Packets served a second of wall time",
    "held": "Packets that wait in nodes",
    "messages_waiting": "Messages that wait for a link",
    "surfaces": "Surfaces held by all nodes together",
    "pss": "Bytes of memory of all nodes (PSS): of pages that n processes share, the n-th part in each",
}


def of_probes(gauges: Gauges) -> Iterator[Metric]:
    """What the latest samples of all nodes add up to."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    totals = gauges.totals()
    for name, text in TOTALS.items():
        yield GaugeMetricFamily(f"raygrid_{name}", text, totals[name])
    for of in ("born", "died"):
        family = GaugeMetricFamily(f"raygrid_packets_{of}", f"Packets {of} in the frame under way", labels=["kind"])
        for kind, count in gauges.by_kind(of).items():
            family.add_metric([kind], count)
        yield family
    yield CounterMetricFamily("raygrid_samples", "Samples of nodes that came", gauges.samples)
    yield CounterMetricFamily("raygrid_samples_dropped", "Samples that nodes could not tell", totals["dropped"])


def of_service(facts: StatusFacts) -> Iterator[Metric]:
    """How an array that stays is. facts: what `raygrid status --json` prints."""
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    running, queue, faults = facts["running"], facts["queue"], facts["faults"]
    gauges = {
        "queue_jobs": ("Jobs that have not ended", queue["jobs"]),
        "queue_frames": ("Frames that were not begun", queue["frames"]),
        "running": ("Whether a frame is under way", int(running is not None)),
        "running_part": (
            "How much of its rays is traced, 0 to 1",
            0.0 if running is None else running.get("part", 0.0),
        ),
        "running_in_flight": ("Packets in flight", 0 if running is None else running.get("in_flight", 0)),
        "clients": ("Clients that are connected", facts["clients"]),
        "nodes": ("Processors of the array", len(facts["nodes"])),
        "load": ("Mean part of a processor that a node has used lately", facts["load"] or 0.0),
        "pss": (TOTALS["pss"], facts["pss"]),
        "started_seconds": ("When the service began, in seconds since 1970", facts["started"]),
        "journal_trouble": ("Whether the journal cannot be written", int(bool(facts["journal"]["trouble"]))),
    }
    for name, (text, value) in gauges.items():
        yield GaugeMetricFamily(f"raygrid_service_{name}", text, value)
    counters = {
        "faults": ("Faults of the array", faults["count"]),
        "resets": ("Resets that were asked for", facts["resets"]),
        "floods": ("Scenes that were loaded", facts["floods"]),
        "increments": ("Scenes that were moved on by increments", facts["increments"]),
    }
    for name, (text, value) in counters.items():
        yield CounterMetricFamily(f"raygrid_service_{name}", text, value)
    jobs = {state: facts["jobs"].get(state, 0) for state in JOB_STATES}
    yield _labelled(GaugeMetricFamily, "jobs", "Jobs in the journal, by state", "state", jobs)
    states = {state: int(facts["state"] == state) for state in SERVICE_STATES}
    yield _labelled(GaugeMetricFamily, "state", "1 for the state that the array is in", "state", states)
    yield _labelled(CounterMetricFamily, "frames", "Frames since the service began", "result", facts["frames"])
    yield _labelled(CounterMetricFamily, "refused", "Clients and requests refused", "why", facts["refused"])


def _labelled(kind: LabelledFamily, name: str, text: str, label: str, values: dict[str, int]) -> Metric:
    family = kind(f"raygrid_service_{name}", text, labels=[label])
    for value, number in values.items():
        family.add_metric([value], number)
    return family
