"""Scan matchers behind one narrow interface."""

from __future__ import annotations

from slamsim.config.slam import FrontEndConfig
from slamsim.slam.matching.base import Match, Matcher

__all__ = ["Match", "Matcher", "make_matcher"]


def make_matcher(config: FrontEndConfig) -> Matcher:
    """The matcher that the configuration names."""
    if config.matcher == "kiss":
        from slamsim.slam.matching.kiss import KissMatcher

        return KissMatcher(config)
    from slamsim.slam.matching.line import LineMatcher

    return LineMatcher(config)
