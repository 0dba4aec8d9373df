"""CRTK devices for programs that speak OpenIGTLink: 3D Slicer, Plus, sawOpenIGTLink, pyigtl.

    with crtk_drivers.connect("virtual") as arm, Bridge({"arm": arm}) as bridge:
        server = Server(bridge)
        server.start()
        ...
        server.close()

`Bridge` has the devices, `Server` and `Caller` are how peers come to it.
"""

from crtk_drivers.front.openigtlink.bridge import Bridge
from crtk_drivers.front.openigtlink.doors import PORT, Caller, Server
from crtk_drivers.front.openigtlink.message_values import METRES, MILLIMETRES

__all__ = ["METRES", "MILLIMETRES", "PORT", "Bridge", "Caller", "Server"]
