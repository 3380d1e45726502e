"""Simulated Tom Thumb as an associator: see `search` for the algorithm and `scene` for what it is given."""

from tomthumb.associators.tom_thumb.search import TomThumb

__all__ = ["TomThumb"]
