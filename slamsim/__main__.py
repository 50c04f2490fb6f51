"""``python -m slamsim`` is the ``slamsim`` command."""

from __future__ import annotations

from slamsim.entry import main

if __name__ == "__main__":
    main()
