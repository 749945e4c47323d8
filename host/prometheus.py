"""Aggregates of the probes for Prometheus, on loopback only. There is no label that grows with the array.

Gauges and counters are worked out when they are asked for, from the latest samples of all nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import TracebackType
from typing import TYPE_CHECKING, Any

from raygrid.host.probe_sums import Gauges
from raygrid.node.errors import ArrayError

if TYPE_CHECKING:
    from prometheus_client import Metric

LOOPBACK = "127.0.0.1"
TOTALS = {
    "nodes": "Processors that have told how they stand",
    "busy": "Processors of this computer that the nodes keep busy, by wall time",
    "rate": "Packets served a second of wall time",
    "held": "Packets that wait in nodes",
    "messages_waiting": "Messages that wait for a link",
    "surfaces": "Surfaces held by all nodes together",
    "resident": "Bytes of resident memory of all nodes, shared pages counted in each",
}


class Endpoint:
    """Serves the aggregates at http://127.0.0.1:PORT/metrics in a thread of its own. Use as a context manager.

    gauges   asked for at each visit
    port     0: any free one; see `port` afterwards
    Raises ArrayError if the library is not installed, or the port is taken.
    """

    def __init__(self, gauges: Callable[[], Gauges], port: int) -> None:
        try:
            from prometheus_client import CollectorRegistry, start_http_server
        except ImportError:
            raise ArrayError(
                "the Prometheus endpoint needs the library prometheus_client: raygrid[prometheus]"
            ) from None
        self._gauges = gauges
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        try:
            self._server, self._thread = start_http_server(port, addr=LOOPBACK, registry=registry)
        except (OSError, OverflowError) as error:
            raise ArrayError(f"no Prometheus endpoint can be opened at {LOOPBACK}:{port} ({error})") from None
        self.port = int(self._server.server_port)

    def describe(self) -> list[Any]:
        """Nothing is known before the first sample."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Told by the registry to tell."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        gauges = self._gauges()
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

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> Endpoint:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
