"""The Rerun viewer as a child process: in a window, in a browser, or headless."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO
from urllib.parse import quote

from rerun.experimental import ViewerClient

from slamsim.guard.errors import InputRefused, NotFound, SlamsimError
from slamsim.guard.files import open_input, own_file
from slamsim.process.children import dying_with_us

START_TIMEOUT_S = 60.0
LIVE_MEMORY = "512MB"
"""What a live viewer keeps: at 20 scans of 400 points a second, more than an hour of them."""
_QUIET = "warn,egui_wgpu=error,re_renderer=error,re_viewer::native=error"
"""Says nothing about a slow graphics driver, which a screenshot would show as a pop-up."""


def recording_of(run: Path) -> Path:
    """The recording in a run's folder, or the recording itself.

    Raises NotFound, also if a folder holds several, InputRefused for a file that is something
    else, and DataDamaged for one that is not as it was written.
    """
    path = own_file(run, "run.rrd") if run.is_dir() else run
    if run.is_dir() and not path.is_file():
        names = sorted(found.name for found in run.glob("*.rrd"))
        if len(names) > 1:
            raise NotFound(f"{run} holds several recordings; name one: {', '.join(names)}")
        path = own_file(run, names[0]) if names else path
    if not path.is_file():
        raise NotFound(f"{path}: there is no such recording; slamsim map writes one")
    with open_input(path) as file:
        if not file.read(4).startswith(b"RRF"):
            raise InputRefused(path, "is not a Rerun recording (.rrd)")
    return path


def open_viewer(recording: Path) -> None:
    """Show a recording in a window until the window is closed.

    Raises SlamsimError without a screen.
    """
    if not _has_screen():
        raise SlamsimError(
            "there is no screen here to open a window on; --web serves the recording to a "
            "browser, --screenshot FILE draws it into a file"
        )
    _run_until_closed(["--port", "auto", "--bind", "127.0.0.1", str(recording)])


def serve_web(recording: Path, tell: Callable[[str], None]) -> None:
    """Serve a recording to browsers on this machine until Ctrl-C; tell is given the address."""
    data, page = free_port(), free_port()
    source = quote(f"rerun+http://127.0.0.1:{data}/proxy", safe="")
    ports = ["--port", str(data), "--web-viewer-port", str(page), "--bind", "127.0.0.1"]
    tell(f"http://127.0.0.1:{page}?url={source}")
    _run_until_closed(["--serve-web", *ports, str(recording)])


@contextmanager
def live_viewer() -> Iterator[tuple[str, str]]:
    """A viewer that shows what it is sent: a window, or without a screen a page for browsers on
    this machine. Gives the URL to send to, and what to open; it ends with the block.

    It keeps what came last, in ``LIVE_MEMORY``. Raises SlamsimError if it does not start.
    """
    data, page = free_port(), free_port()
    url = f"rerun+http://127.0.0.1:{data}/proxy"
    shown = f"http://127.0.0.1:{page}?url={quote(url, safe='')}"
    arguments = ["--port", str(data), "--bind", "127.0.0.1"]
    if _has_screen():
        arguments += ["--memory-limit", LIVE_MEMORY, "--hide-welcome-screen", "--expect-data-soon"]
        shown = "the window of the Rerun viewer"
    else:
        arguments += ["--serve-web", "--web-viewer-port", str(page)]
        arguments += ["--server-memory-limit", LIVE_MEMORY]
    with TemporaryFile() as output:
        process = subprocess.Popen(
            dying_with_us([_executable(), *arguments]),
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is for us, who end it when nothing more is sent
        )
        try:
            _await_listening(process, data, output)
            yield url, shown
        finally:
            process.kill()  # it has nothing to save, and waits for browsers if it is asked kindly
            process.wait()


def _await_listening(process: subprocess.Popen[bytes], port: int, output: IO[bytes]) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise SlamsimError(_last_words("the Rerun viewer did not start", output))
        with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
            return
        time.sleep(0.1)
    raise SlamsimError(f"the Rerun viewer did not listen within {START_TIMEOUT_S:.0f} s")


def _has_screen() -> bool:
    return sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


@contextmanager
def headless_viewer(recording: Path | None, width: int, height: int) -> Iterator[ViewerClient]:
    """A viewer without a screen that has the recording open; it ends with the block.

    recording: None for one that is sent to the client's URL.

    Raises SlamsimError if it does not start, as without any Vulkan driver, or dies in the block.
    """
    port = free_port()
    arguments = ["--headless", "--port", str(port), "--bind", "127.0.0.1"]
    arguments += ["--window-size", f"{width}x{height}"]
    arguments += [] if recording is None else [str(recording.resolve())]
    with TemporaryFile() as output, TemporaryDirectory(prefix="slamsim-viewer-") as own:
        process = subprocess.Popen(
            dying_with_us([_executable(), *arguments]),
            env={**_environment(), **_apart(Path(own))},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        try:
            yield _connected(process, port, output)
        except ConnectionError as error:
            raise SlamsimError(_why_silent(process, output, error)) from error
        finally:
            _end(process)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _connected(process: subprocess.Popen[bytes], port: int, output: IO[bytes]) -> ViewerClient:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise SlamsimError(_last_words("the Rerun viewer did not start", output))
        with suppress(Exception):
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        time.sleep(0.1)
    raise SlamsimError(f"the Rerun viewer did not answer within {START_TIMEOUT_S:.0f} s")


def _why_silent(process: subprocess.Popen[bytes], output: IO[bytes], error: ConnectionError) -> str:
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=3.0)
        return _last_words("the Rerun viewer crashed", output)
    return f"the Rerun viewer does not answer: {error}"


def _last_words(what: str, output: IO[bytes]) -> str:
    """Why a viewer ended, by its output. what: how it ended, where the output does not tell why."""
    output.seek(0)
    text = output.read().decode(errors="replace")
    if "graphics adapter" in text or "render context" in text:
        return (
            "there is no Vulkan driver here to draw with; one in software will do: "
            "apt install mesa-vulkan-drivers (Debian and Ubuntu)"
        )
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    telling = [line for line in lines if "panicked" in line or line.startswith("Error")]
    return f"{what}: {(telling or lines or ['no output'])[-1]}"


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _run_until_closed(arguments: list[str]) -> None:
    process = subprocess.Popen(dying_with_us([_executable(), *arguments]), env=_environment())
    try:
        code = process.wait()
    except BaseException:
        _end(process)
        raise
    if code != 0:
        raise SlamsimError(f"the Rerun viewer ended with code {code}")


def _executable() -> str:
    """The viewer of the installed package itself: its console script may not be on the PATH."""
    spec = find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec and spec.origin else Path("rerun_cli")
    names = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
    found = [folder / name for name in names if (folder / name).is_file()]
    if not found:
        raise SlamsimError(f"{folder}: the Rerun viewer is missing; reinstall rerun-sdk")
    return str(found[0])


def _environment() -> Mapping[str, str]:
    return {"RUST_LOG": _QUIET, **os.environ, "RERUN_APP_ONLY": "true"}


def _apart(folder: Path) -> Mapping[str, str]:
    """What makes a viewer keep its own files in this folder, not at the user's home or in /tmp.

    One that finds no settings takes usage statistics, which a screenshot must not do.
    """
    settings = {
        "analytics_enabled": False,
        "analytics_id": "",
        "metadata": {},
        "config_file_path": str(folder / "rerun" / "analytics.json"),
        "data_dir_path": str(folder / "rerun" / "analytics"),
    }
    (folder / "rerun").mkdir()
    (folder / "rerun" / "analytics.json").write_text(json.dumps(settings), encoding="utf-8")
    return dict.fromkeys(("XDG_CONFIG_HOME", "XDG_DATA_HOME", "TMPDIR"), str(folder))
