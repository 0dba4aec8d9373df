"""A simulator that is a library in place of a vendor's."""

from __future__ import annotations

import shutil
import tempfile
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import ClassVar, TypeVar

from typing_extensions import override

from crtk_sim_backends.haptics.library import build
from crtk_sim_backends.haptics.plant import HapticDevice
from crtk_sim_backends.kit import FaultKind, LoopServer, Options, Simulator

ConfigT = TypeVar("ConfigT", bound=Options)


class LibrarySimulator(Simulator[ConfigT, LoopServer]):
    """Builds the library when it starts, and tells its path.

    Attributes:
        source: the C file.
        library: what the vendor calls it.
        own_kinds: of faults, see `HapticDevice`.
    """

    source: ClassVar[Path]
    library: ClassVar[str]
    own_kinds: ClassVar[Mapping[str, FaultKind]]

    @abstractmethod
    def fields(self, config: ConfigT) -> Mapping[str, float]:
        """Return how the device is at the start."""

    @override
    def serve(self, config: ConfigT, parent_fd: int | None) -> LoopServer:
        """Build the library and map its device."""
        folder = Path(tempfile.mkdtemp(prefix="crtk-library-"))
        try:
            library = build(self.source, folder / self.library)
            device = HapticDevice(library, self.own_kinds)
            device.set(**self.fields(config))
            server = LoopServer(config, parent_fd, device, title=self.name, gauges=device.gauges)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        server.at_end(lambda: shutil.rmtree(folder, ignore_errors=True))
        server.paths["library"] = str(library)
        return server

    @override
    def describe(self, server: LoopServer) -> Iterator[str]:
        """Tell where the library is, too."""
        yield from super().describe(server)
        yield f"library: {server.paths['library']}"
