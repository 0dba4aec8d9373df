"""What drivers have in common, for those of this distribution and for those of plugins.

Small things that a driver uses, and none that it has to inherit: transports (`TcpTransport`, `UdpTransport`,
and `crtk_drivers.kit.serial_port.SerialPort`, which needs ``crtk-drivers[serial]``), decoders, a worker for
slow requests, a round of slow registers, parts of procedures.
"""

from crtk_drivers.kit.decoding import BadData, Decoder, FrameDecoder, LineDecoder, SeekingDecoder
from crtk_drivers.kit.message_link import Linked, MessageLink
from crtk_drivers.kit.request_worker import RequestWorker
from crtk_drivers.kit.round_robin import RoundRobin
from crtk_drivers.kit.sockets import ClosedByPeer, TcpTransport, UdpTransport
from crtk_drivers.kit.stream_goal import StreamGoal
from crtk_drivers.kit.trail import Trail
from crtk_drivers.kit.transport import Transport
from crtk_drivers.kit.waiting_steps import until

__all__ = [
    "BadData",
    "ClosedByPeer",
    "Decoder",
    "FrameDecoder",
    "LineDecoder",
    "Linked",
    "MessageLink",
    "RequestWorker",
    "RoundRobin",
    "SeekingDecoder",
    "StreamGoal",
    "TcpTransport",
    "Trail",
    "Transport",
    "UdpTransport",
    "until",
]
