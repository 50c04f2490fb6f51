"""A labyrinth simulator, a 2-D SLAM system and a checker of recordings.

``slamsim.map``, ``simulate``, ``check_recording``, ``localise``, ``make_dataset``,
``open_session`` and ``Run`` are defined in ``slamsim.api`` and imported on first use (PEP 562), so
that ``import slamsim`` stays fast; so is ``slamsim.dataset``. ``__init__.pyi`` tells editors and
type checkers the same.
"""

__version__ = "0.1.0"

__all__ = [
    "Run",
    "__version__",
    "check_recording",
    "dataset",
    "localise",
    "make_dataset",
    "map",
    "open_session",
    "simulate",
]


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name == "dataset":
        return import_module("slamsim.dataset")
    if name in __all__:
        return getattr(import_module("slamsim.api"), name)
    raise AttributeError(f"module 'slamsim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
