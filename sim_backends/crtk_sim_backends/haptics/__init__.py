"""A haptic device in shared memory, behind a vendor library that is simulated.

Such a library is C, is built when the simulator starts, and is loaded by whoever would load the vendor's: the
driver is the same with it. Between both there is a file that they map (``plant.h``).
"""

from crtk_sim_backends.haptics.library import compiler
from crtk_sim_backends.haptics.serving import LibrarySimulator

__all__ = ["LibrarySimulator", "compiler"]
