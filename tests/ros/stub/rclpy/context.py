from __future__ import annotations

from functools import cache
from typing import Any

import yaml


class UnknownROSArgsError(RuntimeError):
    pass


class Context:
    def __init__(self) -> None:
        self._is_ok = False
        self.parameters: dict[str, Any] = {}
        self.remaps: dict[str, str] = {}

    def init(self, args: list[str] | None = None) -> None:
        if self._is_ok:
            raise RuntimeError("Context.init() must only be called once")
        self._is_ok = True
        words = iter((args or [])[(args or []).index("--ros-args") + 1 :] if has_ros(args) else ())
        for word in words:
            if word == "--":
                break
            if word not in ("-p", "-r"):
                raise UnknownROSArgsError(f"Found unknown ROS arguments: '{word}'")
            name, _, value = next(words).partition(":=")
            if word == "-p":
                self.parameters[name] = yaml.safe_load(value)
            else:
                self.remaps[name] = value

    def ok(self) -> bool:
        return self._is_ok

    def shutdown(self) -> None:
        self._is_ok = False


def has_ros(args: list[str] | None) -> bool:
    return "--ros-args" in (args or ())


@cache
def default_context() -> Context:
    return Context()
