"""Arguments of ROS, as rcl reads them: remapping of names, namespace and parameters, after --ros-args."""

from dataclasses import dataclass, field
from typing import Any

import yaml


@dataclass
class Arguments:
    """What a command line says to a node."""

    remaps: list[tuple[str, str]] = field(default_factory=list)
    parameters: dict[str, Any] = field(default_factory=dict)
    namespace: str = "/"
    node: str = ""

    def full(self, name: str, node: str) -> str:
        """Full name of a topic."""
        if name.startswith("~"):
            return f"{self.namespace.rstrip('/')}/{node}{name[1:]}"
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"

    def resolved(self, name: str, node: str) -> str:
        """Full name of a topic after remapping."""
        full = self.full(name, node)
        for before, after in self.remaps:
            if self.full(before, node) == full:
                return self.full(after, node)
        return full


def without_ros(words: list[str]) -> tuple[list[str], list[str]]:
    """The words for the program, and those for ROS, which are between --ros-args and -- or the end."""
    own, of_ros, is_ros = list[str](), list[str](), False
    for word in words:
        if word == "--ros-args":
            is_ros = True
        elif word == "--" and is_ros:
            is_ros = False
        else:
            (of_ros if is_ros else own).append(word)
    return own, of_ros


def read(words: list[str]) -> Arguments:
    """Reads a command line; raises ValueError where rcl raises UnknownROSArgsError."""
    found, given = Arguments(), iter(without_ros(words)[1])
    for word in given:
        if word in ("-r", "--remap"):
            before, mark, after = next(given).partition(":=")
            assert mark, "a rule of remapping is FROM:=TO"
            if before == "__ns":
                found.namespace = after
            elif before in ("__node", "__name"):
                found.node = after
            else:
                found.remaps.append((before, after))
        elif word in ("-p", "--param"):
            name, mark, value = next(given).partition(":=")
            assert mark, "a parameter is NAME:=VALUE"
            found.parameters[name] = yaml.safe_load(value)
        else:
            raise ValueError(f"unknown ROS argument {word}")
    return found
