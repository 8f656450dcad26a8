"""Test of the messages to the window about the computers that render."""

from __future__ import annotations

from msgspec.structs import replace

from carina.render import ClusterStatus, MemberStatus
from carina.server.cluster_status import ClusterWatch
from carina.server.wire import messages as wire

FAR = MemberStatus(
    name="a",
    host="10.0.0.7",
    threads=8,
    simd="avx2",
    state="late",
    share=0.333333,
    latency_ms=12.34,
    num_late=2,
    num_strips=90,
)
NEAR = replace(FAR, name="console", host="this machine", latency_ms=None)
STATUS = ClusterStatus(
    address="10.0.0.1:6379",
    members=(NEAR, FAR),
    alone=False,
    mixed=True,
    fps=29.97,
    frame_ms=None,
    notices=("the machine b has left the cluster",),
)


def test_window_receives_the_rendering_computers_of_the_cluster_and_each_notice_once() -> None:
    reported: list[wire.Cluster | wire.Notice] = []
    watch = ClusterWatch(lambda: STATUS, reported.append)
    watch.poll()
    watch.poll()
    shown = wire.Cluster(
        address="10.0.0.1:6379",
        members=(replace(FAR, share=0.3333, latency_ms=12.3),),
        alone=False,
        mixed=True,
        fps=30.0,
        frame_ms=None,
    )
    assert reported == [wire.Notice("the machine b has left the cluster"), shown, shown]
    assert wire.parse_server_message(wire.encode_message(shown)) == shown
