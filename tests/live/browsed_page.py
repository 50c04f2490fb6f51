"""The page of a live robot in a browser, with the hands of a user."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from waiting import wait_for

CONNECTED = """document.body?.dataset.link === "open"
  && document.getElementById("area").textContent.endsWith("m²")"""
"""It shows a map."""


class Page:
    """A page in a browser."""

    def __init__(self, call: Callable[..., Any]) -> None:
        self.call = call

    def open(self, address: str, width: int = 1300, scheme: str = "light") -> None:
        size = {"width": width, "height": 850, "deviceScaleFactor": 1, "mobile": width < 500}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Emulation.setTouchEmulationEnabled", enabled=width < 500)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.call("Emulation.setEmulatedMedia", features=[feature])
        self.call("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, expression: str) -> Any:
        return wait_for(lambda: self.value(expression))

    def key(self, kind: str, key: str, code: str) -> None:
        number = {"Space": 32, "ArrowUp": 38}.get(code, ord(key.upper()[0]))
        self.call(
            "Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number
        )

    def mouse(self, kind: str, x: float, y: float) -> None:
        of_button = {"button": "left", "buttons": int(kind != "mouseReleased"), "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **of_button)

    def touch(self, kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        self.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    def middle(self, name: str) -> tuple[float, float]:
        found = self.value(f"""(() => {{
          const one = document.getElementById("{name}");
          one.scrollIntoView({{block: "nearest"}});
          const box = one.getBoundingClientRect();
          return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")
        return found[0], found[1]

    def click(self, name: str) -> None:
        x, y = self.middle(name)
        self.mouse("mousePressed", x, y)
        self.mouse("mouseReleased", x, y)
