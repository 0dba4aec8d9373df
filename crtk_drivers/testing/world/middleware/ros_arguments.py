"""What follows ``--ros-args`` on a command line, as far as worlds know it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import yaml

from crtk_drivers.testing.world.machine.kernel import NotSimulated

_FLAGS: Final = ("--disable-rosout-logs", "--disable-stdout-logs", "--disable-external-lib-logs")
_WITH_VALUE: Final = ("--log-level", "--enclave", "-e")


@dataclass
class RosArguments:
    """Remappings and parameters of one node.

    Attributes:
        renamed: new names of topics and services, by full or relative name.
        name, namespace: of the node; empty: as it says itself.
        parameters: by name.
    """

    renamed: dict[str, str] = field(default_factory=dict)
    name: str = ""
    namespace: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)

    def read(self, arguments: Sequence[str]) -> None:
        """Add what a command line says.

        Raises:
            RuntimeError: a rule cannot be read, as rcl says it.
            NotSimulated: a world does not know this argument.
        """
        words = iter(arguments)
        within = False
        for word in words:
            if word == "--ros-args":
                within = True
            elif word == "--":
                within = False
            elif not within or word in _FLAGS:
                continue
            elif word in _WITH_VALUE:
                next(words, "")
            elif word in ("-r", "--remap"):
                self._remap(next(words, ""))
            elif word in ("-p", "--param"):
                self._set(next(words, ""))
            else:
                raise NotSimulated(f"the ROS argument {word}")

    def _remap(self, rule: str) -> None:
        before, is_rule, after = rule.partition(":=")
        if not (is_rule and before and after):
            raise RuntimeError(f"Couldn't parse remap rule: '-r {rule}'")
        if before in ("__node", "__name"):
            self.name = after
        elif before == "__ns":
            self.namespace = after
        else:
            self.renamed[before] = after

    def _set(self, rule: str) -> None:
        name, is_rule, value = rule.partition(":=")
        if not (is_rule and name):
            raise RuntimeError(f"Couldn't parse parameter override rule: '-p {rule}'")
        self.parameters[name] = yaml.safe_load(value)
