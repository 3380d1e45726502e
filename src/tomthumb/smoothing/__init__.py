"""Batch smoothing: a finished run as a factor graph, solved for the whole trajectory and the map at once."""

from tomthumb.smoothing.g2o import load_g2o, save_g2o
from tomthumb.smoothing.graph import Graph, graph_of
from tomthumb.smoothing.solver import Smoothed, solve

__all__ = ["Graph", "Smoothed", "graph_of", "load_g2o", "save_g2o", "solve"]
