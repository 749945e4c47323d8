"""Figures for Prometheus: what they say, that they stay on loopback, and that idle visitors hold nothing up."""

import contextlib
import math
import socket
import threading
import urllib.error
import urllib.request

import pytest

from raygrid.emulator.driver.samples import LinkSample, NodeSample
from raygrid.host.probes import metrics_server
from raygrid.host.probes.metrics_server import MOST_VISITS, Endpoint
from raygrid.host.probes.prometheus import of_probes, of_service
from raygrid.host.probes.sums import Gauges
from raygrid.node.errors import ArrayError

STATUS = {
    "state": "ready", "started": 5.0, "load": None, "pss": 123, "nodes": [{}, {}], "clients": 4, "floods": 2, "increments": 1,
    "resets": 0, "faults": {"count": 3, "last": []}, "queue": {"jobs": 6, "frames": 70}, "running": None,
    "jobs": {"queued": 5, "running": 1, "done": 9}, "frames": {"done": 8, "skipped": 1, "failed": 0},
    "refused": {"crowd": 2}, "journal": {"path": "/j", "trouble": ""},
}  # fmt: skip


def made(node):
    """A sample by hand."""
    return NodeSample(
        node, 0, 0, 1.0, "trace", {"primary": 7}, {}, {}, 0, 0,
        {"travellers": 1, "shadows": 2, "rays": 3}, {}, {"-x": 4}, {"+x": LinkSample(1, 2, 3, 4)}, 5,
        {"pss": 1_000_000}, 0.0, 0,
    )  # fmt: skip


def scraped(endpoint):
    with urllib.request.urlopen(endpoint.url, timeout=20) as answer:
        return answer.read().decode()


def empty():
    return of_probes(Gauges((1, 1, 1)))


def test_aggregates_of_probes_and_no_label_grows_with_the_array():
    lines = []
    for shape in ((2, 1, 1), (8, 8, 8)):
        gauges = Gauges(shape)
        for k in range(math.prod(shape)):
            gauges.take(made((k % shape[0], k // shape[0] % shape[1], k // (shape[0] * shape[1]))))
        with Endpoint(lambda gauges=gauges: of_probes(gauges), 0) as endpoint:
            text = scraped(endpoint)
        assert f"raygrid_nodes {math.prod(shape)}.0" in text
        assert f'raygrid_packets_born{{kind="primary"}} {7.0 * math.prod(shape)}' in text
        assert f"raygrid_samples_total {math.prod(shape)}.0" in text
        lines.append(text.count("\n"))
    assert lines[0] == lines[1]


def test_figures_of_a_service_are_those_of_its_status():
    with Endpoint(lambda: of_service(STATUS), 0) as endpoint:
        text = scraped(endpoint)
    for line in (
        "raygrid_service_queue_jobs 6.0",
        "raygrid_service_queue_frames 70.0",
        "raygrid_service_faults_total 3.0",
        'raygrid_service_frames_total{result="done"} 8.0',
        'raygrid_service_jobs{state="done"} 9.0',
        'raygrid_service_jobs{state="failed"} 0.0',
        'raygrid_service_state{state="ready"} 1.0',
        'raygrid_service_state{state="broken"} 0.0',
        'raygrid_service_refused_total{why="crowd"} 2.0',
        "raygrid_service_pss 123.0",
        "raygrid_service_running 0.0",
    ):
        assert line in text.splitlines()


def test_the_endpoint_is_on_loopback_and_closes():
    with Endpoint(empty, 0) as endpoint:
        assert endpoint._server.server_address[0] == "127.0.0.1"
        with pytest.raises(ArrayError, match=r"no Prometheus endpoint can be opened at 127\.0\.0\.1"):
            Endpoint(empty, endpoint.port)
        port = endpoint.port
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), 5)


def test_without_the_library_the_endpoint_says_so(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "prometheus_client", None)
    with pytest.raises(ArrayError, match=r"needs prometheus_client: pip install prometheus_client$"):
        Endpoint(empty, 0)


@contextlib.contextmanager
def idle(endpoint, count):
    """So many visitors that say nothing."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(socket.create_connection(("127.0.0.1", endpoint.port), 20)) for _ in range(count)]


def test_idle_visitors_have_few_threads_and_keep_nobody_from_the_figures():
    before = threading.active_count()
    with Endpoint(empty, 0) as endpoint, idle(endpoint, 5 * MOST_VISITS):
        assert "raygrid_nodes 0.0" in scraped(endpoint)
        assert threading.active_count() <= before + 1 + 2 * MOST_VISITS
    assert threading.active_count() == before


def test_who_comes_before_a_crowd_has_gone_waits_for_a_place(monkeypatch):
    """No idle visit ends before the one for the figures has come: it was sent away."""
    gate, hang_up, visit = threading.Event(), metrics_server._hang_up, metrics_server._Server.process_request_thread

    def late(server, *arguments):
        gate.wait(20.0)
        visit(server, *arguments)

    with Endpoint(empty, 0) as endpoint:

        def watched(request):
            hang_up(request)
            if len(endpoint._server._visits) == 2 * MOST_VISITS:
                gate.set()

        monkeypatch.setattr(metrics_server._Server, "process_request_thread", late)
        monkeypatch.setattr(metrics_server, "_hang_up", watched)
        with idle(endpoint, 2 * MOST_VISITS):
            assert "raygrid_nodes 0.0" in scraped(endpoint)


def test_a_visitor_that_is_too_slow_is_let_go(monkeypatch):
    monkeypatch.setattr(metrics_server, "VISIT_SECONDS", 0.1)
    with Endpoint(empty, 0) as endpoint, idle(endpoint, 1) as (peer,):
        peer.sendall(b"GET /metrics HT")
        assert peer.recv(100) == b""


def test_an_endpoint_whose_figures_cannot_be_had_says_so_and_goes_on(capfd):
    whole = [False]

    def families():
        if not whole[0]:
            raise TimeoutError
        return empty()

    with Endpoint(families, 0) as endpoint:
        with pytest.raises(urllib.error.HTTPError, match="500"):
            scraped(endpoint)
        whole[0] = True
        assert "raygrid_nodes 0.0" in scraped(endpoint)
